"""Whether what is left in the battery is more than the way home takes."""

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
    """

    def __init__(self, config: SafetyConfig, cruise_m_s: float) -> None:
        self._config = config
        self._cruise_m_s = cruise_m_s
        self._first: tuple[float, float] | None = None  # time and ratio

    def step(self, vehicle: VehicleState, estimate: Estimate, home_ne_m: Array, t_s: float) -> bool:
        """Whether it is time to go home; False while nobody can tell."""
        ratio = vehicle.battery_ratio
        if ratio is None or not vehicle.in_air:
            return False
        if self._first is None or ratio > self._first[1]:
            self._first = (t_s, ratio)
        flown_s, used = t_s - self._first[0], self._first[1] - ratio
        if flown_s < _LEAST_FLOWN_S or used < _LEAST_USED_RATIO:
            return False
        takes = used / flown_s * self.home_s(estimate, home_ne_m)
        left = ratio - self._config.battery_critical_ratio
        return left < self._config.battery_home_share * takes

    def home_s(self, estimate: Estimate, home_ne_m: Array) -> float:
        """How long the way up, home and down takes in the wind that the filter has measured."""
        way = home_ne_m - estimate.position_ned_m[:2]
        way_m = float(np.hypot(*way))
        head_m_s = 0.0
        if estimate.wind_ne_m_s is not None and way_m > 1.0:
            head_m_s = -float(estimate.wind_ne_m_s @ way) / way_m
        speed_m_s = max(
            min(self._cruise_m_s, self._config.airspeed_m_s - head_m_s), _LEAST_SPEED_M_S
        )
        rise_m = max(self._config.way_home_m + float(estimate.position_ned_m[2]), 0.0)
        return way_m / speed_m_s + (max(estimate.agl_m, 0.0) + 2.0 * rise_m) / _UP_AND_DOWN_M_S
