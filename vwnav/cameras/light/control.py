"""How long to expose and how much to amplify: the exposure as long as may be, gain after it.

A controller of the logarithm of both together. It looks at several images before it moves, moves by
a bounded step, and then waits until the step shows: a camera whose gain does not do what its number
says is still brought to the wanted brightness, and one image that is unlike the others (a flash, a
hand before the lens) moves nothing.
"""

import math
import statistics
from dataclasses import dataclass

TARGET_LEVEL = 105.0  # mean grey level: middle of the sensor's range after its gamma
# Of what seems lacking, at first: more where that did too little (gamma), less where too much (a
# gain of its own scale).
_SHARE, _MOST_SHARE, _MORE, _LESS = 0.6, 1.5, 1.6, 0.4
_MOST_STEP = math.log(2.0)
_BEGINS, _ENDS = math.log(1.3), math.log(1.1)  # off the target, to begin moving and to end it
_LOOKS = 3
_MOST_TURNS = 4  # from too dark to too bright and back: some round exposures to octaves
_SETTLES_S = 0.4  # from a command until images show it
_CHANGES = math.log(1.15)  # of the exposure alone, for less of which nothing is commanded
_INSIDE = 0.9  # of the longest exposure that may be: the next one may be shorter
_SHORTER = 0.95  # of what was told last: what is hardly shorter is not told for its own sake


@dataclass(frozen=True, slots=True)
class Light:
    """What an image is exposed with: time, and gain as a factor."""

    exposure_s: float
    gain: float

    @property
    def total_s(self) -> float:
        """What the brightness goes by."""
        return self.exposure_s * self.gain


@dataclass(frozen=True, slots=True, kw_only=True)
class LightRange:
    """What a camera can be told; exposures come in steps of `step_s`."""

    shortest_s: float
    longest_s: float
    step_s: float
    least_gain: float
    most_gain: float


def shared_out(total_s: float, span: LightRange, most_s: float) -> Light:
    """Exposure first, up to `most_s` and no shorter than the camera can, gain for what lacks."""
    wanted_s = min(total_s / span.least_gain, span.longest_s, most_s)
    steps = math.floor((wanted_s - span.shortest_s) / span.step_s + 1e-6)
    exposure_s = span.shortest_s + max(steps, 0) * span.step_s
    return Light(exposure_s, min(max(total_s / exposure_s, span.least_gain), span.most_gain))


class LightControl:
    """Keeps one camera's images at `TARGET_LEVEL`. Feed it some ten images a second."""

    def __init__(self, span: LightRange) -> None:
        self._span = span
        self._looks: list[float] = []
        self._settled_s = -math.inf  # never commanded yet
        self._told_s, self._rounds_up = math.inf, 1.0  # exposure; what comes of it, as a factor
        self._share, self._off = _SHARE, 0.0  # what was lacking at the last step, 0 at rest
        self._turns = 0  # of steps that went too far, since the last rest

    def next(self, t_s: float, level: float, now: Light, most_s: float) -> Light | None:
        """What to tell the camera; None to leave it as it is, but at first: its own automatic ends.

        Args:
            t_s: any clock.
            level: mean grey level of an image, 0 to 255.
            now: what it was exposed with.
            most_s: longest exposure that does not blur.
        """
        if t_s >= self._settled_s:
            self._rounds_up = max(now.exposure_s / self._told_s, 1.0)
        step, is_first = self._step(t_s, level), self._settled_s == -math.inf
        total_s = now.total_s * math.exp(step or 0.0) / self._rounds_up
        then = shared_out(total_s, self._span, _INSIDE * most_s)
        must = is_first or self._must_shorten(now, then, most_s)
        if not must and (step is None or self._is_alike(now, then)):
            return None  # who may expose longer waits: brightness is never waited for in vain
        self._told_s, self._looks, self._settled_s = then.exposure_s, [], t_s + _SETTLES_S
        return then

    def _step(self, t_s: float, level: float) -> float | None:
        """Change of the logarithm of exposure times gain; None while there is more to be seen."""
        if t_s < self._settled_s:
            return None
        self._looks.append(math.log(TARGET_LEVEL / max(level, 1.0)))
        if len(self._looks) < _LOOKS:
            return None
        off, self._looks = statistics.median(self._looks), []
        self._turns += self._off * off < 0.0
        if abs(off) < self._tolerated():
            self._share, self._off = _SHARE, 0.0
            self._turns = 0 if self._turns < _MOST_TURNS else self._turns
            return 0.0
        self._turns = 0 if abs(off) > _MOST_STEP else self._turns
        if self._off:
            self._share *= _MORE if self._off * off > 0.0 else _LESS
        self._share, self._off = min(self._share, _MOST_SHARE), off
        return min(max(self._share * off, -_MOST_STEP), _MOST_STEP)

    def _tolerated(self) -> float:
        """How far off the target nothing is done: what no command mends is left as it is."""
        if self._turns >= _MOST_TURNS:
            return _MOST_STEP
        return _ENDS if self._off else _BEGINS

    def _must_shorten(self, now: Light, then: Light, most_s: float) -> bool:
        """Not again of a camera that rounds up what it was told, or does not heed it."""
        is_long = now.exposure_s > max(most_s, self._span.shortest_s + self._span.step_s)
        return is_long and then.exposure_s < _SHORTER * self._told_s

    def _is_alike(self, now: Light, then: Light) -> bool:
        """Whether a camera that is told so would change by next to nothing."""
        longer = math.log(self._rounds_up * then.exposure_s / now.exposure_s)
        moved = math.log(then.gain / now.gain) + longer
        return abs(moved) < 0.02 and abs(longer) < _CHANGES
