"""Whether the camera sees as wide as its calibration says: the first fixes of a flight tell.

A calibration made in another mode of the camera, or a field of view that was meant along the
diagonal, is wrong by a fifth. No fix is found then, for the map is looked at in the wrong scale,
and the ways of images contradict the IMU. So after some looks in vain heights are looked at that
the barometer cannot mean; fixes that are found there are too high, or too low, by the same share at
every height of the climb. What is wrong by as many metres at every height is the ground, or woods;
a rangefinder sees the same ground as the camera does, and rules that out.

Before that ways may have contradicted the IMU. Then the filter learns the focal length from them
(`OdometryGate.lens_doubted`), to some percent.

A camera that was gone may come back in another mode, with the same size of its images, or change it
in flight (somebody zooms): then the question is asked again.
"""

import math
from typing import NamedTuple

import numpy as np

from vwnav.estimation.states import FilterState, States
from vwnav.types import Array, Estimate, MapFix

_ASKED_S = 30.0  # for so long it is not asked again why ways contradict the IMU
_SUSPECTED_AFTER = 4  # looks in vain
_LEAST_RATIO = 0.03  # one sigma of the height that is looked for, as a share of it ...
_OPEN_RATIO = 0.17  # ... of the height that is looked for then: a third either way
_SURE_RATIO = 0.06  # of the filter's own height, or it cannot judge
_AGREES = 0.07  # so far from the filter's height, as a share of it, a fix may be ...
_AGREEING = 3  # ... and so many in a row end the question
_OFF = 0.14  # less cold air does to a barometer
_OFF_RANGED = 0.08  # where a rangefinder bears it; less the filter learns
_OFF_BY_WAYS, _SURE_BY_WAYS = 0.06, 0.05  # share, and one sigma of it, that is worth a new camera
_SIGMAS_BY_WAYS = 3.0  # and so many of them
MOST_RATIO = 2.0  # of a focal length to that of its calibration: more is something else
_IN_ROW = 5  # looks, of which each finds a fix that is off: from that one on they are believed
_LEAST, _MOST = 4, 24  # fixes that are off
# By a ratio that far, as low over woods, more of them: of 4, one climb in 1200 made a lens.
_FAR, _LEAST_FAR = 1.35, 6
_SCATTER = 0.025  # of their heights, as a share
_LEAST_CLIMB = 1.18  # from the lowest of them to the highest, where no rangefinder bears them
_TELLS_APART = 2.0  # times as much scatter, were it the ground
_UPRIGHT_ALONG = 1.0  # log-likelihood ratio: rather those of a camera that hangs as it should
_SLOW_M_S = 4.0  # as who takes off


class _Heights(NamedTuple):
    """Height above ground by the filter, and by a fix, as if the calibration were right.

    `ranged`: a rangefinder bears the filter's, 1.0, or 0.0.
    """

    agl_m: float
    by_map_m: float
    ranged: float


class LensCheck:
    """The question, from the take-off on.

    Attributes:
        is_open: whether it has to be asked still.
        least_agl_ratio: one sigma of the height, as a share of it, to look with at least.
        focal_ratio: of the true focal length to the calibration's, as far as it is known.
    """

    def __init__(self, is_open: bool) -> None:
        self.is_open = self._may_change = is_open
        self._doubted_s = -math.inf
        self.least_agl_ratio = _LEAST_RATIO
        self.focal_ratio = 1.0
        self._by_ways = False
        self._misses = self._agreeing = self._in_row = 0
        self._off: list[_Heights] = []
        self._newest = _Heights(math.nan, math.nan, 0.0)

    def ask_again(self) -> None:
        """The camera was gone: it may have come back in another mode."""
        self.is_open, self._misses, self._agreeing = True, 0, 0
        self._off.clear()

    def doubted(self, t_s: float) -> None:
        """What the camera shows contradicts the IMU: it may have changed its mode just now."""
        if self._may_change and not self.is_open and t_s > self._doubted_s + _ASKED_S:
            self._doubted_s = t_s
            self.ask_again()

    def missed(self) -> None:
        """A look gave no fix; after some other heights are looked at."""
        self._misses, self._in_row = self._misses + 1, 0
        if self.is_open and self._misses >= _SUSPECTED_AFTER:
            self.least_agl_ratio = _OPEN_RATIO

    def is_off(self, fix: MapFix, then: Estimate | None, state: FilterState | None) -> bool:
        """Whether a fix has a height that may be the lens's fault: it tells the filter none then.

        Or it is that of another moment, of a camera that froze before the aircraft came down. Where
        rangefinder and barometer part it is for the filter to say which of them is right.

        Args:
            fix: found just now.
            then: what the filter believed at its exposure, before it.
            state: the filter's, now.
        """
        self._misses = 0
        if then is None or then.sigma_agl_m > _SURE_RATIO * then.agl_m:
            return False
        if fix.agl_m is None or fix.agl_m <= 0.0:
            return False
        above_start_m = -float(then.position_ned_m[2])
        off, off_start = (
            math.log(fix.agl_m / max(height_m, 1.0)) for height_m in (then.agl_m, above_start_m)
        )
        if state is not None and state.range_trust.doubted_s is not None:
            return False
        ranged = state is not None and state.range_trust.is_borne
        if state is not None and ranged:
            barometer_m = max(then.agl_m + float(state.x[States.BARO]), 1.0)
            if abs(math.log(fix.agl_m / barometer_m)) < abs(math.log(then.agl_m / barometer_m)):
                return False  # which bears the fix: it is the rangefinder that is off
        self._newest = _Heights(then.agl_m, fix.agl_m, float(ranged))
        self._agreeing = self._agreeing + 1 if abs(off) < _AGREES else 0
        if self._agreeing == _AGREEING:
            self._close()
        least = _OFF_RANGED if ranged else _OFF
        return min(abs(off), abs(off_start)) >= least and off * off_start > 0.0

    def is_lone(self) -> bool:
        """Whether a fix that `is_off` is among the first of its row: it is not believed yet.

        Slabs of an apron look like others, a tenth smaller, and the edges contradict all but one
        look of twelve: that one was a fix 11 m beside home, 9.5 sigmas. A lens is off in each look.
        """
        self._in_row += 1
        return self._in_row < _IN_ROW

    def told_by_fix(self) -> bool:
        """Whether the focal length is known, with one more fix that `is_off`.

        It lies where the filter has the aircraft.
        """
        self._off.append(self._newest)
        ratio = _ratio_of(np.array(self._off))
        if ratio is not None or len(self._off) == _MOST:
            self._close()
        return ratio is not None and self._takes(ratio)

    def told_by_ways(self, state: FilterState) -> bool:
        """Whether the filter has learned that the focal length is another; fixes will tell more."""
        off, sigma = float(state.x[States.FOCAL]), math.sqrt(state.P[States.FOCAL, States.FOCAL])
        if abs(off) < max(_OFF_BY_WAYS, _SIGMAS_BY_WAYS * sigma) or sigma > _SURE_BY_WAYS:
            return False
        taken = self._takes(1.0 - off)
        if taken:
            self._by_ways = True
            self._off.clear()  # by another camera
        return taken

    def mount_turned(self) -> None:
        """What ways have told was told by a camera that hangs otherwise: it is asked again."""
        if self._by_ways:
            self.focal_ratio, self._by_ways, self.is_open = 1.0, False, True

    def _takes(self, ratio: float) -> bool:
        """Whether a focal length that much longer than the one flown with can be."""
        if not 1.0 / MOST_RATIO < ratio * self.focal_ratio < MOST_RATIO:
            return False
        self.focal_ratio *= ratio
        return True

    def _close(self) -> None:
        self.is_open, self.least_agl_ratio = False, _LEAST_RATIO


def _ratio_of(seen: Array) -> float | None:
    """The share by which the heights (n, 3) are off, if it is one; None while nothing is sure."""
    agl_m, by_map_m, ranged = seen.T
    ratio, ground_m = np.median(agl_m / by_map_m), np.median(agl_m - by_map_m)
    as_lens, as_ground = (
        float(np.median(np.abs(by_map_m - expected_m) / agl_m))
        for expected_m in (agl_m / ratio, agl_m - ground_m)
    )
    climbed = agl_m.max() >= _LEAST_CLIMB * agl_m.min()
    is_no_ground = np.all(ranged) or (climbed and as_ground >= _TELLS_APART * as_lens)
    least = _LEAST if 1.0 / _FAR < ratio < _FAR else _LEAST_FAR
    sure = len(seen) >= least and as_lens <= _SCATTER and is_no_ground
    return float(ratio) if sure else None


def may_be_the_lens(state: FilterState, along: float) -> bool:
    """Whether one that is not as calibrated may be why ways contradict the IMU.

    Not at speed, without a fix in scale: to tell wind, heading and lens apart is too much for ways.

    Args:
        state: the filter's.
        along: how the images tilt with the aircraft, all of them (`OdometryMotion.tilts_along`).
    """
    slow = float(np.hypot(*state.x[States.VELOCITY_NE])) < _SLOW_M_S
    return slow and along >= _UPRIGHT_ALONG
