"""Whether the camera sees as wide, and hangs, as its calibration says.

The first fixes of a flight tell how wide.

A calibration made in another mode of the camera, or a field of view that was meant along the
diagonal, is wrong by a fifth. No fix is found then, for the map is looked at in the wrong scale,
and the ways of images contradict the IMU. So after some looks in vain heights are looked at that
the barometer cannot mean; fixes that are found there are too high, or too low, by the same share at
every height of the climb. What is wrong by as many metres at every height is the ground, or woods;
a rangefinder sees the same ground as the camera does, and rules that out.

Before that ways may have contradicted the IMU. Then the filter learns the focal length from them
(`OdometryGate.lens_doubted`), to some percent.

How it is turned on its mount images tell alone: whenever the aircraft tilts they show it tilt,
about an axis that is turned by as much. With w the turn that the attitudes tell, z what an image
shows and V its variance, the likelihood of a camera turned by a, N(z; Rz(-a) w, V), is largest at
a = atan2(S, C), C = sum z.w / V, S = sum z x w / V (the von Mises distribution's mean direction).
Taken for the compass' error, 10 degrees made an estimate wrong by 4.7 sigmas, and 45 degrees cost
the aircraft.
"""

import math
from typing import NamedTuple

import numpy as np

from vwnav.estimation.odometry_gate import TELLS_FROM_M
from vwnav.estimation.states import FilterState, States
from vwnav.geometry.rotations import wrap_pi
from vwnav.types import Array, Estimate, MapFix, OdometryMotion

_SUSPECTED_AFTER = 4  # looks in vain
_LEAST_RATIO = 0.03  # one sigma of the height that is looked for, as a share of it ...
_OPEN_RATIO = 0.17  # ... of the height that is looked for then: a third either way
_SURE_RATIO = 0.06  # of the filter's own height, or it cannot judge
_AGREES = 0.07  # so far from the filter's height, as a share of it, a fix may be ...
_AGREEING = 3  # ... and so many in a row end the question
_OFF = 0.14  # less cold air does to a barometer
_OFF_RANGED = 0.08  # where a rangefinder bears it; less the filter learns
_OFF_BY_WAYS, _SURE_BY_WAYS = 0.06, 0.05  # share, and one sigma of it, that is worth a new camera
_MOST_RATIO = 2.0  # of a focal length to that of its calibration: more is something else
_LEAST, _MOST = 4, 24  # fixes that are off
_SCATTER = 0.025  # of their heights, as a share
_LEAST_CLIMB = 1.18  # from the lowest of them to the highest, where no rangefinder bears them
_TELLS_APART = 2.0  # times as much scatter, were it the ground
_LEAST_TURN_RAD = math.radians(6.0)  # of the mount, that is worth a new camera
_SURE_TURN = 6.0  # log-likelihood ratio to a camera that hangs as told: 3.5 sigmas of the turn
_SHOWN = 2.0  # the same to images that show nothing of tilting
_MOST_TOLD = 20.0  # by one image
_OVERSTATED = 1.25  # z - w, by fits whose attitudes are that wrong: 1.1 to 1.5 times
_TILTS_APART_S = 0.5  # neighbours share their errors: so long after each other they are two
_MOST_TURNS = 4  # of the mount in a flight; a mirrored image seems turned by this and that
_QUARTER_RAD = 0.5 * math.pi
_NEAR_QUARTER = 2.0  # sigmas


class _Heights(NamedTuple):
    """Height above ground by the filter, and by a fix, as if the calibration were right.

    `ranged`: a rangefinder bears the filter's, 1.0, or 0.0.
    """

    agl_m: float
    by_map_m: float
    ranged: float


class CameraCheck:
    """The question, from the take-off on.

    Attributes:
        is_open: whether it has to be asked still.
        least_agl_ratio: one sigma of the height, as a share of it, to look with at least.
        focal_ratio: of the true focal length to the calibration's, as far as it is known.
        turn_rad: by how much the camera is turned from how its mount is told, clockwise as seen
            from above, as far as it is known.
        turned_rad: what of that was told last.
    """

    def __init__(self, is_open: bool) -> None:
        self.is_open = is_open
        self.least_agl_ratio = _LEAST_RATIO
        self.focal_ratio = 1.0
        self.turn_rad = self.turned_rad = 0.0
        self._tilts = np.zeros(3)  # sums of z.w / V, z x w / V and w.w / V
        self._tilted_s = -math.inf
        self._turns = 0
        self._by_ways = False
        self._misses = self._agreeing = 0
        self._off: list[_Heights] = []
        self._newest = _Heights(math.nan, math.nan, 0.0)

    def missed(self) -> None:
        """A look gave no fix; after some other heights are looked at."""
        self._misses += 1
        if self.is_open and self._misses >= _SUSPECTED_AFTER:
            self.least_agl_ratio = _OPEN_RATIO

    def is_off(self, fix: MapFix, then: Estimate | None, state: FilterState | None) -> bool:
        """Whether a fix has a height that may be the lens's fault: it tells the filter none then.

        Where rangefinder and barometer part it is for the filter to say which of them is right.

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
        ranged = state is not None and state.range_trust.is_borne
        self._newest = _Heights(then.agl_m, fix.agl_m, float(ranged))
        self._agreeing = self._agreeing + 1 if abs(off) < _AGREES else 0
        if self._agreeing == _AGREEING:
            self._close()
        least = _OFF_RANGED if ranged else _OFF
        return min(abs(off), abs(off_start)) >= least and off * off_start > 0.0

    def told_by_fix(self) -> bool:
        """Whether the focal length is known, with one more fix that `is_off`.

        It lies where the filter has the aircraft.
        """
        self._off.append(self._newest)
        ratio = _ratio_of(np.array(self._off))
        if ratio is not None or len(self._off) == _MOST:
            self._close()
        return ratio is not None and self._takes(ratio)

    def told_by_ways(self, motion: OdometryMotion, lost: bool, state: FilterState | None) -> bool:
        """Whether images have told, with one more, that the camera is another, or hangs otherwise.

        Of the focal length that is what the filter has learned; fixes will tell more.

        Args:
            motion: of which attitudes tell how its images were held.
            lost: ways are not believed.
            state: the filter's, now.
        """
        self.turned_rad = self._turned_rad(motion, lost)
        if self.turned_rad != 0.0:
            self.turn_rad = wrap_pi(self.turn_rad + self.turned_rad)
            if self._by_ways:  # those of another mount
                self.focal_ratio, self._by_ways, self.is_open = 1.0, False, True
            return True
        if state is None or not self.is_open:
            return False
        off, sigma = float(state.x[States.FOCAL]), math.sqrt(state.P[States.FOCAL, States.FOCAL])
        if abs(off) < _OFF_BY_WAYS or sigma > _SURE_BY_WAYS:
            return False
        taken = self._takes(1.0 - off)
        if taken:
            self._by_ways = True
            self._off.clear()  # by another camera
        return taken

    def _turned_rad(self, motion: OdometryMotion, lost: bool) -> float:
        """By how much the camera is turned; 0 as long as nothing is sure.

        A turn that ways have contradicted was none: nothing more is asked.
        """
        if motion.tilts_turned is None or motion.agl_m < TELLS_FROM_M:
            return 0.0
        if self._turns == _MOST_TURNS or (lost and self._turns > 0):
            return 0.0
        quarter, half, three = motion.tilts_turned.tolist()
        tilted = -(motion.tilts_along + half)
        along = tilted + (0.5 * (motion.tilts_along - half) - tilted) / _OVERSTATED
        told = np.array([along, 0.5 * (quarter - three) / _OVERSTATED, tilted])
        share = min((motion.t1_s - self._tilted_s) / _TILTS_APART_S, 1.0)
        self._tilted_s = motion.t1_s
        self._tilts += share * min(_MOST_TOLD / max(math.hypot(told[0], told[1]), 1e-9), 1.0) * told
        along, across, tilted = self._tilts.tolist()
        shown = math.hypot(along, across)
        turned_rad = math.atan2(across, along)
        if shown - along < _SURE_TURN or shown - 0.5 * tilted < _SHOWN:
            return 0.0
        if abs(turned_rad) < _LEAST_TURN_RAD:
            return 0.0
        quarter_rad = _QUARTER_RAD * round(turned_rad / _QUARTER_RAD)
        if quarter_rad != 0.0 and abs(turned_rad - quarter_rad) < _NEAR_QUARTER / math.sqrt(shown):
            turned_rad = quarter_rad
        self._tilts[:] = 0.0
        self._turns += 1
        return turned_rad

    def _takes(self, ratio: float) -> bool:
        """Whether a focal length that much longer than the one flown with can be."""
        if not 1.0 / _MOST_RATIO < ratio * self.focal_ratio < _MOST_RATIO:
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
    sure = len(seen) >= _LEAST and as_lens <= _SCATTER and is_no_ground
    return float(ratio) if sure else None
