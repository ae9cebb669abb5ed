"""How the camera hangs, where that is not as its file says: what images tell of it.

Those of a camera that is turned on its mount tilt otherwise than the aircraft does. Taken for the
compass' error, 10 degrees made an estimate wrong by 4.7 sigmas, and 45 degrees cost the aircraft.
"""

import math

import numpy as np

from vwnav.geometry.rotations import wrap_pi
from vwnav.types import OdometryMotion

TELLS_FROM_M = 3.0  # of height; lower, blades and blur are what an image shows
APART_S = 0.5  # neighbours share their errors: so long after each other they are two witnesses
# Worth a new camera, and, after a fix, what a compass errs by at most.
_LEAST_TURN_RAD, _MOST_TURN_RAD = math.radians(6.0), math.radians(45.0)
_SURE_TURN, _SURE_AGAIN = 6.0, 2.0  # log-likelihood ratio to as told: 3.5 sigmas; then 2
_SHOWN = 0.7  # of what the attitudes tell: images of another moment show as much by chance only
_LEAST_TILTED_S, _LEAST_LIFTING_S = 2.0, 0.5  # of images; a quarter turn costs a take-off
_MOST_TOLD, _MOST_SHARE = 20.0, 0.2  # by one image: several have to agree
_OVERSTATED = 1.25  # z - w, by fits whose attitudes are that wrong: 1.1 to 1.5 times
_MOST_TURNS = 4  # in a flight; a mirrored image seems turned by this and that
_QUARTER_RAD, _NEAR_QUARTER = 0.5 * math.pi, 2.0  # sigmas


class MountCheck:
    """How the camera is turned on its mount, which images tell alone.

    Whenever the aircraft tilts they show it tilt, about an axis that is turned by as much. With w
    the turn that the attitudes tell, z what an image shows and V its variance, the likelihood of a
    camera turned by a, N(z; Rz(-a) w, V), is largest at a = atan2(S, C), C = sum z.w / V,
    S = sum z x w / V (the mean direction of von Mises' distribution).

    Attributes:
        turn_rad: clockwise as seen from above, from how the mount is told, as far as it is known.
    """

    def __init__(self) -> None:
        self.turn_rad, self._turns = 0.0, 0
        self._tilts = np.zeros(4)  # sums of z.w / V, z x w / V, w.w / V and of the time
        self._tilted_s = math.inf

    def turned_rad(self, motion: OdometryMotion, had_fix: bool) -> float:
        """By how much more, with one more image, the camera is known to be turned; 0 if by none.

        Args:
            motion: one that is believed; pictures of another moment tilt this way and that.
            had_fix: a map fix has been believed.
        """
        told = motion.tilts_turned
        if told is None or motion.agl_m < TELLS_FROM_M or self._turns == _MOST_TURNS:
            return 0.0
        quarter, half, three = told.tolist()
        tilted = -(motion.tilts_along + half)
        along = tilted + (0.5 * (motion.tilts_along - half) - tilted) / _OVERSTATED
        across = 0.5 * (quarter - three) / _OVERSTATED
        weight = min(_MOST_TOLD / max(math.hypot(along, across), 1e-9), 1.0)
        share = min(max(motion.t1_s - self._tilted_s, 0.0) / APART_S, _MOST_SHARE)
        self._tilted_s = motion.t1_s
        seen = weight * np.array([along, across, tilted])
        self._tilts += share * np.array([*seen, APART_S])
        along, across, tilted, seen_s = self._tilts.tolist()
        shown, turned_rad = math.hypot(along, across), math.atan2(across, along)
        is_quarter = abs(turned_rad) > _MOST_TURN_RAD
        sure = _SURE_AGAIN if self._turns else _SURE_TURN
        if shown - along < sure or shown < _SHOWN * tilted or (is_quarter and had_fix):
            return 0.0
        least_s = _LEAST_LIFTING_S if is_quarter else _LEAST_TILTED_S
        if seen_s < least_s or abs(turned_rad) < _LEAST_TURN_RAD:
            return 0.0
        quarter_rad = _QUARTER_RAD * round(turned_rad / _QUARTER_RAD)
        if is_quarter and abs(turned_rad - quarter_rad) < _NEAR_QUARTER / math.sqrt(shown):
            turned_rad = quarter_rad
        self._tilts[:] = 0.0
        self._turns += 1
        self.turn_rad = wrap_pi(self.turn_rad + turned_rad)
        return turned_rad
