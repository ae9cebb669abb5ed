"""The autopilot's accelerometer, integrated between any two moments of the last seconds."""

import bisect
from dataclasses import dataclass

import numpy as np

from vwnav.estimation.attitudes import AttitudeHistory
from vwnav.geometry.rotations import rotation_from_quat
from vwnav.types import Array, ImuSample

_LONGEST_GAP_S = 0.05  # between samples; a longer one is a silence
_FORGET_AT_ONCE = 1000  # samples; the sums then restart, or they would lose digits over hours


@dataclass(frozen=True, slots=True, eq=False)
class Push:
    """What the accelerometer felt over a span, in NED as the autopilot's attitude has it.

    Attributes:
        velocity_m_s: (3,) integral of R_ned_body f, gravity still in it.
        rotation_s: (3, 3) integral of R_ned_body: what a bias of the accelerometer adds up to.
    """

    velocity_m_s: Array
    rotation_s: Array


class ImuHistory:
    """Running integrals over the samples: any span is a difference of two of them."""

    def __init__(self, attitudes: AttitudeHistory, length_s: float) -> None:
        self._attitudes = attitudes
        self._length_s = length_s
        self._times_s: list[float] = []
        self._sums: list[Array] = []  # (3, 4): integrals of R and of R f, side by side
        self._starts: list[bool] = []  # nothing is known between this sample and the one before

    def add(self, sample: ImuSample) -> bool:
        """Take the next sample; False when it is not later than the newest."""
        if self._times_s and sample.t_s <= self._times_s[-1]:
            return False
        R = rotation_from_quat(self._attitudes.quat_at(sample.t_s))
        now = np.column_stack([R, R @ sample.specific_force_m_s2])
        span_s = sample.t_s - self._times_s[-1] if self._times_s else np.inf
        silent = span_s > _LONGEST_GAP_S
        before = self._sums[-1] if self._sums else np.zeros((3, 4))
        self._sums.append(before if silent else before + span_s * now)
        self._times_s.append(sample.t_s)
        self._starts.append(silent)
        self._forget()
        return True

    def between(self, t0_s: float, t1_s: float) -> Push | None:
        """The push from `t0_s` to `t1_s`; None where samples do not cover the span."""
        if not self._times_s or t0_s < self._times_s[0]:
            return None
        last_s = self._times_s[-1]
        # The newest sample holds for a moment: estimates look a little ahead of it.
        if t0_s > last_s or t1_s > last_s + _LONGEST_GAP_S:
            return None
        first = bisect.bisect_right(self._times_s, t0_s)
        end = bisect.bisect_left(self._times_s, t1_s)
        if any(self._starts[first : end + 1]):
            return None
        change = self._at(t1_s) - self._at(t0_s)
        return Push(change[:, 3], change[:, :3])

    def _at(self, t_s: float) -> Array:
        i = min(bisect.bisect_right(self._times_s, t_s), len(self._times_s) - 1)
        if i == 0:
            return self._sums[0]
        t0_s, t1_s = self._times_s[i - 1], self._times_s[i]
        fraction = (t_s - t0_s) / (t1_s - t0_s)
        return np.asarray(self._sums[i - 1] + fraction * (self._sums[i] - self._sums[i - 1]))

    def _forget(self) -> None:
        old = bisect.bisect_left(self._times_s, self._times_s[-1] - self._length_s) - 1
        if old < _FORGET_AT_ONCE:
            return
        del self._times_s[:old], self._sums[:old], self._starts[:old]
        base = self._sums[0]
        self._sums = [total - base for total in self._sums]
