"""What an aircraft tells, and what it is asked for: the seam to the autopilot."""

from dataclasses import dataclass
from enum import Enum
from typing import Literal, NamedTuple, Protocol

from vwnav.types import Array, Attitude, Estimate, Telemetry


class FoundCamera(NamedTuple):
    """What a flight has found out of its camera that its calibration says otherwise.

    Attributes:
        focal_ratio: of its focal length to the calibrated one.
        mirrored: its images are, left to right: 1, else 0.
        R_mount: (9,) rotation in the body from the mount that was told, row by row.
        time_offset_s: what is to be added to the dates of its images besides.
    """

    focal_ratio: float
    mirrored: float
    R_mount: tuple[float, ...]
    time_offset_s: float = 0.0


class Learned(NamedTuple):
    """What a navigator has learned, for one that has to go on in its place.

    Attributes:
        t_s: when.
        mean: (n,) of the filter's states that are handed on: air, IMU, compass, and what is left
            unsure of the camera (`vwnav.estimation.beginning.starts`); () where they are too few.
        covariance: (n (n + 1) / 2,) theirs, the upper triangle row by row.
        camera: None where it is as its calibration says.
    """

    t_s: float
    mean: tuple[float, ...]
    covariance: tuple[float, ...]
    camera: FoundCamera | None = None


@dataclass(frozen=True, slots=True)
class VelocitySetpoint:
    """What the autopilot is asked to fly: NED velocity, and a heading (None holds the present)."""

    north_m_s: float
    east_m_s: float
    down_m_s: float
    yaw_rad: float | None = None


class FlightMode(Enum):
    """Flight modes that matter to a navigator, whatever the autopilot calls them."""

    OFFBOARD = "offboard"  # PX4 Offboard, ArduPilot GUIDED: ours
    TAKEOFF = "takeoff"
    HOLD = "hold"
    LAND = "land"
    RETURN = "return"
    DESCEND = "descend"
    MISSION = "mission"
    MANUAL = "manual"  # any mode flown with sticks: position, altitude, stabilised, acro
    OTHER = "other"  # told, and none of these
    UNKNOWN = "unknown"  # not told


@dataclass(frozen=True, slots=True)
class VehicleState:
    """A snapshot of the autopilot's telemetry; ages are relative to `t_s`.

    Attributes:
        height_m: barometric height above the place where the link came up, up positive.
        rangefinder_m: distance to the ground along the body's down axis.
        local_position_ok: the autopilot's own filter has a horizontal position.
        intended_mode: the mode that somebody asked for: in a failsafe PX4 flies another one. It is
            `mode` where the autopilot cannot tell the two apart, and UNKNOWN for the moment between
            a change of mode and PX4's word on who asked for it.
        tells_intent: which mode was asked for is told, or need not be (ArduPilot).
        failsafe: the autopilot flies a mode of its own choice, not of a person's or ours.
        lands_blind: it comes down as the wind has it, though it has a position again: it holds it
            once another mode was flown (ArduCopter).
        silence_s: since anything of it came.
        aiding: its filter predicts the position from what we send; None when it does not say.
        ground_station: one has been heard within some seconds.
        own_position_ned_m: (3,) where the autopilot believes to be, about the run's origin; None
            when that is older than a second, or the two have not agreed upon an origin.
        complaints: its own warnings of the last while; PX4 tells them to ground stations alone.
    """

    t_s: float
    connected: bool
    armed: bool
    in_air: bool
    mode: FlightMode
    attitude: Attitude | None
    height_m: float | None
    height_t_s: float | None
    rangefinder_m: float | None
    battery_ratio: float | None
    rc_available: bool
    local_position_ok: bool
    armable: bool
    silence_s: float
    intended_mode: FlightMode = FlightMode.UNKNOWN
    tells_intent: bool = True
    failsafe: bool = False
    lands_blind: bool = False
    aiding: bool | None = None
    ground_station: bool = False
    own_position_ned_m: Array | None = None
    complaints: tuple[str, ...] = ()

    @property
    def is_fallback(self) -> bool:
        """It is told that another mode than the flown one was asked for: nobody chose this one.

        PX4 alone tells it. That may be a mode of the sticks, with nobody at them (`has_sticks`).
        """
        told_another = self.intended_mode not in (self.mode, FlightMode.UNKNOWN)
        return told_another and not self.has_sticks

    @property
    def has_sticks(self) -> bool:
        """It flies as somebody's sticks tell it, and hears them, whoever chose the mode.

        Who moves them in a mode to which PX4 fell back changes nothing that it tells.
        """
        return self.mode is FlightMode.MANUAL and self.rc_available

    @property
    def may_be_pilots(self) -> bool:
        """It flies a mode of the sticks, and nobody has said that it fell back to it."""
        return self.mode is FlightMode.MANUAL and not self.is_fallback


class Order(Enum):
    """What a ground station may ask of the mission."""

    START = "the start"
    PAUSE = "a pause"
    GO_ON = "going on"
    RETURN = "the way home"
    LAND = "a landing"


NO_ANSWER = "no answer"  # begins why a request was refused that may have been done all the same
Severity = Literal["fail", "warn"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """A parameter of the autopilot that is not as it should be.

    Attributes:
        present: its value, None when the autopilot does not have it.
        wanted: the value it should have, in words.
        severity: "fail" when the aircraft cannot fly on vision with it.
    """

    parameter: str
    present: float | None
    wanted: str
    why: str
    severity: Severity


@dataclass(slots=True)
class Request:
    """A command on its way to the autopilot; the link's `step` carries it on.

    Attributes:
        done: it has been answered, given up, or replaced by a newer one.
        refused: why, once done; None when the autopilot has accepted it.
    """

    done: bool = False
    refused: str | None = None


class Autopilot(Protocol):
    """The link as the flight loop sees it: thread-safe, and no call ever waits.

    Commands are carried on by `step`; each returns a `Request` that says how it went. A new one
    replaces the one under way.
    """

    def step(self, t_s: float) -> None:
        """Keep the link up and carry commands on; to be called at 20 Hz or more."""
        ...

    def state(self) -> VehicleState:
        """The newest telemetry."""
        ...

    def take_measurements(self) -> tuple[Telemetry, ...]:
        """What was measured since the last call, in order of arrival, each once."""
        ...

    @property
    def findings(self) -> tuple[Finding, ...] | None:
        """Parameters that are not as they should be, worst first; None until they are read."""
        ...

    @property
    def link_refusal(self) -> str | None:
        """Why the link is none to fly on: whose it is, or what it carries; None when it is one."""
        ...

    def set_origin(self, lat_deg: float, lon_deg: float, alt_amsl_m: float) -> None:
        """Origin of the estimates to come; before the first of them."""
        ...

    def send_estimate(self, estimate: Estimate) -> None:
        """Hand the estimate to the autopilot's filter."""
        ...

    def send_velocity(self, setpoint: VelocitySetpoint) -> None:
        """Ask for a velocity, in Offboard."""
        ...

    def send_text(self, text: str, warns: bool = True) -> None:
        """Tell the ground stations; what warns is for who looks at the view of the pilot, too."""
        ...

    def take_orders(self) -> tuple[tuple[Order, ...], tuple[str, ...]]:
        """What ground stations ordered since the last call, and what was refused, in words."""
        ...

    def arm(self) -> Request:
        """Start the motors."""
        ...

    def takeoff(self, height_m: float) -> Request:
        """Climb to a height above home in the autopilot's own mode."""
        ...

    def start_offboard(self) -> Request:
        """Take the steering: PX4 Offboard, ArduPilot GUIDED."""
        ...

    def hold(self) -> Request:
        """Stop and hover in the autopilot's own mode."""
        ...

    def land(self) -> Request:
        """Land here in the autopilot's own mode."""
        ...

    def stand_by(self) -> Request:
        """On the ground: leave a mode in which nobody can arm it."""
        ...

    def disarm(self) -> Request:
        """Stop the motors, on the ground."""
        ...

    def withdraw(self) -> None:
        """Ask no more for what is under way: somebody else has the aircraft."""
        ...

    def close(self) -> None:
        """End the link."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Navigation:
    """What there is to fly on.

    Attributes:
        estimate: the one that is also sent to the autopilot; None while there is none that we
            would fly on.
        lost: why there is none any more; empty before the first and while there is one.
        seen_s: exposure of the newest image that told a motion or a place.
        contradicted: the newest image's motion is not believed: it contradicts the IMU.
        learned: for whoever has to go on with the flight; None while that is not enough.
        follows: the newest image told one; where that is long ago, images come late or not at all.
        looks: at the map that have been answered so far.
    """

    estimate: Estimate | None
    lost: str = ""
    seen_s: float | None = None
    contradicted: bool = False
    learned: Learned | None = None
    follows: bool = False
    looks: int = 0
