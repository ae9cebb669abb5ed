"""Which of the attitudes that come are the autopilot's own: those that could have been turned to.

An attitude joins the one before it when the gyro says so or, where none is heard, when a multirotor
can turn so far. What does not join is refused at once and remembered: when more come that join one
another, and nothing joins the old ones any more, the autopilot's own filter has been reset (PX4
moves its heading by 7 to 13 degrees, on the ground too), and they are believed after all. A single
wrong one among right ones never is.
"""

import math

from vwnav.estimation.inertial.attitudes import MAX_GAP_S, AttitudeHistory
from vwnav.estimation.inertial.imu import ImuHistory
from vwnav.estimation.inertial.preintegration import preintegrated
from vwnav.estimation.states import Verdict
from vwnav.geometry.rotations import quat_conjugate, quat_multiply
from vwnav.types import Array, Attitude

_SLACK_RAD = math.radians(4.0)  # filters correct themselves, and stamps are some ms off
_MOST_TURN_RAD_S = math.radians(250.0)  # of a multirotor that carries a camera
_UNHEARD_RAD_S2 = math.radians(400.0)  # its rate may change by so much a second ...
_CARRIED_S = 0.1  # ... after the gyro's newest sample, which is carried on for so long
_LEVEL_RAD = math.radians(4.0)  # a reset that leaves the tilt within this is one of the heading
_ANYWHERE_S = 1.0  # after so long without one an attitude may be any
_ALONE_S = 0.5  # an autopilot that tells its attitude tells its height or its IMU too
_LONG_S, _FORGET = 2.0, 0.9
_MOST_WAITING = 1000  # where nothing ever vouches for them
# How long those that join each other must last, and how many they must be, after ...
_SILENCE = (0.04, 3)  # ... a silence in which it could be turned to
_HEADING_RESET = (0.15, 4)
_RESET = (1.0, 10)  # ... a jump that tilts it too
_UNTOLD_RESET = (3.0, 10)  # ... the same without a gyro, and any while one is silent


class AttitudeGate:
    """Lets attitudes into the history."""

    def __init__(self, attitudes: AttitudeHistory, imu: ImuHistory) -> None:
        self._attitudes = attitudes
        self._imu = imu
        self._waiting: list[Attitude] = []
        self._jumped = False  # what waits could not be turned to
        self._others_s = -math.inf  # time of the newest other measurement of the autopilot
        self._spacing_s = 0.0  # of those: heights of some logs come once a second

    def heard(self, t_s: float) -> None:
        """Something else of the autopilot came."""
        since_s = t_s - self._others_s
        if since_s <= 0.0:
            return
        if since_s < _LONG_S:
            self._spacing_s = max(since_s, _FORGET * self._spacing_s)
        self._others_s = t_s

    def take(self, attitude: Attitude) -> Verdict:
        """Put an attitude into the history, or say why not."""
        newest_s = self._attitudes.newest_s
        if newest_s == -math.inf:
            self._attitudes.add(attitude)
            return Verdict.FUSED
        if attitude.t_s <= newest_s:
            return self._take_late(attitude)
        if not self._unvouched(attitude.t_s) and self._follows(attitude, newest_s):
            self._waiting.clear()
            self._attitudes.add(attitude)
            return Verdict.FUSED
        self._wait(attitude, newest_s)
        if not self._convinced(newest_s):
            return Verdict.GATED
        for waited in self._waiting[:-1]:
            self._believe(self._as_taken(waited) if self._jumped else waited)
        self._believe(attitude)
        self._waiting.clear()
        return Verdict.RELOCATED

    def _as_taken(self, waited: Attitude) -> Attitude:
        """The one before a jump, turned on by the gyro, where one tells.

        State and images of the time in which it waited were taken with that one. Were their past
        another one now, an image's way would begin in the new heading and a bias of the old.
        """
        held = self._attitudes.held(waited.t_s)
        return waited if held.from_wxyz is None else Attitude(waited.t_s, held.quat_wxyz)

    def _believe(self, attitude: Attitude) -> None:
        self._attitudes.refused_s.discard(attitude.t_s)
        self._attitudes.add(attitude)

    def _unvouched(self, t_s: float) -> bool:
        """Whether all that used to come with attitudes is silent."""
        alone_s = max(_ALONE_S, 3.0 * self._spacing_s)
        return -math.inf < self._others_s < t_s - alone_s

    def _take_late(self, attitude: Attitude) -> Verdict:
        """One that comes late must fit between its neighbours."""
        known = self._attitudes.at(attitude.t_s)
        if known is not None and known.t_s in self._attitudes:
            return Verdict.DUPLICATE
        if known is not None and _angle(known.quat_wxyz, attitude.quat_wxyz) <= _SLACK_RAD:
            self._attitudes.add(attitude)
            return Verdict.FUSED
        self._refuse(attitude.t_s)
        return Verdict.GATED

    def _follows(self, attitude: Attitude, newest_s: float) -> bool:
        if attitude.t_s - newest_s > MAX_GAP_S:
            return False
        newest = self._attitudes.at(newest_s)
        assert newest is not None
        return self._joins(newest, attitude)

    def _joins(self, before: Attitude, after: Attitude) -> bool:
        """Whether the aircraft may have turned from one to the other."""
        span_s = after.t_s - before.t_s
        until_s = min(after.t_s, self._imu.newest_s + _CARRIED_S)
        zero, one = self._imu.until(before.t_s), self._imu.until(until_s)
        imu = preintegrated(zero, one) if until_s >= before.t_s else None
        if imu is None:
            apart = _angle(before.quat_wxyz, after.quat_wxyz)
            return apart <= _SLACK_RAD + _MOST_TURN_RAD_S * span_s
        turned = quat_multiply(_unit(before.quat_wxyz), imu.turn_wxyz)
        unheard_s = max(after.t_s - self._imu.newest_s, 0.0)
        open_rad = 0.5 * _UNHEARD_RAD_S2 * unheard_s**2
        open_rad += self._imu.rate_rad_s * (after.t_s - until_s)
        return _angle(turned, after.quat_wxyz) <= _SLACK_RAD + open_rad

    def _wait(self, attitude: Attitude, newest_s: float) -> None:
        self._refuse(attitude.t_s)
        last = self._waiting[-1] if self._waiting else None
        if last is not None and attitude.t_s <= last.t_s:
            return  # it came late among those that wait
        joined = last is not None and attitude.t_s - last.t_s <= MAX_GAP_S
        if last is not None and joined and self._joins(last, attitude):
            self._waiting.append(attitude)
            if len(self._waiting) > _MOST_WAITING:
                del self._waiting[1]  # the first tells since when they join
            return
        self._waiting = [attitude]
        newest = self._attitudes.at(newest_s)
        assert newest is not None
        silent_s = attitude.t_s - newest_s
        self._jumped = silent_s < _ANYWHERE_S and not self._joins(newest, attitude)

    def _convinced(self, newest_s: float) -> bool:
        """Whether those that wait are the autopilot's: where a gyro is heard, it must go along."""
        first, last = self._waiting[0], self._waiting[-1]
        if self._unvouched(last.t_s):
            return False
        span_s, count = _SILENCE
        if self._jumped:
            newest = self._attitudes.at(newest_s)
            assert newest is not None
            tilted = _tilt_angle(newest.quat_wxyz, first.quat_wxyz) > _LEVEL_RAD
            span_s, count = _RESET if tilted else _HEADING_RESET
            if (tilted or self._imu.heard) and not self._gyro_heard(first.t_s, last.t_s):
                span_s, count = _UNTOLD_RESET
        return last.t_s - first.t_s >= span_s and len(self._waiting) >= count

    def _gyro_heard(self, from_s: float, to_s: float) -> bool:
        zero, one = self._imu.until(from_s), self._imu.until(min(to_s, self._imu.newest_s))
        return preintegrated(zero, one) is not None and self._imu.newest_s > to_s - MAX_GAP_S

    def _refuse(self, t_s: float) -> None:
        refused_s = self._attitudes.refused_s
        refused_s.add(t_s)
        if len(refused_s) > 1000:
            newest_s = max(refused_s)
            refused_s.difference_update([t for t in refused_s if t <= newest_s - 10.0])


def _unit(quat_wxyz: Array) -> Array:
    return quat_wxyz / math.sqrt(float(quat_wxyz @ quat_wxyz))


def _angle(quat0: Array, quat1: Array) -> float:
    """Between two attitudes, radians."""
    turn = quat_multiply(quat_conjugate(_unit(quat0)), _unit(quat1))
    return 2.0 * math.atan2(math.sqrt(float(turn[1:] @ turn[1:])), abs(float(turn[0])))


def _tilt_angle(quat0: Array, quat1: Array) -> float:
    """Between the verticals as two attitudes see them, both in the body, radians."""
    down0, down1 = _down(_unit(quat0)), _down(_unit(quat1))
    cos = sum(a * b for a, b in zip(down0, down1, strict=True))
    return math.acos(min(max(cos, -1.0), 1.0))


def _down(quat_wxyz: Array) -> tuple[float, float, float]:
    w, x, y, z = quat_wxyz.tolist()
    return 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)
