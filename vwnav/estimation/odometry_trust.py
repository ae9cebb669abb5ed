"""Whether the ways that pictures tell are those of the aircraft, as the IMU feels it fly.

A camera that is mounted upside down, or shows what is not there, tells ways that the filter refuses
one by one, and believes now and then. When most of them are refused none is believed, until they
agree for a while and a map fix does.
"""

import math
from collections import deque

_WINDOW_S = 1.2
_LEAST = 6  # ways in it
_GAP_S = 0.5  # after which it is the filter that may be wrong
_DOUBTED, _TRUSTED = 0.4, 0.9  # share that agrees: at most, and at least
_AGREE_S = 2.4  # for so long they have to agree to be believed again
_LONGER = 8.0  # times as long when they were lost again ...
_FORGIVEN_S = 60.0  # ... within this


class OdometryTrust:
    """Learns what the filter's gate said of each way.

    Attributes:
        lost: none is to be believed.
    """

    def __init__(self) -> None:
        self._seen: deque[tuple[float, bool]] = deque()
        self._begun_s = math.inf  # of what is in the window
        self._lost_s = -math.inf
        self._agree_s = _AGREE_S
        self._fixed = True
        self.lost = False

    def saw_fix(self) -> None:
        """A map fix was where the aircraft is believed: its pictures are of here, and upright."""
        self._fixed = True

    def saw(self, t_s: float, agrees: bool) -> bool:
        """Whether a way, of the picture at `t_s`, has made a change of `lost`."""
        window_s = self._agree_s if self.lost else _WINDOW_S
        if self._seen and t_s - self._seen[-1][0] > _GAP_S:
            self._begin_anew()
        self._seen.append((t_s, agrees))
        self._begun_s = min(self._begun_s, t_s)
        while self._seen[0][0] < t_s - window_s:
            self._seen.popleft()
        if len(self._seen) < _LEAST or t_s - self._begun_s < window_s:
            return False
        share = sum(agrees for _, agrees in self._seen) / len(self._seen)
        if self.lost and self._fixed and share >= _TRUSTED:
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

    def _begin_anew(self) -> None:
        self._seen.clear()
        self._begun_s = math.inf
