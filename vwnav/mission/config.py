"""Settings of a mission."""

from dataclasses import dataclass
from typing import Annotated

from vwnav.settings.ranges import Settings, Within


@dataclass(frozen=True, slots=True)
class DepartureConfig(Settings):
    """Times of a departure."""

    # The autopilot's filter must trust our estimate within this
    ready_timeout_s: Annotated[float, Within(1.0, 3600.0)] = 90.0
    # PX4 was seen ready for 2.1 s, then for 6 s not, then for good
    ready_steady_s: Annotated[float, Within(0.0, 60.0)] = 4.0
    arming_tries: Annotated[int, Within(1, 20)] = 3  # readiness may go in the very moment of arming
    # From the accepted command to the heartbeat that tells it
    arming_shows_s: Annotated[float, Within(0.0, 60.0, above=True)] = 3.0
    # Flown by the autopilot's own take-off
    takeoff_height_m: Annotated[float, Within(1.0, 50.0)] = 4.0


@dataclass(frozen=True, slots=True)
class FlightConfig(DepartureConfig):
    """Times and heights of a mission."""

    # Below this the autopilot's own landing takes over; a barometer drifts by 3 m in ten minutes,
    # and would never tell that it has come down there.
    land_from_m: Annotated[float, Within(3.0, 50.0)] = 5.0
    # Hovering at height without any fix
    first_fix_timeout_s: Annotated[float, Within(1.0, 600.0)] = 20.0
    fixes_to_start: Annotated[int, Within(1, 1000)] = 3
    takeoff_timeout_s: Annotated[float, Within(5.0, 600.0)] = 40.0
    hold_gain_per_s: Annotated[float, Within(0.0, 2.0, above=True)] = 0.5
    hold_speed_m_s: Annotated[float, Within(0.0, 10.0, above=True)] = 1.5
    # MAVLink system of the aircraft, where its link carries several; 0: the only one
    autopilot_id: Annotated[int, Within(0, 255)] = 0
    # MAVLink systems that may command it
    ground_station_ids: Annotated[tuple[int, ...], Within(1, 255)] = (255,)
