"""Whether the ways that pictures tell are those of the aircraft, as the IMU feels it fly.

A camera that is mounted upside down, or shows what is not there, tells ways that the filter refuses
one by one, and believes now and then. When most of them are refused none is believed, until they
agree for a while and a map fix does. That has to be while the aircraft changes its speed: ways of
pictures that are dated wrongly agree as long as it flies steadily.
"""

import bisect
import math
from collections import deque
from typing import NamedTuple

import numpy as np

from vwnav.estimation.states import FilterState, States
from vwnav.types import Array

_WINDOW_S = 1.2
_LEAST = 6  # ways in it
_GAP_S = 0.5  # after which it is the filter that may be wrong
_DOUBTED, _TRUSTED = 0.4, 0.9  # share that agrees: at most, and at least
_AGREE_S = 2.4  # for so long they have to agree to be believed again ...
_TELLING_SIGMAS = 3.0  # ... also when the velocity had changed by so much ...
_DATE_OFF_S = 0.5  # ... in the time by which pictures may be dated wrongly
_LONGER = 8.0  # times as long when they were lost again ...
_FORGIVEN_S = 60.0  # ... within this


class _Way(NamedTuple):
    t_s: float
    agrees: bool
    velocity_ne_m_s: Array
    sigma_m_s: float


def _time(way: _Way) -> float:
    return way.t_s


class OdometryTrust:
    """Learns what the filter's gate said of each way.

    Attributes:
        lost: none is to be believed.
    """

    def __init__(self) -> None:
        self._seen: deque[_Way] = deque()
        self._begun_s = math.inf  # of what is in the window
        self._lost_s = -math.inf
        self._agree_s = _AGREE_S
        self._fixed = True
        self.lost = False

    def saw_fix(self) -> None:
        """A map fix was where the aircraft is believed: its pictures are of here, and upright."""
        self._fixed = True

    def saw(self, agrees: bool, state: FilterState) -> bool:
        """Whether a way has made a change of `lost`.

        Args:
            agrees: what the filter's gate said.
            state: the filter's, at the way's end.
        """
        t_s = state.t_s
        window_s = self._agree_s if self.lost else _WINDOW_S
        if self._seen and t_s - self._seen[-1].t_s > _GAP_S:
            self._begin_anew()
        velocity_m_s, variance = state.x[States.VELOCITY], np.diag(state.P)[States.VELOCITY]
        sigma_m_s = math.sqrt(float(np.max(variance[:2])))
        self._seen.append(_Way(t_s, agrees, velocity_m_s[:2], sigma_m_s))
        self._begun_s = min(self._begun_s, t_s)
        while self._seen[0].t_s < t_s - window_s:
            self._seen.popleft()
        if len(self._seen) < _LEAST or t_s - self._begun_s < window_s:
            return False
        share = sum(way.agrees for way in self._seen) / len(self._seen)
        if self.lost and self._fixed and share >= _TRUSTED and self._proved():
            self.lost = False
        elif not self.lost and share <= _DOUBTED:
            again = t_s - self._lost_s < _FORGIVEN_S
            self._agree_s = _LONGER * self._agree_s if again else _AGREE_S
            self.lost, self._fixed = True, False
        else:
            return False
        self._lost_s = t_s
        self._begin_anew()
        return True

    def _proved(self) -> bool:
        """Whether a wrong date would have made one in the window disagree."""
        ways = list(self._seen)
        befores = (bisect.bisect_left(ways, way.t_s - _DATE_OFF_S, key=_time) for way in ways)
        changes = [
            math.dist(way.velocity_ne_m_s, ways[i].velocity_ne_m_s) / way.sigma_m_s
            for i, way in zip(befores, ways, strict=True)
        ]
        return max(changes) > _TELLING_SIGMAS

    def _begin_anew(self) -> None:
        self._seen.clear()
        self._begun_s = math.inf
