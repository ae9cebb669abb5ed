"""All that the control hierarchy decides on, at one moment."""

import math
from dataclasses import dataclass
from enum import IntEnum

from vwnav.vehicle import FlightMode, Order


class BatteryLevel(IntEnum):
    """How much is left, in three steps."""

    CRITICAL = 0
    LOW = 1
    ENOUGH = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Situation:
    """What the watches have seen. Times that count from something that never was are negative.

    Attributes:
        released: why the aircraft is not ours any more.
        failsafe: the mode that the autopilot flies in our place; `is_failsafe_told` once it has
            said so.
        is_battery_for_home_only: what is left is just enough for the way home.
        connected, silence_s: of the autopilot; our own sleep left out.
        lost_s, lost: since when there is no estimate to fly on, and why; negative while there is.
        blind_s: since the last image that told motion or place; `is_unseen` where none has come
            since, or none that was computed.
        contradicted: images tell motions that contradict the IMU.
        radio_lost_s, ground_lost_s: of the pilot's radio and the ground station, once heard.
        had_fix: there has been a map fix.
        is_usable: the way home can be found with the position.
        bad_s, complaint: for how long the position has been out of bounds, and how.
        warning: how it is poor; empty when it is not.
        off_route_m: horizontally from the nearest of route and way home.
        carried_off_m: beyond the fence, and so much farther from route and home than it was there.
        order: the ground station's last.
    """

    released: str | None = None
    failsafe: FlightMode | None = None
    is_failsafe_told: bool = True
    battery: BatteryLevel = BatteryLevel.ENOUGH
    is_battery_for_home_only: bool = False
    connected: bool = True
    silence_s: float = 0.0
    lost_s: float = -math.inf
    lost: str = ""
    blind_s: float = 0.0
    is_unseen: bool = False
    contradicted: bool = False
    radio_lost_s: float = -math.inf
    ground_lost_s: float = -math.inf
    had_fix: bool = True
    is_usable: bool = True
    bad_s: float = -math.inf
    complaint: str = ""
    warning: str = ""
    off_route_m: float = 0.0
    carried_off_m: float = 0.0
    order: Order | None = None
