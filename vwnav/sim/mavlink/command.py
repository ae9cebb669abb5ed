"""A command as it arrives, COMMAND_LONG or COMMAND_INT."""

from dataclasses import dataclass
from enum import IntEnum

FORCE_MAGIC = 21196  # param2 of MAV_CMD_COMPONENT_ARM_DISARM


@dataclass(frozen=True, slots=True)
class VehicleCommand:
    """One command; x and y are degrees when they are a place, NaN is not given."""

    number: int
    p1: float
    p2: float
    p3: float
    p4: float
    x: float
    y: float
    z: float


def is_place(lat_deg: float, lon_deg: float, alt_amsl_m: float) -> bool:
    """Whether these can be a place on earth; False for NaN."""
    return abs(lat_deg) < 90.0 and abs(lon_deg) <= 180.0 and abs(alt_amsl_m) < 1e5


def message_id(value: float) -> int | None:
    """A message number as MESSAGE_INTERVAL can carry it."""
    return int(value) if 0.0 <= value < 65536.0 else None


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
