"""Images that may be of another moment than they say: what they tell then, and what shows it.

In a steady flight nothing does: their ways agree with the IMU, and their fixes lie behind by what
is flown meanwhile. It shows when the aircraft changes its acceleration.
"""

import bisect
import math
from collections import deque
from dataclasses import replace
from itertools import pairwise
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from vwnav.estimation.events import NedFix, Recalibrated
from vwnav.estimation.inertial.attitudes import AttitudeHistory
from vwnav.estimation.inertial.integrals import ImuIntegrals
from vwnav.estimation.inertial.preintegration import preintegrated
from vwnav.estimation.states import FilterState, States
from vwnav.types import Array, OdometryMotion

DATE_OFF_S = 0.5  # by which images may be dated wrongly
_LEANS_AT_S = np.linspace(-2.0 * DATE_OFF_S, 0.0, 11)  # from a fix; attitudes may be late, too
_LEAN_DOUBT_RAD = 0.02  # besides
_ALIKE_S = 1.0  # for so long neighbours are off alike
_SHORTEST_S = 0.1  # from fix to fix
_TELLING_SIGMAS = 3.0  # by which a velocity changes
_SPAN_S = 0.6  # over which a velocity is seen; some half of it before are images that are wrong
_JITTER_S = 0.05  # of the moments of images
_LEAST_APART_S, _EVEN = 0.1, 1.5  # of five in that second
_LEAST_SIGMA_M_S = 0.2  # of a change of velocity
_MOST_SAID, _SURE = 3.0, 7.0  # log-likelihood ratio: by one change; of them all, once in a thousand
_REFUSED = 5.7  # ln(0.3 / 0.001), the shares of wrong ways and of right ones that are
LEAST_OFFSET_S, _LEAST_UNBORNE_S = 0.04, 0.06  # worth new dates; before a fix was found
_OFFSET_SIGMA_S, _OFFSET_SIGMAS = 0.015, 3.0  # and as sure
_TIME = attrgetter("t_s")


def of_doubtful_date(fix: NedFix, state: FilterState, attitudes: AttitudeHistory) -> NedFix:
    """Of an image whose ways contradict the IMU: it may be from another moment than it says.

    The aircraft was elsewhere then, and leaned otherwise, as it did in the second before: as it
    does for a second or so, so that neighbours are off alike. Of samples of a first-order
    Gauss-Markov error, whose correlation from one to the next is r, each after the first adds
    (1 - r) / (1 + r) of what that one told (the least-squares mean of an autoregression).
    """
    flown_m = DATE_OFF_S * state.x[States.VELOCITY_NE]
    leans = np.array([attitudes.exposure(fix.t_s + each_s).lean for each_s in _LEANS_AT_S])
    leant_rad = _LEAN_DOUBT_RAD + float(np.max(np.hypot(*(leans - leans[-1]).T)))
    leant_m = leant_rad * max(state.agl_m, 0.0)
    doubt_m2 = np.outer(flown_m, flown_m) + leant_m**2 * np.eye(2)
    since_s = math.inf if state.t_last_fix_s is None else abs(fix.t_s - state.t_last_fix_s)
    r = math.exp(-max(since_s, _SHORTEST_S) / _ALIKE_S)
    doubt_m2 *= (1.0 + r) / (1.0 - r)
    return replace(fix, covariance_ne_m2=fix.covariance_ne_m2 + doubt_m2)


def misdated(state: FilterState, t_s: float) -> Recalibrated | None:
    """By how much images from `t_s` on are to be dated anew; None: not sure, or not worth it.

    The filter follows an error as far as nobody turns otherwise within it. Of a camera that hangs
    turned by 10 degrees ways show 26 ms until that is known, and of a mirrored one 48, before any
    fix. But images that are 150 ms late look turned, to who waits for one.
    """
    off_s = float(state.x[States.TIME_OFFSET])
    sigma_s = math.sqrt(float(state.P[States.TIME_OFFSET, States.TIME_OFFSET]))
    least_s = _LEAST_UNBORNE_S if state.t_last_fix_s is None else LEAST_OFFSET_S
    if abs(off_s) < least_s or sigma_s > min(_OFFSET_SIGMA_S, abs(off_s) / _OFFSET_SIGMAS):
        return None
    return Recalibrated(t_s + min(off_s, 0.0), redated_s=off_s)


class _Dated(NamedTuple):
    t_s: float
    place_ne_m: Array  # by the ways alone
    felt: ImuIntegrals | None
    velocity_ne_m_s: Array


class DateCheck:
    """Whether images are of the moments that they say, of ways that agree with the IMU.

    Ways of another moment would not have, when the velocity had changed by more than its sigmas
    meanwhile. And where it is not known so well, changes of it tell. With u the change from one
    0.6 s to the next that images show, S its covariance, and v(t) the one that the IMU felt
    then: the log-likelihood ratios of N(u; v(t), S) to N(u; v(t - 0.3 s), S), images of another
    moment, and to N(u; 0, S), images of no ground. Summed from where they were least (Page's test,
    1954): they may be right only since then.
    """

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Nothing is known of them."""
        self._ways: deque[_Dated] = deque()
        self._keyframe_s, self._keyframe_ne_m = -math.inf, np.zeros(2)
        self._changed_s = self._said_s = -math.inf
        self._sums = np.zeros(2)

    def are_right(self, since_s: float) -> bool:
        """Whether they surely are, when all ways since then have agreed."""
        return self._changed_s >= since_s or bool(np.min(self._sums) >= _SURE)

    def refused(self) -> None:
        """The filter's gate has refused a way: of right ones it does so with one in a thousand."""
        self._sums = np.maximum(self._sums - _REFUSED, 0.0)

    def see(self, motion: OdometryMotion, felt: ImuIntegrals | None, state: FilterState) -> None:
        """Take a way, all that the IMU had felt at its end, and the filter's state then."""
        if motion.t0_s != self._keyframe_s:
            begun = [each.place_ne_m for each in self._ways if each.t_s == motion.t0_s]
            if not begun:
                self._ways.clear()
            self._keyframe_s, self._keyframe_ne_m = motion.t0_s, begun[0] if begun else np.zeros(2)
        place_ne_m = self._keyframe_ne_m + motion.displacement_ned_m[:2]
        way = _Dated(motion.t1_s, place_ne_m, felt, state.x[States.VELOCITY_NE])
        self._ways.append(way)
        while self._ways[0].t_s < way.t_s - 3.0 * _SPAN_S:
            self._ways.popleft()
        sigma_m_s = math.sqrt(float(np.max(np.diag(state.P)[States.VELOCITY_NE])))
        before = self._ways[bisect.bisect_left(self._ways, way.t_s - DATE_OFF_S, key=_TIME)]
        if math.dist(way.velocity_ne_m_s, before.velocity_ne_m_s) > _TELLING_SIGMAS * sigma_m_s:
            self._changed_s = way.t_s
        # Neighbours share their errors.
        if way.t_s >= self._said_s + _SPAN_S and (change := self._change_m_s()) is not None:
            self._said_s = way.t_s
            self._sums = np.clip(self._sums + _says(motion, *change), 0.0, 2.0 * _SURE)

    def _change_m_s(self) -> tuple[Array, Array, Array] | None:
        """(2,) NE as images show it over the last second; as it was felt then, and before."""
        times_s = [each.t_s for each in self._ways]
        count = len(times_s) - bisect.bisect_left(times_s, times_s[-1] - 2.0 * _SPAN_S - _JITTER_S)
        every = (count - 1) // 4
        if every < 1:
            return None
        ways = [self._ways[-1 - n * every] for n in range(5)]
        apart_s = [later.t_s - before.t_s for later, before in pairwise(ways)]
        if not _LEAST_APART_S < min(apart_s) <= max(apart_s) < _EVEN * min(apart_s):
            return None
        now, before = (preintegrated(ways[i + 2].felt, ways[i].felt) for i in (1, 2))
        late, early = (_velocity_m_s(ways[i + 2], ways[i]) for i in (0, 2))
        if now is None or before is None:
            return None
        return late - early, now.velocity_m_s[:2], before.velocity_m_s[:2]


def _says(motion: OdometryMotion, shown: Array, now: Array, before: Array) -> Array:
    """(2,) log-likelihood ratios."""
    sigma_m = math.sqrt(float(np.max(np.diag(motion.covariance_ned_m2)[:2])))
    sigma_m_s = max(sigma_m / _SPAN_S, _LEAST_SIGMA_M_S)
    off, *others = (math.dist(shown, each) / sigma_m_s for each in (now, before, np.zeros(2)))
    return np.clip(0.5 * (np.square(others) - off**2), -_MOST_SAID, _MOST_SAID)


def _velocity_m_s(zero: _Dated, one: _Dated) -> Array:
    """(2,) north and east, between two images."""
    return np.asarray((one.place_ne_m - zero.place_ne_m) / (one.t_s - zero.t_s))
