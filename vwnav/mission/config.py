"""Settings of a mission."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class DepartureConfig:
    """Times of a departure."""

    ready_timeout_s: float = 90.0  # the autopilot's filter must trust our estimate within this
    ready_steady_s: float = 4.0  # PX4 was seen ready for 2.1 s, then for 6 s not, then for good
    arming_tries: int = 3  # readiness may go in the very moment of arming
    arming_shows_s: float = 3.0  # from the accepted command to the heartbeat that tells it
    takeoff_height_m: float = 4.0  # flown by the autopilot's own take-off


@dataclass(frozen=True, slots=True)
class FlightConfig(DepartureConfig):
    """Times and heights of a mission."""

    land_from_m: float = 5.0  # below this the autopilot's own landing takes over
    first_fix_timeout_s: float = 20.0  # hovering at height without any fix
    fixes_to_start: int = 3
    takeoff_timeout_s: float = 40.0
    hold_gain_per_s: float = 0.5
    hold_speed_m_s: float = 1.5
    ground_station_ids: tuple[int, ...] = (255,)  # MAVLink systems that may command it
