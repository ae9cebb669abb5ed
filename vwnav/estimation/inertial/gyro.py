"""The turns that the autopilot's gyro has counted over the last seconds."""

import bisect
import math

import numpy as np

from vwnav.geometry.rotations import quat_conjugate, quat_from_vector, quat_multiply
from vwnav.types import Array

LONGEST_GAP_S = 0.1  # between samples; a longer one is a silence
_RATE_OVER_S = 0.04
_FORGET_AT_ONCE = 1000  # samples


class GyroHistory:
    """The product of all turns up to any moment: what lies between two of them is a quotient."""

    def __init__(self, length_s: float) -> None:
        self._length_s = length_s
        self._times_s: list[float] = []
        self._turned: list[Array] = []
        self._series: list[int] = []  # samples between silences share a number
        self._first_series = 0

    @property
    def newest_s(self) -> float:
        """Time of the newest sample, minus infinity before the first."""
        return self._times_s[-1] if self._times_s else -math.inf

    @property
    def newest(self) -> Array:
        """(4,) the product up to the newest sample; there is one."""
        return self._turned[-1]

    def forget(self) -> None:
        """As if no sample had come."""
        self._first_series = self._series[-1] + 1 if self._series else self._first_series
        self._times_s.clear()
        self._turned.clear()
        self._series.clear()

    def begin(self, t_s: float) -> None:
        """Take a sample after a silence: how the body turned in that, nobody knows."""
        series = self._series[-1] + 1 if self._series else self._first_series
        turned = self._turned[-1] if self._turned else np.array([1.0, 0.0, 0.0, 0.0])
        self._append(t_s, series, turned)

    def turn(self, t_s: float, rotation_rad: Array) -> None:
        """Take a sample, until which the body turned by a rotation vector (3,) about its axes."""
        turned = quat_multiply(self._turned[-1], quat_from_vector(rotation_rad))
        self._append(t_s, self._series[-1], turned / math.sqrt(turned @ turned))

    def between(self, t0_s: float, t1_s: float) -> Array | None:
        """quat_wxyz (4,) of R_body0_body1; None where a silence lies between, and outside.

        The newest rate holds for a moment.
        """
        zero, one = self._until(t0_s), self._until(t1_s)
        if zero is None or one is None or zero[0] != one[0]:
            return None
        return quat_multiply(quat_conjugate(zero[1]), one[1])

    def rate_rad_s(self, t_s: float) -> float:
        """How fast the body tilted about then; 0 where nothing tells."""
        turn = self.between(t_s - _RATE_OVER_S, t_s)
        return 0.0 if turn is None else 2.0 * math.hypot(*turn[1:3].tolist()) / _RATE_OVER_S

    def _append(self, t_s: float, series: int, turned: Array) -> None:
        self._times_s.append(t_s)
        self._series.append(series)
        self._turned.append(turned)
        old = bisect.bisect_left(self._times_s, t_s - self._length_s) - 1
        if old >= _FORGET_AT_ONCE:
            del self._times_s[:old], self._series[:old], self._turned[:old]

    def _until(self, t_s: float) -> tuple[int, Array] | None:
        if not self._times_s or not self._times_s[0] <= t_s <= self._times_s[-1] + LONGEST_GAP_S:
            return None
        i = min(bisect.bisect_right(self._times_s, t_s), len(self._times_s) - 1)
        if i == 0:
            return self._series[0], self._turned[0]
        if self._series[i] != self._series[i - 1]:
            return (self._series[i], self._turned[i]) if t_s >= self._times_s[i] else None
        t0_s, t1_s = self._times_s[i - 1], self._times_s[i]
        fraction = (t_s - t0_s) / (t1_s - t0_s)
        turned = (1.0 - fraction) * self._turned[i - 1] + fraction * self._turned[i]
        return self._series[i], turned / math.sqrt(turned @ turned)
