"""Mean wind with a boundary layer, and Dryden-like gusts."""

import math
import random

_LENGTH_M = 60.0  # turbulence scale at flying height: MIL-F-8785C's at about 60 m
_ROUGHNESS_M = 0.15


class Wind:
    """Wind as seen by the vehicle: mean from one direction, gusts as first-order shaping filters.

    The low-altitude Dryden model (MIL-F-8785C, 3.7.2.2) with its longitudinal form on every axis
    and half the intensity on the vertical one.
    """

    def __init__(
        self, mean_m_s: float, from_deg: float, gust_sigma_m_s: float, rng: random.Random
    ) -> None:
        towards_rad = math.radians(from_deg) + math.pi
        self._mean_n_m_s = mean_m_s * math.cos(towards_rad)
        self._mean_e_m_s = mean_m_s * math.sin(towards_rad)
        self._sigma_m_s = gust_sigma_m_s
        self._rng = rng
        self._gust = [0.0, 0.0, 0.0]
        self.n_m_s = self.e_m_s = self.d_m_s = 0.0

    def step(self, height_m: float, airspeed_m_s: float, dt_s: float) -> None:
        """Advance the gusts by `dt_s` (called at 50 Hz or so) at `height_m` over the ground."""
        shear = _shear(height_m)
        if self._sigma_m_s > 0.0:
            keep = math.exp(-dt_s * max(airspeed_m_s, 2.0) / _LENGTH_M)
            kick = self._sigma_m_s * math.sqrt(1.0 - keep * keep)
            gauss = self._rng.gauss
            for i in range(3):
                self._gust[i] = keep * self._gust[i] + gauss(0.0, kick)
        self.n_m_s = shear * (self._mean_n_m_s + self._gust[0])
        self.e_m_s = shear * (self._mean_e_m_s + self._gust[1])
        self.d_m_s = 0.5 * shear * self._gust[2]


def _shear(height_m: float) -> float:
    """Logarithmic boundary layer: 1 from 10 m up, nothing at the ground (MIL-F-8785C eq. 3.7.3)."""
    return min(1.0, math.log1p(max(height_m, 0.0) / _ROUGHNESS_M) / math.log1p(10 / _ROUGHNESS_M))
