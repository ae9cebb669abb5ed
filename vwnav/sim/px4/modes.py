"""PX4's navigation states, their MAVLink numbers, and what each one needs."""

from enum import Enum

from vwnav.vehicle import FlightMode


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


STATE_OF: dict[FlightMode, NavState] = {
    FlightMode.OFFBOARD: NavState.OFFBOARD,
    FlightMode.TAKEOFF: NavState.TAKEOFF,
    FlightMode.HOLD: NavState.HOLD,
    FlightMode.LAND: NavState.LAND,
    FlightMode.RETURN: NavState.RETURN,
    FlightMode.DESCEND: NavState.DESCEND,
    FlightMode.MANUAL: NavState.POSITION,
}
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
# In flight PX4 wants a position within COM_POS_FS_EPH for these; Land takes any, from 1.16 on.
ACCURATE_STATES = frozenset({NavState.HOLD, NavState.RETURN})


def state_of_custom_mode(main: int, sub: int) -> NavState | None:
    """The state a DO_SET_MODE asks for, None when this vehicle does not have it."""
    wanted = (main, sub if main == 4 else 0)
    return next((state for state in COMMANDABLE if state.value == wanted), None)
