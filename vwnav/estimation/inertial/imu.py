"""The autopilot's IMU, integrated: what it felt up to any moment of the last seconds."""

import bisect
import math

import numpy as np

from vwnav.estimation.inertial.attitudes import LONGEST_GAP_S, AttitudeHistory
from vwnav.estimation.inertial.integrals import ImuIntegrals
from vwnav.geometry.rotations import rotation_from_quat
from vwnav.types import Array, ImuSample

_FORGET_AT_ONCE = 1000  # samples
_SHAKE_S = 1.0  # over which the scatter of the samples is averaged
SCATTER_OF_BEND = 6.0 * 3.0  # x0 - 2 x1 + x2 of independent noise s^2 on three axes: 18 s^2
_MOST_FORCE_M_S2 = 320.0  # 32 g and 4000 deg/s: no sensor measures more
_MOST_RATE_RAD_S = 70.0
# What an aircraft feels in flight and at a hard landing, and by how much it changes between samples
_FELT_M_S2, _FELT_RAD_S = 60.0, 17.0
_SUDDEN_M_S2, _SUDDEN_RAD_S = 30.0, 8.0


class ImuHistory:
    """Running integrals over the samples: any span is a difference of two of them.

    Attributes:
        slipped_s: by how much the last one was dated later than the sensor's own clock says; 0
            where it was refused.
    """

    def __init__(self, attitudes: AttitudeHistory, length_s: float) -> None:
        """Prepare; the gyro of the attitudes is told every sample."""
        self._attitudes = attitudes
        self._gyro = attitudes.gyro
        self._length_s = length_s
        self._times_s: list[float] = []
        self._felt: list[ImuIntegrals] = []
        self._newest: tuple[Array, Array] = (np.zeros((3, 5)), np.zeros(6))
        self._slope = np.zeros(6)  # of the newest sample against the one before
        self._scatter = np.zeros(2)  # variance per axis of force and rates
        self._sudden: tuple[float, Array] | None = None  # the newest sample, believed or not
        self._doubted = np.zeros(2)  # variances that refused samples since the newest one add
        self._series = 0  # of the first sample
        self.slipped_s = 0.0
        self._missed = False  # one was refused since the newest

    @property
    def heard(self) -> bool:
        """Whether a sample ever came."""
        return bool(self._times_s)

    @property
    def newest_s(self) -> float:
        """Time of the newest sample, minus infinity before the first."""
        return self._times_s[-1] if self._times_s else -math.inf

    @property
    def rate_rad_s(self) -> float:
        """How fast it turned at the newest sample."""
        rates = self._newest[1][3:]
        return math.sqrt(float(rates @ rates))

    def believes(self, sample: ImuSample) -> bool:
        """Whether an aircraft can feel this; what comes suddenly must be felt twice."""
        self.slipped_s = 0.0
        if sample.t_s <= self.newest_s:
            return True  # too late to be compared, and to be added
        values = np.concatenate([sample.specific_force_m_s2, sample.rates_rad_s])
        silent = sample.t_s > self.newest_s + LONGEST_GAP_S
        before, self._sudden = self._sudden, (sample.t_s, values)
        if _within(values, _FELT_M_S2, _FELT_RAD_S):
            if silent or _within(values - self._newest[1], _SUDDEN_M_S2, _SUDDEN_RAD_S):
                return True
            if before is not None and sample.t_s < before[0] + LONGEST_GAP_S:
                return _within(values - before[1], _SUDDEN_M_S2, _SUDDEN_RAD_S)
        if not silent:
            self._doubt(values - self._newest[1], sample.t_s - self.newest_s)
        self.miss()
        return False

    def miss(self) -> None:
        """One was refused: of the next one's own clock nobody knows how long it has counted."""
        self.slipped_s, self._missed = 0.0, True

    def _doubt(self, change: Array, span_s: float) -> None:
        """A sample is refused: wrong, or a blow too short for others."""
        force, rates = change[:3], change[3:]
        most = np.array([_MOST_FORCE_M_S2, _MOST_RATE_RAD_S])
        size = np.minimum([math.sqrt(force @ force), math.sqrt(rates @ rates)], most)
        self._doubted += (0.5 * span_s * size) ** 2

    def add(self, sample: ImuSample) -> bool:
        """Take the next sample; False when it is not later than the newest."""
        if self._times_s and sample.t_s <= self._times_s[-1]:
            return False
        values = np.concatenate([sample.specific_force_m_s2, sample.rates_rad_s])
        span_s = self._span_s(sample)
        self.slipped_s = 0.0 if span_s is None else sample.t_s - self._times_s[-1] - span_s
        self._missed = False
        self._turn(sample.t_s, values[3:], span_s)
        held = self._attitudes.held(sample.t_s)
        R = rotation_from_quat(held.quat_wxyz)
        force = sample.specific_force_m_s2
        now = np.empty((3, 5))
        now[:, :3], now[:, 3], now[:, 4] = R, R @ force, force
        self._felt.append(self._next(span_s, held.known, now, values))
        self._times_s.append(sample.t_s)
        self._newest = now, values
        old = bisect.bisect_left(self._times_s, sample.t_s - self._length_s) - 1
        if old >= _FORGET_AT_ONCE:
            del self._times_s[:old], self._felt[:old]
        return True

    def forget(self) -> None:
        """As if no sample had come, of rates neither."""
        self._series = self._felt[-1].series + 1 if self._felt else self._series
        self._times_s.clear()
        self._felt.clear()
        self._sudden = None
        self._doubted = np.zeros(2)
        self._gyro.forget()

    def until(self, t_s: float) -> ImuIntegrals | None:
        """All that was felt until `t_s`; None before the first sample and in a silence.

        The newest sample holds for a moment: estimates look a little ahead of it.
        """
        if not self._times_s or not self._times_s[0] <= t_s <= self._times_s[-1] + LONGEST_GAP_S:
            return None
        i = min(bisect.bisect_right(self._times_s, t_s), len(self._times_s) - 1)
        one, t1_s = self._felt[i], self._times_s[i]
        if i == 0 or self._felt[i - 1].series != one.series:
            return one if t_s == t1_s else None  # alone it tells of its own moment
        zero, t0_s = self._felt[i - 1], self._times_s[i - 1]
        fraction = (min(t_s, t1_s) - t0_s) / (t1_s - t0_s)
        if t_s > t1_s:  # by the sensor's own clock: its dates may lie together, or apart
            fraction += (t_s - t1_s) / (one.span_s - zero.span_s)
        turned = (1.0 - fraction) * zero.turned + fraction * one.turned
        return ImuIntegrals(
            one.series,
            zero.span_s + fraction * (one.span_s - zero.span_s),
            zero.integrals + fraction * (one.integrals - zero.integrals),
            turned / math.sqrt(turned @ turned),
            zero.variances + fraction * (one.variances - zero.variances),
        )

    def _span_s(self, sample: ImuSample) -> float | None:
        """Since the sample before; None for the first one and after a silence."""
        if not self._times_s:
            return None
        span_s = sample.span_s
        if span_s is None or self._missed:
            span_s = sample.t_s - self._times_s[-1]
        return span_s if span_s <= LONGEST_GAP_S else None

    def _turn(self, t_s: float, rates_rad_s: Array, span_s: float | None) -> None:
        """Tell the gyro's history, by the trapezoidal rule."""
        if span_s is None:
            self._gyro.begin(t_s)
        else:
            self._gyro.turn(t_s, (0.5 * span_s) * (self._newest[1][3:] + rates_rad_s), span_s)

    def _next(self, span_s: float | None, leans: bool, now: Array, values: Array) -> ImuIntegrals:
        """Add a sample to the integrals, by the trapezoidal rule; `leans`: it is known how."""
        turned = self._gyro.newest
        if not self._felt:
            return ImuIntegrals(self._series, 0.0, np.zeros((3, 5)), turned, np.zeros(2))
        zero, (integrand, before) = self._felt[-1], self._newest
        if span_s is None or not leans:
            return ImuIntegrals(
                zero.series + 1, zero.span_s, zero.integrals, turned, zero.variances
            )
        self._learn_scatter(values - before, span_s)
        doubted, self._doubted = self._doubted, np.zeros(2)
        return ImuIntegrals(
            zero.series,
            zero.span_s + span_s,
            zero.integrals + (0.5 * span_s) * (integrand + now),
            turned,
            zero.variances + span_s**2 * self._scatter + doubted,
        )

    def _learn_scatter(self, slope: Array, span_s: float) -> None:
        """From how the samples bend: a manoeuvre is smooth beside what rotors do."""
        bend, self._slope = slope - self._slope, slope
        seen = np.array([bend[:3] @ bend[:3], bend[3:] @ bend[3:]]) / SCATTER_OF_BEND
        self._scatter += -math.expm1(-span_s / _SHAKE_S) * (seen - self._scatter)


def _within(values: Array, force_m_s2: float, rate_rad_s: float) -> bool:
    """Whether force and rates (6,) are shorter than that."""
    force, rates = values[:3], values[3:]
    return float(force @ force) < force_m_s2**2 and float(rates @ rates) < rate_rad_s**2


def is_felt(sample: ImuSample) -> bool:
    """Whether its numbers are finite."""
    force, rates = np.asarray(sample.specific_force_m_s2), np.asarray(sample.rates_rad_s)
    if force.shape != (3,) or rates.shape != (3,):
        return False
    if sample.span_s is not None and not sample.span_s > 0.0:
        return False
    return math.isfinite(float(force.sum())) and math.isfinite(float(rates.sum()))
