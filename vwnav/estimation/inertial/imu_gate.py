"""Whether the IMU feels gravity where the attitude has it, and what the images show it should.

One that is mounted otherwise than the autopilot was told, or broken, tells of accelerations and
turns that nobody flies. None of it is to be believed until it comes right.

One that is shaken may seem to feel it elsewhere by chance; one that is shaken too much to tell
anything is not used either.

An accelerometer that is off by less, a few m/s^2, is known by its witnesses. The ways that images
tell contradict it, which may be the images' fault; but the map still has the aircraft where they
do, and it feels what neither the air at this speed does to it nor a climb that anybody saw.
"""

import math
from collections import deque

import numpy as np

from vwnav.estimation.inertial.attitudes import GRAVITY_M_S2, AttitudeHistory
from vwnav.estimation.inertial.imu import ImuHistory
from vwnav.estimation.inertial.shaking import Shaking
from vwnav.estimation.states import Innovation, Verdict
from vwnav.geometry.rotations import rotation_from_quat
from vwnav.types import Array, ImuSample

_AT_REST_M_S2 = np.array([0.0, 0.0, -GRAVITY_M_S2])
_MOST_M_S2 = 160.0  # 16 g: one absurd sample shall not count for minutes
_SHORT_S, _LONG_S = 0.5, 10.0
# From gravity, and from what rotors push with, on the short average: 50 degrees of lean are flown.
_FOREIGN_M_S2, _UNPUSHED_M_S2 = 7.0, 5.0
_FOREIGN_LONG_M_S2 = 3.0  # on the long one no aircraft accelerates so much
_AGAIN = 0.5  # of these bounds: nearer to them it is not believed again
_THRUST_M_S2 = (2.0, 40.0)  # of rotors, upward along the body's axis
_LONGEST_S = 1.0  # of silence that a sample stands for
_LEAST_WAYS = 2  # refused in a row ...
_PROOF_M_S2 = 8.0  # ... and so many, times what is not explained
_FIXES_S, _LEAST_FIXES = 2.0, 2  # of the map, that were taken meanwhile
_UNEXPLAINED_M_S2 = 2.0  # across the thrust, by the air; or up and down
_EXPLAINED_M_S2, _EXPLAINED_S = 1.0, 10.0  # for so long at most so much: it is believed again
_LOST = (
    "the autopilot's IMU is not used: gravity {:.1f} m/s^2 from where its attitude has it; "
    "check its orientation and calibration"
)
_CONTRADICTS = (
    "the autopilot's IMU is not used: its accelerometer is off by {:.1f} m/s^2, as pictures and "
    "map show; have it checked"
)
_SHAKEN = (
    "the autopilot's IMU is not used: it is shaken too much to tell how the aircraft flies; "
    "balance the propellers"
)
_AGREES = "the autopilot's IMU feels gravity where its attitude has it again: it is used"


class ImuGate:
    """Lets samples into the history.

    It averages what they feel, in the body and as the attitude turns it into NED.

    Attributes:
        lost: none is to be believed.
        fixes_s: times of the newest map fixes that were taken; who takes one adds it.
    """

    def __init__(self, attitudes: AttitudeHistory, imu: ImuHistory) -> None:
        self._attitudes = attitudes
        self._imu = imu
        self._body = _Average(_SHORT_S)
        self._ned = _Average(_SHORT_S)
        self._ned_long = _Average(_LONG_S)
        self._shaking = Shaking()
        self._newest_s = math.inf
        self.fixes_s: deque[float] = deque(maxlen=_LEAST_FIXES)
        self._unexplained_m_s2 = 0.0  # by the air, of the newest drag
        self._off_m_s2 = 0.0  # where its witnesses contradict it
        self._off_s = -math.inf
        self.lost = False

    @property
    def off_m_s2(self) -> float:
        """How far from gravity it feels, on the shorter average."""
        return self._ned.from_rest_m_s2

    @property
    def words(self) -> str:
        """What a change has come to."""
        if not self.lost:
            return _AGREES
        if self._shaking.too_much:
            return _SHAKEN
        return (_CONTRADICTS if self._is_off else _LOST).format(self._off_m_s2 or self.off_m_s2)

    @property
    def _is_off(self) -> bool:
        return self._off_m_s2 > 0.0

    def take(self, sample: ImuSample) -> Verdict:
        """Put a sample into the history, or say why not; what was believed before goes with it."""
        believed = self._imu.believes(sample)
        self._shaking.take(sample)
        held = self._attitudes.held(sample.t_s)
        if believed and held.known:
            self._average(sample, held.quat_wxyz)
        lost = self._is_foreign() or self._shaking.too_much or self._is_off
        if lost and not self.lost:
            self._imu.forget()
        self.lost = lost
        if lost:
            return Verdict.DISTRUSTED
        if not believed:
            return Verdict.GATED
        return Verdict.FUSED if self._imu.add(sample) else Verdict.TOO_LATE

    def refused_ways(self, count: int, t_s: float) -> bool:
        """Whether so many ways of images, refused in a row until now, have made it lost."""
        climb_m_s2 = abs(float(self._ned.value[2]) + GRAVITY_M_S2)
        off_m_s2 = max(self._unexplained_m_s2, climb_m_s2)
        proved = count >= _LEAST_WAYS and count * off_m_s2 >= _PROOF_M_S2
        placed = len(self.fixes_s) == _LEAST_FIXES and t_s - self.fixes_s[0] < _FIXES_S
        least_m_s2 = max(_UNEXPLAINED_M_S2, self._shaking.chance_m_s2(_SHORT_S))
        if self.lost or off_m_s2 < least_m_s2 or not (proved and placed):
            return False
        self._off_m_s2, self._off_s, self.lost = off_m_s2, t_s, True
        self._unexplained_m_s2 = 0.0  # no drag is compared until it is believed again
        self._imu.forget()
        return True

    def saw_drag(self, drag: Innovation) -> None:
        """What the air does was compared with what it felt."""
        self._unexplained_m_s2 = 0.0
        if drag.verdict is Verdict.GATED and drag.residual is not None:
            self._unexplained_m_s2 = float(np.linalg.norm(drag.residual))

    def compare(self, explained_m_s2: Array, sigma_m_s2: float, t_s: float) -> None:
        """While it is not believed: with what it should feel across the thrust (2,)."""
        off_m_s2 = float(np.linalg.norm(self._body.value[:2] - explained_m_s2))
        chance_m_s2 = self._shaking.chance_m_s2(_SHORT_S)
        if off_m_s2 > _EXPLAINED_M_S2 + 2.0 * sigma_m_s2 + chance_m_s2:
            self._off_s = t_s
        elif t_s - self._off_s > _EXPLAINED_S:
            self._off_m_s2 = 0.0

    def _average(self, sample: ImuSample, quat_wxyz: Array) -> None:
        """Of what is felt in an attitude (4,)."""
        span_s = min(max(sample.t_s - self._newest_s, 0.0), _LONGEST_S)
        self._newest_s = sample.t_s
        force = np.minimum(np.maximum(sample.specific_force_m_s2, -_MOST_M_S2), _MOST_M_S2)
        force_ned = rotation_from_quat(quat_wxyz) @ force
        self._body.add(force, span_s)
        self._ned.add(force_ned, span_s)
        self._ned_long.add(force_ned, span_s)

    def _is_foreign(self) -> bool:
        """Whether it feels gravity elsewhere, by more than chance."""
        share = _AGAIN if self.lost else 1.0
        chance_m_s2 = self._shaking.chance_m_s2(_SHORT_S)
        unpushed = _from_thrust_m_s2(self._body.value) > share * _UNPUSHED_M_S2 + chance_m_s2
        if unpushed and self.off_m_s2 > share * _FOREIGN_M_S2 + chance_m_s2:
            return True
        chance_m_s2 = self._shaking.chance_m_s2(_LONG_S)
        return self._ned_long.from_rest_m_s2 > share * _FOREIGN_LONG_M_S2 + chance_m_s2


class _Average:
    """Of a force (3,), m/s^2, exponentially forgotten; at rest at first."""

    def __init__(self, over_s: float) -> None:
        self.value: Array = _AT_REST_M_S2
        self._over_s = over_s

    def add(self, force: Array, span_s: float) -> None:
        self.value = self.value - math.expm1(-span_s / self._over_s) * (force - self.value)

    @property
    def from_rest_m_s2(self) -> float:
        return math.hypot(*(self.value - _AT_REST_M_S2).tolist())


def _from_thrust_m_s2(force_body: Array) -> float:
    """How far a specific force (3,) is from what rotors alone push with."""
    forward, right, down = force_body.tolist()
    least, most = _THRUST_M_S2
    return math.hypot(forward, right, down + min(max(-down, least), most))
