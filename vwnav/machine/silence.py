"""For how long somebody has been silent, counted by one who may sleep himself."""

import math
from dataclasses import dataclass

_LONGEST_STEP_S = 0.2  # of waking time


@dataclass
class Silence:
    """For how long nothing was heard of somebody while we listened: our own sleep is not theirs.

    Attributes:
        waking_s: that long.
    """

    waking_s: float = 0.0
    _listened_t_s: float = math.inf

    def listen(self, t_s: float) -> None:
        """Time passes; a step that is longer than it should be was our own stall."""
        self.waking_s += min(max(t_s - self._listened_t_s, 0.0), _LONGEST_STEP_S)
        self._listened_t_s = t_s

    def end(self) -> None:
        """Something was heard."""
        self.waking_s = 0.0
