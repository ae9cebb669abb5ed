"""Flight modes as PX4 and ArduCopter number them, and as vwnav sees them.

PX4: `px4_custom_mode.h`, main mode in bits 16-23 of HEARTBEAT.custom_mode, sub mode in bits 24-31.
ArduCopter: `Copter/mode.h`, the number itself. MAVSDK's own decoding is not used: it shows PX4's
Descend as UNKNOWN and ArduCopter's GUIDED as OFFBOARD only.
"""

from dataclasses import dataclass
from enum import Enum

from vwnav.vehicle import FlightMode

MAV_CMD_DO_SET_MODE = 176
_CUSTOM_MODE_ENABLED = 1.0


class AutopilotKind(Enum):
    """Firmware families, by MAV_AUTOPILOT of their HEARTBEAT."""

    PX4 = 12
    ARDUPILOT = 3

    def __str__(self) -> str:
        """The name that people use."""
        return "PX4" if self is AutopilotKind.PX4 else "ArduPilot"


_PX4_MAIN = {
    1: FlightMode.MANUAL,  # Manual
    2: FlightMode.MANUAL,  # Altitude
    3: FlightMode.MANUAL,  # Position
    5: FlightMode.MANUAL,  # Acro
    6: FlightMode.OFFBOARD,
    7: FlightMode.MANUAL,  # Stabilized
    8: FlightMode.MANUAL,  # Rattitude
}
_PX4_MAIN_AUTO = 4
_PX4_AUTO_SUB = {
    2: FlightMode.TAKEOFF,
    3: FlightMode.HOLD,  # Loiter
    4: FlightMode.MISSION,
    5: FlightMode.RETURN,
    6: FlightMode.LAND,
    9: FlightMode.LAND,  # Precision land
    20: FlightMode.DESCEND,
}
_ARDUCOPTER = {
    0: FlightMode.MANUAL,  # Stabilize
    1: FlightMode.MANUAL,  # Acro
    2: FlightMode.MANUAL,  # AltHold
    3: FlightMode.MISSION,  # Auto
    4: FlightMode.OFFBOARD,  # Guided
    5: FlightMode.MANUAL,  # Loiter is flown with sticks
    6: FlightMode.RETURN,
    7: FlightMode.MANUAL,  # Circle
    9: FlightMode.LAND,
    11: FlightMode.MANUAL,  # Drift
    13: FlightMode.MANUAL,  # Sport
    14: FlightMode.MANUAL,  # Flip
    15: FlightMode.MANUAL,  # AutoTune
    16: FlightMode.MANUAL,  # PosHold
    17: FlightMode.HOLD,  # Brake: holds position without sticks
    21: FlightMode.RETURN,  # Smart RTL
    22: FlightMode.MANUAL,  # FlowHold
    24: FlightMode.MANUAL,  # ZigZag
    27: FlightMode.RETURN,  # Auto RTL
}
_PX4_NUMBERS = {
    FlightMode.OFFBOARD: (6, 0),
    FlightMode.HOLD: (4, 3),
    FlightMode.RETURN: (4, 5),
    FlightMode.LAND: (4, 6),
}
_ARDUCOPTER_NUMBERS = {
    FlightMode.OFFBOARD: 4,
    FlightMode.HOLD: 17,
    FlightMode.RETURN: 6,
    FlightMode.LAND: 9,
}


def flight_mode(kind: AutopilotKind, custom_mode: int) -> FlightMode:
    """The mode that a HEARTBEAT's custom_mode stands for."""
    if kind is AutopilotKind.ARDUPILOT:
        return _ARDUCOPTER.get(custom_mode, FlightMode.OTHER)
    main, sub = (custom_mode >> 16) & 0xFF, (custom_mode >> 24) & 0xFF
    if main == _PX4_MAIN_AUTO:
        return _PX4_AUTO_SUB.get(sub, FlightMode.OTHER)
    return _PX4_MAIN.get(main, FlightMode.OTHER)


@dataclass(frozen=True, slots=True)
class Command:
    """A MAV_CMD with its first parameters; None is sent as NaN, what is missing as 0."""

    number: int
    params: tuple[float | None, ...]


def mode_command(kind: AutopilotKind, mode: FlightMode) -> Command:
    """The MAV_CMD_DO_SET_MODE that asks for `mode`: OFFBOARD, HOLD, RETURN or LAND."""
    if kind is AutopilotKind.ARDUPILOT:
        params: tuple[float, ...] = (_CUSTOM_MODE_ENABLED, float(_ARDUCOPTER_NUMBERS[mode]))
    else:
        main, sub = _PX4_NUMBERS[mode]
        params = (_CUSTOM_MODE_ENABLED, float(main), float(sub))
    return Command(MAV_CMD_DO_SET_MODE, params)
