"""The autopilot's IMU, integrated between any two moments of the last seconds."""

import bisect
import math
from dataclasses import dataclass

import numpy as np

from vwnav.estimation.attitudes import AttitudeHistory
from vwnav.geometry.rotations import (
    quat_conjugate,
    quat_from_vector,
    quat_multiply,
    rotation_from_quat,
)
from vwnav.types import Array, ImuSample

_LONGEST_GAP_S = 0.05  # between samples; a longer one is a silence
_FORGET_AT_ONCE = 1000  # samples; the sums then restart, or they would lose digits over hours
_MOST_FORCE_M_S2 = 320.0  # 32 g and 4000 deg/s: no sensor measures more
_MOST_RATE_RAD_S = 70.0


@dataclass(frozen=True, slots=True, eq=False)
class Push:
    """What the IMU felt over a span, in NED as the autopilot's attitude has it.

    Attributes:
        velocity_m_s: (3,) integral of R_ned_body f, gravity still in it.
        rotation_s: (3, 3) integral of R_ned_body: what a bias of the accelerometer or of the gyro
            adds up to.
        turn_wxyz: (4,) the rotation that the gyro counted, R_body0_body1.
        shaken_m2_s2, shaken_rad2: variance per axis of velocity and turn by what happened between
            samples: rotors shake the sensors faster than they are heard.
    """

    velocity_m_s: Array
    rotation_s: Array
    turn_wxyz: Array
    shaken_m2_s2: float
    shaken_rad2: float


@dataclass(frozen=True, slots=True, eq=False)
class _Total:
    """Integrals up to a sample, since the first one that is kept.

    Attributes:
        pushed: (3, 4) those of R_ned_body and of R_ned_body f, side by side.
        turned: (4,) quaternion, the product of all turns.
        shaken: (2,) variances of the integrals of force and rates.
        starts: nothing is known between this sample and the one before.
    """

    t_s: float
    pushed: Array
    turned: Array
    shaken: Array
    starts: bool


class ImuHistory:
    """Running integrals over the samples: any span is a difference of two of them."""

    def __init__(self, attitudes: AttitudeHistory, length_s: float) -> None:
        self._attitudes = attitudes
        self._length_s = length_s
        self._totals: list[_Total] = []
        self._last: tuple[Array, Array] = (np.zeros((3, 4)), np.zeros(6))  # of the newest sample

    def add(self, sample: ImuSample) -> bool:
        """Take the next sample; False when it is not later than the newest."""
        if self._totals and sample.t_s <= self._totals[-1].t_s:
            return False
        R = rotation_from_quat(self._attitudes.quat_at(sample.t_s))
        now = np.column_stack([R, R @ sample.specific_force_m_s2])
        felt = np.concatenate([sample.specific_force_m_s2, sample.rates_rad_s])
        self._totals.append(self._total(sample.t_s, now, felt))
        self._last = now, felt
        self._forget()
        return True

    def between(self, t0_s: float, t1_s: float) -> Push | None:
        """The push from `t0_s` to `t1_s`; None where samples do not cover the span."""
        if not self._totals or t0_s < self._totals[0].t_s:
            return None
        last_s = self._totals[-1].t_s
        # The newest sample holds for a moment: estimates look a little ahead of it.
        if t0_s > last_s or t1_s > last_s + _LONGEST_GAP_S:
            return None
        first, end = self._after(t0_s), self._after(t1_s)
        if any(total.starts for total in self._totals[first : end + 1]):
            return None
        pushed0, turned0, shaken0 = self._at(t0_s)
        pushed1, turned1, shaken1 = self._at(t1_s)
        pushed, shaken = pushed1 - pushed0, shaken1 - shaken0
        turn = quat_multiply(quat_conjugate(turned0), turned1)
        return Push(pushed[:, 3], pushed[:, :3], turn, float(shaken[0]), float(shaken[1]))

    def _total(self, t_s: float, now: Array, felt: Array) -> _Total:
        """Add a sample to the sums, by the trapezoidal rule."""
        if not self._totals:
            return _Total(t_s, np.zeros((3, 4)), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(2), True)
        newest = self._totals[-1]
        span_s = t_s - newest.t_s
        if span_s > _LONGEST_GAP_S:
            return _Total(t_s, newest.pushed, newest.turned, newest.shaken, True)
        pushed_before, felt_before = self._last
        change = felt - felt_before
        # Two neighbours of independent noise s^2 differ by 2 s^2 per axis; each lasts a span.
        force2, rate2 = float(change[:3] @ change[:3]), float(change[3:] @ change[3:])
        return _Total(
            t_s,
            newest.pushed + (0.5 * span_s) * (pushed_before + now),
            quat_multiply(
                newest.turned, quat_from_vector((0.5 * span_s) * (felt_before + felt)[3:])
            ),
            newest.shaken + span_s**2 / 6.0 * np.array([force2, rate2]),
            False,
        )

    def _after(self, t_s: float) -> int:
        """Index of the first sample later than `t_s`, at most the newest one."""
        after = bisect.bisect_right(self._totals, t_s, key=lambda total: total.t_s)
        return min(after, len(self._totals) - 1)

    def _at(self, t_s: float) -> tuple[Array, Array, Array]:
        """The totals at a time: interpolated, or carried on as between the last two samples."""
        i = self._after(t_s)
        one = self._totals[i]
        if i == 0:
            return one.pushed, one.turned, one.shaken
        zero = self._totals[i - 1]
        fraction = (t_s - zero.t_s) / (one.t_s - zero.t_s)
        turned = (1.0 - fraction) * zero.turned + fraction * one.turned
        return (
            zero.pushed + fraction * (one.pushed - zero.pushed),
            turned / math.sqrt(turned @ turned),
            zero.shaken + fraction * (one.shaken - zero.shaken),
        )

    def _forget(self) -> None:
        limit_s = self._totals[-1].t_s - self._length_s
        old = bisect.bisect_left(self._totals, limit_s, key=lambda total: total.t_s) - 1
        if old < _FORGET_AT_ONCE:
            return
        base = self._totals[old]
        back = quat_conjugate(base.turned)
        self._totals = [
            _Total(
                total.t_s,
                total.pushed - base.pushed,
                quat_multiply(back, total.turned),
                total.shaken - base.shaken,
                total.starts,
            )
            for total in self._totals[old:]
        ]


def is_sensible(sample: ImuSample) -> bool:
    """Whether it is finite and within what a sensor can measure."""
    force, rates = np.asarray(sample.specific_force_m_s2), np.asarray(sample.rates_rad_s)
    if not math.isfinite(sample.t_s) or force.shape != (3,) or rates.shape != (3,):
        return False
    # Not a number is not smaller than anything.
    return bool(
        np.all(np.abs(force) < _MOST_FORCE_M_S2) and np.all(np.abs(rates) < _MOST_RATE_RAD_S)
    )
