"""The geometry of a route: straight legs, and how fast each waypoint may be passed."""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from vwnav.guidance.limits import LimitsConfig
from vwnav.types import Array

_SHORTEST_LEG_M = 0.1
_STEEP = 1.5  # metres up or down a metre along: from there on height tells better where it is


@dataclass(frozen=True, slots=True, eq=False)
class Leg:
    """From one waypoint to the next; straight up or down its length is 0.

    On one that is steep, or straight up or down, the place follows the height. It is flown there no
    lower than its line, whose height at a place is more than any position can tell.

    Attributes:
        start_ned_m, end_ned_m: (3,).
        along_ne, right_ne: (2,) unit vectors along the leg and to the right of it.
        length_m: horizontal.
    """

    start_ned_m: Array
    end_ned_m: Array
    along_ne: Array
    right_ne: Array
    length_m: float

    @property
    def heading_rad(self) -> float:
        """Course of the leg, clockwise from north."""
        return math.atan2(self.along_ne[1], self.along_ne[0])

    @property
    def drop_m(self) -> float:
        """How far down it leads, negative up."""
        return float(self.end_ned_m[2] - self.start_ned_m[2])

    @property
    def is_steep(self) -> bool:
        """Straight up or down, or nearly."""
        return self.length_m == 0.0 or abs(self.drop_m) > _STEEP * self.length_m

    def along_track_m(self, position_ned_m: Array) -> float:
        """Distance flown along the leg, negative before its start."""
        return self.length_m + float((position_ned_m - self.end_ned_m)[:2] @ self.along_ne)

    def cross_track_m(self, position_ned_m: Array) -> float:
        """Distance to the right of the leg."""
        return float((position_ned_m - self.end_ned_m)[:2] @ self.right_ne)

    def to_go_m(self, position_ned_m: Array) -> float:
        """Along it to where it should be by now: its end, in a steep climb as far as it has risen.

        Negative where that is behind it.
        """
        part = 1.0
        if self.is_steep and self.drop_m < 0.0:
            risen_m = float(self.start_ned_m[2] - position_ned_m[2])
            part = min(max(risen_m / -self.drop_m, 0.0), 1.0)
        return part * self.length_m - self.along_track_m(position_ned_m)

    def down_at_m(self, position_ned_m: Array) -> float:
        """Down coordinate of the leg abeam of the position; of its end where it is steep."""
        if self.is_steep:
            return float(self.end_ned_m[2])
        part = min(max(self.along_track_m(position_ned_m) / self.length_m, 0.0), 1.0)
        return float(self.start_ned_m[2] + part * self.drop_m)

    def below_m(self, position_ned_m: Array) -> float:
        """How far below the leg it is, negative above; of a steep one, below both its ends."""
        down_m = self.down_at_m(position_ned_m)
        if self.is_steep:
            down_m = max(down_m, float(self.start_ned_m[2]))
        return float(position_ned_m[2]) - down_m

    def slope_at(self, position_ned_m: Array) -> float:
        """Metres down per metre along; zero before the start, past the end and where steep."""
        if self.is_steep or not 0.0 < self.along_track_m(position_ned_m) < self.length_m:
            return 0.0
        return self.drop_m / self.length_m

    def speed_for_slope_m_s(self, limits: LimitsConfig) -> float:
        """Speed along the leg at which its climb or descent stays within the limits."""
        if self.is_steep:
            return math.inf
        vertical_m_s = limits.descend_m_s if self.drop_m > 0.0 else limits.climb_m_s
        # A fifth is left over for correcting the height.
        return 0.8 * vertical_m_s * self.length_m / max(abs(self.drop_m), 1e-6)


def legs_of(points_ned_m: Array) -> tuple[Leg, ...]:
    """The n - 1 legs of points (n, 3). A leg without length keeps the direction before it."""
    legs: list[Leg] = []
    along = np.array([1.0, 0.0])
    for start, end in pairwise(np.asarray(points_ned_m, dtype=np.float64)):
        step = (end - start)[:2]
        length_m = float(np.hypot(*step))
        if length_m < _SHORTEST_LEG_M:
            length_m = 0.0
        else:
            along = step / length_m
        legs.append(Leg(start, end, along, np.array([-along[1], along[0]]), length_m))
    return tuple(legs)


def waypoint_speeds_m_s(legs: tuple[Leg, ...], limits: LimitsConfig) -> tuple[float, ...]:
    """Speed at the end of each leg: slow in corners, and such that the next can be braked for."""
    speeds = [0.0] * len(legs)
    for i in range(len(legs) - 2, -1, -1):
        after = legs[i + 1]
        if legs[i].is_steep or after.is_steep:
            continue
        # Velocity changes by 2 v sin(turn / 2) in the corner.
        half_sin = float(np.linalg.norm(after.along_ne - legs[i].along_ne)) / 2.0
        corner_m_s = limits.corner_change_m_s / max(2.0 * half_sin, 1e-6)
        braked_m_s = math.sqrt(speeds[i + 1] ** 2 + 2.0 * limits.braking_m_s2 * after.length_m)
        speeds[i] = min(corner_m_s, braked_m_s, limits.cruise_m_s)
    return tuple(speeds)
