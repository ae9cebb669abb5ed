"""PX4's navigation states, their MAVLink numbers, and what each one needs."""

from dataclasses import dataclass
from enum import Enum, IntEnum


class NavState(Enum):
    """A navigation state; the value is PX4's (main mode, sub mode) of `HEARTBEAT.custom_mode`."""

    MANUAL = (1, 0)
    ALTITUDE = (2, 0)
    POSITION = (3, 0)
    TAKEOFF = (4, 2)
    HOLD = (4, 3)
    RETURN = (4, 5)
    LAND = (4, 6)
    DESCEND = (4, 20)
    OFFBOARD = (6, 0)
    STABILIZED = (7, 0)

    @property
    def main(self) -> int:
        """PX4_CUSTOM_MAIN_MODE."""
        return int(self.value[0])

    @property
    def sub(self) -> int:
        """PX4_CUSTOM_SUB_MODE_AUTO, 0 outside AUTO."""
        return int(self.value[1])

    @property
    def custom_mode(self) -> int:
        """The number as HEARTBEAT carries it: main in bits 16-23, sub in bits 24-31."""
        return self.main << 16 | self.sub << 24

    @property
    def base_mode(self) -> int:
        """MAV_MODE_FLAG bits without the armed bit, as recorded from PX4 1.18."""
        custom, auto, guided, stabilised, manual = 1, 4, 8, 16, 64
        if self.main == 4:
            return custom | auto | guided | stabilised
        if self is NavState.OFFBOARD:
            return custom | stabilised
        if self is NavState.MANUAL:
            return custom | manual
        return custom | manual | stabilised


COMMANDABLE = tuple(state for state in NavState if state is not NavState.DESCEND)
STICK_STATES = frozenset(
    {NavState.MANUAL, NavState.ALTITUDE, NavState.POSITION, NavState.STABILIZED}
)
POSITION_STATES = frozenset(
    {
        NavState.POSITION,
        NavState.TAKEOFF,
        NavState.HOLD,
        NavState.RETURN,
        NavState.LAND,
        NavState.OFFBOARD,
    }
)


def state_of_custom_mode(main: int, sub: int) -> NavState | None:
    """The state a DO_SET_MODE asks for, None when this vehicle does not have it."""
    wanted = (main, sub if main == 4 else 0)
    return next((state for state in COMMANDABLE if state.value == wanted), None)


class Landed(IntEnum):
    """MAV_LANDED_STATE."""

    ON_GROUND = 1
    IN_AIR = 2
    TAKEOFF = 3
    LANDING = 4


class Severity(IntEnum):
    """MAV_SEVERITY, of a text."""

    EMERGENCY = 0
    CRITICAL = 2
    WARNING = 4
    INFO = 6


class Result(IntEnum):
    """MAV_RESULT, of a command."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4


@dataclass(slots=True)
class Setpoint:
    """What a flight task asks of the position controller; None leaves that axis to the next loop.

    Position wins over velocity (which is then feed-forward); without either the axis flies the
    acceleration. `thrust` (0..1) bypasses the vertical loops. `idle` stops the rotors' push.
    """

    north_m: float | None = None
    east_m: float | None = None
    down_m: float | None = None
    vn_m_s: float | None = None
    ve_m_s: float | None = None
    vd_m_s: float | None = None
    an_m_s2: float | None = None
    ae_m_s2: float | None = None
    yaw_rad: float | None = None
    yaw_rate_rad_s: float | None = None
    thrust: float | None = None
    idle: bool = False
