"""By how much rotors out of balance shake an IMU, and whether it still tells anything.

The history (`imu.py`) weighs the samples that it believes by what those scatter by. Of a sensor
that is shaken hard it refuses most, and those left scatter little: here all of them count.
"""

import math
from collections import deque

import numpy as np

from vwnav.estimation.inertial.attitudes import LONGEST_GAP_S
from vwnav.estimation.inertial.imu import SCATTER_OF_BEND
from vwnav.types import Array, ImuSample

_OVER_S = 1.0  # scatter is averaged
_MOST = np.array([60.0, 4.0])  # m/s^2 and rad/s that samples bend by: wrong ones shake nothing
# What force and rates scatter by adds up to so much per root second: thrust as the attitude has it
# tells more of the velocity. Recorded of real autopilots: at most 0.25 m/s and 1.3 degrees in the
# air (PX4 of the 1.16 era), 0.73 m/s at a touch-down.
_TOO_MUCH = np.array([1.0, math.radians(4.0)])
_AGAIN = 0.5  # of it: nearer to it it is not used again
_CHANCE_SIGMAS = 3.0


class Shaking:
    """Of all samples, those too that are not believed.

    Attributes:
        too_much: it tells less than the attitude does.
    """

    def __init__(self) -> None:
        self._newest: deque[tuple[float, Array]] = deque(maxlen=3)
        self._walk2 = np.zeros(2)  # per second and axis: (m/s)^2, rad^2
        self.too_much = False

    def take(self, sample: ImuSample) -> None:
        """Learn from how the newest three bend: a manoeuvre is smooth beside it."""
        values = np.concatenate([sample.specific_force_m_s2, sample.rates_rad_s])
        span_s = sample.t_s - self._newest[-1][0] if self._newest else 0.0
        if not 0.0 <= span_s <= LONGEST_GAP_S:
            self._newest.clear()
        self._newest.append((sample.t_s, values))
        if len(self._newest) < 3:
            return
        zero, one, two = (values for _, values in self._newest)
        bend = np.linalg.norm((zero - 2.0 * one + two).reshape(2, 3), axis=1)
        walked = span_s * np.minimum(bend, _MOST) ** 2 / SCATTER_OF_BEND
        self._walk2 += -math.expm1(-span_s / _OVER_S) * (walked - self._walk2)
        most = _TOO_MUCH * (_AGAIN if self.too_much else 1.0)
        self.too_much = bool(np.any(self._walk2 > most**2))

    def chance_m_s2(self, over_s: float) -> float:
        """By what a force that is averaged exponentially `over_s` may be off by chance."""
        return _CHANCE_SIGMAS * math.sqrt(3.0 * self._walk2[0] / (2.0 * over_s))
