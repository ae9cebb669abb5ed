"""The autopilot's attitude over the last seconds, and the turns that its gyro has counted."""

import bisect
import math
from collections import deque
from typing import NamedTuple

import numpy as np

from vwnav.estimation.inertial.integrals import Exposure
from vwnav.geometry.rotations import (
    MOST_TURN_RAD_S,
    quat_conjugate,
    quat_from_vector,
    quat_multiply,
    vector_from_quat,
)
from vwnav.types import Array, Attitude

GRAVITY_M_S2 = 9.80665
TURNING_RAD_S = 1.5  # how fast an unseen aircraft may turn
MAX_GAP_S = 0.25  # neighbours farther apart are not interpolated between
_TURN_ON_S = 0.1  # an attitude is carried on for so long after the newest one
_KNOWN_AHEAD_S = 0.04  # for so long it is known well enough for an image
_CARRIED_S = 5.0  # the same by the gyro, which drifts by some tenths of a degree a second at worst
_TURN_ON_SPANS = 5.0  # two samples that lie close tell no rate
_LEAST_COS_LEAN = 0.5
_LARGEST_TILT_TANGENT = 1.2  # 50 degrees: beyond it thrust says little about acceleration
LONGEST_GAP_S = 0.1  # between samples of the gyro; a longer one is a silence
_TURNS_OVER_S = 0.01  # either way of a moment, to tell how the body turns then
_TILTED_S = 0.02  # and before an image, to tell how fast it tilted until then
_FORGET_AT_ONCE = 1000  # samples
_MOST_SLIPS = 8  # of the clock, the newest


class GyroHistory:
    """The product of all turns up to any moment: what lies between two of them is a quotient.

    Attributes:
        newest_s: time of the newest sample, minus infinity before the first.
    """

    def __init__(self, length_s: float) -> None:
        self.newest_s = -math.inf
        self._length_s = length_s
        self._times_s: list[float] = []
        self._turned: list[Array] = []
        self._series: list[int] = []  # samples between silences share a number
        self._first_series = 0
        self._span_s = 0.0  # from the sample before to the newest
        self._slips = deque[tuple[float, float]](maxlen=_MOST_SLIPS)

    @property
    def newest(self) -> Array:
        """(4,) the product up to the newest sample; there is one."""
        return self._turned[-1]

    def forget(self) -> None:
        """As if no sample had come."""
        self.newest_s = -math.inf
        self._first_series = self._series[-1] + 1 if self._series else self._first_series
        self._times_s.clear()
        self._turned.clear()
        self._series.clear()
        self._slips.clear()

    def begin(self, t_s: float) -> None:
        """Take a sample after a silence: how the body turned in that, nobody knows."""
        series = self._series[-1] + 1 if self._series else self._first_series
        turned = self._turned[-1] if self._turned else np.array([1.0, 0.0, 0.0, 0.0])
        self._append(t_s, series, turned)

    def turn(self, t_s: float, rotation_rad: Array, span_s: float) -> None:
        """Take a sample, until which the body turned by a rotation vector (3,) about its axes.

        `span_s` since the one before is by the sensor's own clock: dates may lie together or apart.
        """
        self._span_s = span_s
        if t_s - self.newest_s - span_s > LONGEST_GAP_S:
            self._slips.append((self.newest_s, t_s))
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

    def slips(self, t_s: float) -> bool:
        """Whether dates jump there beyond what the sensor's clock counted: nobody knows which."""
        return any(before_s < t_s < after_s for before_s, after_s in self._slips)

    def _append(self, t_s: float, series: int, turned: Array) -> None:
        self.newest_s = t_s
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
        t1_s = self._times_s[i]
        if i == 0 or self._series[i] != self._series[i - 1]:
            alone = self._series[i], self._turned[i]
            return alone if t_s == t1_s else None  # it tells of its own moment
        t0_s = self._times_s[i - 1]
        fraction = (min(t_s, t1_s) - t0_s) / (t1_s - t0_s)
        if t_s > t1_s:
            fraction += (t_s - t1_s) / self._span_s
        turned = (1.0 - fraction) * self._turned[i - 1] + fraction * self._turned[i]
        return self._series[i], turned / math.sqrt(turned @ turned)


class Held(NamedTuple):
    """The attitude at a time, as well as it is known.

    Attributes:
        quat_wxyz: (4,).
        known: whether it is known how the aircraft leans: the newest is held as long as a gap.
        open_rad: how far it may have turned with neither attitude nor gyro to tell.
        from_wxyz: (4,) the autopilot's last one, where the gyro has turned it on to this.
    """

    quat_wxyz: Array
    known: bool
    open_rad: float = 0.0
    from_wxyz: Array | None = None


class AttitudeHistory:
    """Attitudes in order of time, looked up by time.

    Where none came, or none has come yet, the gyro carries the last one on.

    Attributes:
        gyro: the turns that it has counted.
        newest_s: time of the newest attitude, minus infinity before the first.
        refused_s: times of attitudes that were refused and not believed since.
    """

    def __init__(self, length_s: float, max_gap_s: float = MAX_GAP_S) -> None:
        self.gyro = GyroHistory(length_s)
        self.newest_s = -math.inf
        self.refused_s: set[float] = set()
        self._length_s = length_s
        self._max_gap_s = max_gap_s
        self._times_s: list[float] = []
        self._quats: list[Array] = []

    def add(self, attitude: Attitude) -> None:
        """Keep an attitude, whatever its order; a second one of the same time is dropped."""
        i = bisect.bisect_left(self._times_s, attitude.t_s)
        if i < len(self._times_s) and self._times_s[i] == attitude.t_s:
            return
        quat = np.asarray(attitude.quat_wxyz, dtype=np.float64)
        self._times_s.insert(i, attitude.t_s)
        self._quats.insert(i, quat / math.sqrt(quat @ quat))
        self.newest_s = self._times_s[-1]
        # The newest before the window stays: it holds until the next one.
        old = bisect.bisect_left(self._times_s, self._times_s[-1] - self._length_s) - 1
        if old > 0:
            del self._times_s[:old]
            del self._quats[:old]

    def at(self, t_s: float) -> Attitude | None:
        """The attitude at a time; None where telemetry does not reach.

        That is before the first one and, where no gyro tells, in gaps of more than 0.25 s and more
        than 0.04 s beyond the newest: a multirotor's rate changes by 400 deg/s in a second, so that
        a tenth leaves it 2 degrees off, 1.7 m at 50 m.
        """
        i = bisect.bisect_left(self._times_s, t_s)
        if i < len(self._times_s) and self._times_s[i] == t_s:
            return Attitude(t_s, self._quats[i])
        ahead_s = _KNOWN_AHEAD_S if math.isfinite(self._max_gap_s) else math.inf
        is_late = i == len(self._times_s) and t_s > self.newest_s + ahead_s
        if i == 0 or (is_late and self._carried(i - 1, t_s) is None) or self.gyro.slips(t_s):
            return None
        held = self.held(t_s)
        return Attitude(t_s, held.quat_wxyz) if held.known else None

    def __contains__(self, t_s: float) -> bool:
        i = bisect.bisect_left(self._times_s, t_s)
        return i < len(self._times_s) and self._times_s[i] == t_s

    def knows(self, t_s: float) -> bool:
        """`Held.known` alone: every prediction asks it of its beginning, whose attitude it has."""
        after = bisect.bisect_right(self._times_s, t_s)
        if after == 0:
            return False
        later_s = self._times_s[after] if after < len(self._times_s) else t_s
        near = later_s - self._times_s[after - 1] <= self._max_gap_s
        return near or self._carried(after - 1, t_s) is not None

    def forget_after(self, t_s: float) -> None:
        """Drop attitudes later than a time."""
        i = bisect.bisect_right(self._times_s, t_s)
        del self._times_s[i:]
        del self._quats[i:]
        self.newest_s = self._times_s[-1] if self._times_s else -math.inf

    def held(self, t_s: float) -> Held:
        """The attitude at a time, or what comes nearest to it.

        Held before the first one. After the last one, and in a gap, it turns as the gyro says.
        Level and facing north when no attitude ever came.
        """
        after = bisect.bisect_right(self._times_s, t_s)
        if after == 0:
            quat = self._quats[0] if self._quats else np.array([1.0, 0.0, 0.0, 0.0])
            return Held(quat, known=False)
        before_s = self._times_s[after - 1]
        is_last = after == len(self._times_s)
        near = (t_s if is_last else self._times_s[after]) - before_s <= self._max_gap_s
        is_open = self.gyro.newest_s > before_s and t_s > before_s if is_last else not near
        carried = self._carried(after - 1, t_s) if is_open else None
        if carried is not None:
            return Held(carried, known=True, from_wxyz=self._quats[after - 1])
        unheard_s = 0.0 if near else max(t_s - self.newest_s - MAX_GAP_S, 0.0)
        return Held(self._interpolated(t_s, after), near, TURNING_RAD_S * unheard_s)

    def _interpolated(self, t_s: float, after: int) -> Array:
        """(4,) between the attitude before `after` and that one; beyond the last it turns on.

        At the last rate for a tenth of a second, then it holds: in a turn of 90 deg/s an attitude
        30 ms old is 3 degrees wrong. Neighbours are some 20 ms apart, where normalised linear
        interpolation differs from slerp by less than 1e-5 rad.
        """
        i = min(after, len(self._times_s) - 1)
        if i == 0:
            return self._quats[0]
        t0_s, t1_s = self._times_s[i - 1], self._times_s[i]
        span_s = t1_s - t0_s
        ahead_s = min(t_s - t1_s, _TURN_ON_S, span_s * _TURN_ON_SPANS)
        fraction = (t_s - t0_s) / span_s if ahead_s <= 0.0 else 1.0 + ahead_s / span_s
        quat0, quat1 = self._quats[i - 1], self._quats[i]
        if quat0 @ quat1 < 0.0:
            quat1 = -quat1
        quat = (1.0 - fraction) * quat0 + fraction * quat1
        return np.asarray(quat / math.sqrt(quat @ quat))

    def _carried(self, i: int, t_s: float) -> Array | None:
        """The i-th attitude, turned on to `t_s` by the gyro."""
        if t_s - self._times_s[i] > _CARRIED_S:
            return None
        turn = self.gyro.between(self._times_s[i], t_s)
        return None if turn is None else quat_multiply(self._quats[i], turn)

    def jumped_rad(self, t0_s: float, t1_s: float) -> float | None:
        """The angle between what attitudes say of a turn and what the gyro does; None without."""
        turn = self.gyro.between(t0_s, t1_s)
        if turn is None:
            return None
        quat0, quat1 = self.held(t0_s).quat_wxyz, self.held(t1_s).quat_wxyz
        told = quat_multiply(quat_conjugate(quat0), quat1)
        return float(np.linalg.norm(vector_from_quat(quat_multiply(quat_conjugate(turn), told))))

    def rates_rad_s(self, t_s: float, over_s: float = _TURNS_OVER_S) -> Array:
        """How fast (3,) the body turns about its axes, in the mean of so long either way.

        As the gyro counted it; without one as the attitudes say.
        """
        t0_s, t1_s = t_s - over_s, t_s + over_s
        turn = self.gyro.between(t0_s, t1_s)
        if turn is None:
            w, x, y, z = self.held(t0_s).quat_wxyz.tolist()
            inverse = np.array([[w, x, y, z], [-x, w, z, -y], [-y, -z, w, x], [-z, y, -x, w]])
            turn = inverse @ self.held(t1_s).quat_wxyz
        half = math.copysign(1.0, turn[0]) * turn[1:]  # sine of half the angle, about the axis
        return np.asarray((1.0 + half @ half / 6.0) * half / over_s)

    def exposure(self, t_s: float, offset_s: float = 0.0) -> Exposure:
        """How an image of that time was held, and how it turned within the offset of its date."""
        quat_wxyz = self.held(t_s).quat_wxyz
        forward, right, down = down_axis(quat_wxyz)
        lean = np.array([forward, right]) / max(down, _LEAST_COS_LEAN)
        # The body's axes in level ones: x has no part to the right there, and y is z cross x.
        half_s = max(0.5 * abs(offset_s), _TILTED_S)
        middle_s = t_s + (half_s if offset_s > 0.0 else -half_s)
        x, y, z = self.rates_rad_s(middle_s, half_s).tolist()
        aside = max(math.hypot(forward, down), _LEAST_COS_LEAN)
        ahead = (x * down - y * forward * right) / aside + z * forward
        below = z * down - (x * forward + y * right * down) / aside
        turns_rad_s = np.array([ahead, y * aside + z * right, below])
        if not turns_rad_s @ turns_rad_s < MOST_TURN_RAD_S**2:
            turns_rad_s = np.zeros(3)
        told, tilts_rad_s = self.at(t_s) is not None, math.hypot(x, y)
        return Exposure(t_s, yaw_of(quat_wxyz), lean, tilts_rad_s, turns_rad_s, told)


def yaw_of(quat_wxyz: Array) -> float:
    """Heading of a unit quaternion of R_ned_body, radians."""
    w, x, y, z = quat_wxyz.tolist()
    return math.atan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))


def thrust_acceleration(quat_wxyz: Array) -> tuple[float, float]:
    """(north, east) m/s^2 of a multirotor that keeps its height: thrust balances gravity.

    Thrust acts along minus the body's down axis d, so the acceleration is -g d_ne / d_down.
    """
    w, x, y, z = quat_wxyz.tolist()
    down = 1.0 - 2.0 * (x * x + y * y)
    north, east = 2.0 * (x * z + w * y), 2.0 * (y * z - w * x)
    tangent = math.hypot(north, east) / max(down, 1e-6)
    if tangent == 0.0:
        return 0.0, 0.0
    size_m_s2 = GRAVITY_M_S2 * min(tangent, _LARGEST_TILT_TANGENT)
    return -size_m_s2 * north / math.hypot(north, east), -size_m_s2 * east / math.hypot(north, east)


def down_axis(quat_wxyz: Array) -> tuple[float, float, float]:
    """The body's down axis along its level forward and right, and down."""
    w, x, y, z = quat_wxyz.tolist()
    north, east = 2.0 * (x * z + w * y), 2.0 * (y * z - w * x)
    yaw_rad = yaw_of(quat_wxyz)
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return c * north + s * east, c * east - s * north, 1.0 - 2.0 * (x * x + y * y)


def level_axes(yaw_rad: float) -> Array:
    """(2, 2) the body's level forward and right, north and east, as columns."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array([[c, -s], [s, c]])


def true_from_autopilot(heading_bias_rad: float) -> Array:
    """(3, 3) from NED as the autopilot's heading has it to true NED: Rz(-bias)."""
    c, s = math.cos(heading_bias_rad), math.sin(heading_bias_rad)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def is_rotation(quat_wxyz: Array) -> bool:
    """Whether it is a finite quaternion of about unit length."""
    quat = np.asarray(quat_wxyz)
    return quat.shape == (4,) and 0.5 < math.hypot(*quat.tolist()) < 2.0
