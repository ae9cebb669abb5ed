"""A flight as the rules see it: time-stamped values, wherever they were noted."""

import bisect
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

from vwnav.mission.config import FlightConfig
from vwnav.mission.mission import Phase
from vwnav.rules.temporal import Span
from vwnav.safety.safety_config import EstimateLimits, SafetyConfig
from vwnav.vehicle import FlightMode

Vector = tuple[float, float, float]  # north, east, down
Level = tuple[float, float]  # north, east
NAVIGATOR_ENDED = "the navigator has ended"  # by who sees its process: the mission ends with it
MISSION_HANGS = "the mission hangs: the watchdog lands the aircraft"  # as the runtime says it


@dataclass(frozen=True, slots=True)
class LoggedVehicle:
    """The aircraft at a moment."""

    t_s: float
    mode: FlightMode
    armed: bool
    in_air: bool
    battery_ratio: float | None = None

    def has_less_than(self, ratio: float) -> bool:
        """Of the full battery; not where the autopilot does not say."""
        return self.battery_ratio is not None and self.battery_ratio < ratio


@dataclass(frozen=True, slots=True)
class Sent:
    """An estimate as the autopilot got it.

    Attributes:
        t_s: arrival; `stamp_s` is the moment that it is about, the same where that is not known.
        covariance_ne_m2: north, north-east, east.
        velocity_ned_m_s: None where it was not noted.
        sigma_m_s: of the velocity, the larger horizontal one, where the autopilot was told it.
    """

    t_s: float
    stamp_s: float
    position_ned_m: Vector
    covariance_ne_m2: Vector
    reset_counter: int
    velocity_ned_m_s: Vector | None = None
    sigma_m_s: float | None = None

    @property
    def sigma_m(self) -> float:
        """The larger semi-axis of the one-sigma ellipse; NaN where the covariance is none."""
        a, b, c = self.covariance_ne_m2
        square = 0.5 * (a + c) + math.hypot(0.5 * (a - c), b)
        return math.sqrt(square) if square >= 0.0 else math.nan


@dataclass(frozen=True, slots=True)
class LoggedSetpoint:
    """A velocity that was asked for; `component` is who did, None where it was not noted."""

    t_s: float
    velocity_ned_m_s: Vector
    component: int | None = None


@dataclass(frozen=True, slots=True)
class LoggedCommand:
    """A MAV_CMD with its parameters as the autopilot got it."""

    t_s: float
    number: int
    parameters: tuple[float, ...] = ()
    component: int = 0


@dataclass(frozen=True, slots=True)
class CommandAck:
    """The autopilot's MAV_RESULT to a command."""

    t_s: float
    number: int
    accepted: bool


@dataclass(frozen=True, slots=True)
class ParameterSet:
    """A parameter of the autopilot is written."""

    t_s: float
    name: str
    value: float


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """A heartbeat of ours; `kind` is its MAV_TYPE."""

    t_s: float
    component: int
    kind: int


@dataclass(frozen=True, slots=True)
class PhaseStart:
    """The mission enters a phase."""

    t_s: float
    phase: Phase


@dataclass(frozen=True, slots=True)
class Said:
    """A line that the program said."""

    t_s: float
    text: str


@dataclass(frozen=True, slots=True)
class At:
    """A place or a velocity, north and east, at a moment."""

    t_s: float
    ne: Level


@dataclass(frozen=True, slots=True)
class Moment:
    """Something happened."""

    t_s: float


@dataclass(frozen=True, slots=True)
class LoggedTruth:
    """Where the aircraft truly was."""

    t_s: float
    position_ned_m: Vector
    velocity_ned_m_s: Vector


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightLimits:
    """The settings that a flight is held to; speeds are those of its route."""

    speed_max_m_s: float = 10.0
    climb_m_s: float = 3.0
    descend_m_s: float = 2.0
    safety: SafetyConfig = field(default_factory=SafetyConfig)
    estimate: EstimateLimits = field(default_factory=EstimateLimits)
    flight: FlightConfig = field(default_factory=FlightConfig)


@dataclass(frozen=True, kw_only=True, eq=False)
class FlightLog:
    """Rows in order of time, on one clock.

    Attributes:
        unknown: names of the streams that nobody noted.
        vehicle: its states, at 5 Hz or more.
        estimates: as sent; setpoints and commands likewise.
        fixes: places of map fixes that the filter took, by their exposure.
        sights: exposures of images that told a motion or a place.
        beliefs: horizontal velocities of the filter, sent or not.
        homes: where home is held to be, from when on.
        sampled: estimates and setpoints are a few of all: gaps between them tell nothing.
        map_off_m: how far the map itself is off.
        map_sigma_m: one sigma of that, per axis, where it is not known.
        broken: when something was broken on purpose: what must be steady need not be then.
        round_trip_s: of the line, both ways together: rows are of the autopilot's end.
    """

    bounds: FlightLimits = field(default_factory=FlightLimits)
    vehicle: Sequence[LoggedVehicle] = ()
    estimates: Sequence[Sent] = ()
    setpoints: Sequence[LoggedSetpoint] = ()
    commands: Sequence[LoggedCommand] = ()
    answers: Sequence[CommandAck] = ()
    parameters_set: Sequence[ParameterSet] = ()
    beats: Sequence[Heartbeat] = ()
    phases: Sequence[PhaseStart] = ()
    events: Sequence[Said] = ()
    fixes: Sequence[At] = ()
    sights: Sequence[Moment] = ()
    beliefs: Sequence[At] = ()
    homes: Sequence[At] = ()
    truth: Sequence[LoggedTruth] = ()
    unknown: frozenset[str] = frozenset()
    sampled: bool = False
    map_off_m: float = 0.0
    map_sigma_m: float = 0.0
    broken: Sequence[Span] = ()
    round_trip_s: float = 0.0

    @cached_property
    def end_s(self) -> float:
        """Of what was noted of the vehicle: nothing can be asked of the time after it."""
        return self.vehicle[-1].t_s if self.vehicle else math.inf

    def vehicle_at(self, t_s: float) -> LoggedVehicle | None:
        """Its newest state; None before the first."""
        rows = self.vehicle
        i = bisect.bisect_right(rows, t_s, key=lambda row: row.t_s) - 1
        return rows[i] if i >= 0 else None

    def phase_at(self, t_s: float) -> Phase | None:
        """Where the mission stands; None before the first that is known."""
        rows = self.phases
        i = bisect.bisect_right(rows, t_s, key=lambda row: row.t_s) - 1
        return rows[i].phase if i >= 0 else None

    def true_velocity_ne_m_s(self, t_s: float) -> Level | None:
        """Of the newest row; None where there is none within a second."""
        row = self._truth_before(t_s)
        return None if row is None else (row.velocity_ned_m_s[0], row.velocity_ned_m_s[1])

    def true_place_ne_m(self, t_s: float) -> Level | None:
        """The truth carried on from its newest row; None where there is none within a second."""
        row = self._truth_before(t_s)
        if row is None:
            return None
        ahead_s = t_s - row.t_s
        north, east = row.position_ned_m[:2]
        vn, ve = row.velocity_ned_m_s[:2]
        return north + ahead_s * vn, east + ahead_s * ve

    def _truth_before(self, t_s: float) -> LoggedTruth | None:
        rows = self.truth
        i = bisect.bisect_right(rows, t_s, key=lambda row: row.t_s) - 1
        return None if i < 0 or t_s - rows[i].t_s > 1.0 else rows[i]
