"""ArduCopter's flight modes: their numbers, and what each one needs."""

from enum import IntEnum

from vwnav.vehicle import FlightMode

_CUSTOM, _GUIDED, _STABILISED, _MANUAL = 1, 8, 16, 64  # MAV_MODE_FLAG


class Mode(IntEnum):
    """A flight mode; the value is `HEARTBEAT.custom_mode` (`Copter/mode.h`)."""

    STABILIZE = 0
    ALT_HOLD = 2
    AUTO = 3
    GUIDED = 4
    LOITER = 5
    RTL = 6
    LAND = 9
    BRAKE = 17


NEEDS_POSITION = frozenset({Mode.AUTO, Mode.GUIDED, Mode.LOITER, Mode.RTL, Mode.BRAKE})
STICK_MODES = frozenset({Mode.STABILIZE, Mode.ALT_HOLD, Mode.LOITER})
ARMABLE = frozenset({Mode.STABILIZE, Mode.ALT_HOLD, Mode.GUIDED, Mode.LOITER})
# How a flight that begins in the air is flown.
MODE_OF: dict[FlightMode, Mode] = {
    FlightMode.OFFBOARD: Mode.GUIDED,
    FlightMode.HOLD: Mode.BRAKE,
    FlightMode.LAND: Mode.LAND,
    FlightMode.RETURN: Mode.RTL,
    FlightMode.MANUAL: Mode.LOITER,
}


def base_mode(holds_position: bool) -> int:
    """MAV_MODE_FLAG bits without the armed bit: guided while the position is controlled."""
    return _CUSTOM | _STABILISED | _MANUAL | (_GUIDED if holds_position else 0)
