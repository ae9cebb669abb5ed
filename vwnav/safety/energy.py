"""Whether what is left in the battery is more than the way home takes."""

import math
from collections.abc import Callable

import numpy as np

from vwnav.safety.safety_config import SafetyConfig
from vwnav.types import Array, Estimate
from vwnav.vehicle import VehicleState

_LEAST_FLOWN_S = 30.0  # before that, and this much used, the consumption is not known
_LEAST_USED_RATIO = 0.03
_UP_AND_DOWN_M_S = 1.0  # to the height of the return, and from there to the ground
_LEAST_SPEED_M_S = 1.0  # against a wind that is nearly too strong


class EnergyWatch:
    """Learns what a second of flight takes, and compares with the way home.

    Args:
        cruise_m_s: speed over the ground, where the wind lets it.

    Attributes:
        way_home_ned_m: tells the way home (n, 3) from an estimate; None while nobody knows it.
    """

    def __init__(self, config: SafetyConfig, cruise_m_s: float) -> None:
        self._config = config
        self._cruise_m_s = cruise_m_s
        self._first: tuple[float, float] | None = None  # time and ratio
        self.way_home_ned_m: Callable[[Estimate], Array] | None = None

    def step(self, vehicle: VehicleState, estimate: Estimate, t_s: float) -> bool:
        """Whether it is time to go home; False while nobody can tell."""
        ratio = vehicle.battery_ratio
        if ratio is None or not vehicle.in_air or self.way_home_ned_m is None:
            return False
        if self._first is None or ratio > self._first[1]:
            self._first = (t_s, ratio)
        flown_s, used = t_s - self._first[0], self._first[1] - ratio
        if flown_s < _LEAST_FLOWN_S or used < _LEAST_USED_RATIO:
            return False
        takes = used / flown_s * self.home_s(estimate, self.way_home_ned_m(estimate))
        left = ratio - self._config.battery_critical_ratio
        return left < self._config.battery_home_share * takes

    def home_s(self, estimate: Estimate, way_ned_m: Array) -> float:
        """How long the way home (n, 3) takes in the wind that the filter has measured.

        Up to its highest stop first, and down from there to the ground at home.
        """
        stops_ned_m = np.vstack([estimate.position_ned_m, way_ned_m])
        top_m = -float(np.min(stops_ned_m[:, 2]))
        rise_m = top_m + float(estimate.position_ned_m[2])
        legs_ne_m = np.diff(stops_ned_m[:, :2], axis=0)
        along_s = sum(self._leg_s(leg_ne_m, estimate.wind_ne_m_s) for leg_ne_m in legs_ne_m)
        return along_s + (rise_m + max(top_m, 0.0)) / _UP_AND_DOWN_M_S

    def _leg_s(self, leg_ne_m: Array, wind_ne_m_s: Array | None) -> float:
        """Through the air it makes so much: what it holds against a wind from aside is not left."""
        leg_m = float(np.hypot(*leg_ne_m))
        if wind_ne_m_s is None or leg_m < 1.0:
            return leg_m / self._cruise_m_s
        tail_m_s = float(wind_ne_m_s @ leg_ne_m) / leg_m
        aside_m2_s2 = float(wind_ne_m_s @ wind_ne_m_s) - tail_m_s**2
        made_m_s = math.sqrt(max(self._config.airspeed_m_s**2 - aside_m2_s2, 0.0)) + tail_m_s
        return leg_m / max(min(self._cruise_m_s, made_m_s), _LEAST_SPEED_M_S)
