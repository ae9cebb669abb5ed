"""How a camera hangs that was knocked out of its mount, or was bent with it.

Where a camera that is tilted looks, a map fix lies, and turns with the heading; as far as its
calibration is sure of the mount the filter cannot follow that. When one was knocked out of its
mount by 8 degrees in flight it was refused for some seconds, and then believed 5 m off.
"""

import math
from collections.abc import Sequence

import numpy as np

from vwnav.estimation.events import Recalibrated
from vwnav.estimation.inertial.attitudes import AttitudeHistory
from vwnav.estimation.states import FilterState, Innovation, States, Verdict
from vwnav.geometry.rotations import wrap_pi
from vwnav.types import OdometryMotion

LEAST_TURN_RAD = math.radians(6.0)  # that is worth a new camera; less is the compass' error
_SIGMA_RAD = math.radians(0.5)  # of what one image has shown by turning
_AGAIN, _WITHIN_S = 3, 1.0  # ways that agree again, and within what time
_NEWS_S = 1.0  # images before it have shown nothing
_JUMPED_RAD = math.radians(3.0)  # what a gyro does not explain
LEAST_TILT_RAD = math.radians(4.0)  # that is worth a new camera, and doubting a mount
_TILT_SIGMA_RAD, _TILT_SIGMAS = math.radians(0.8), 5.0
# Of what tilting shows. After a fix: what a compass errs by at most.
_MOST_TURN_RAD = math.radians(45.0)
_SURE, LEAST_SURE = 6.0, 2.0  # log-likelihood ratio to as told: 3.5 sigmas; once it was told, 2
OVERSTATED = 1.25  # z - w, by fits whose attitudes are that wrong: 1.1 to 1.5 times
# Of what the attitudes tell: images of another moment show less, of ground that repeats far more.
# Half a turn that nothing overstates leaves 0.6 of it.
_LEAST_SHOWN, _LEAST_MIRRORED, _MOST_SHOWN = 0.5, 0.7, 1.5
_LEAST_TILTED_S, _LEAST_LIFTING_S = 2.0, 0.5  # of images; a quarter turn costs a take-off
# Sigmas; once a turn was told: 45 degrees were a quarter turn, and none, and one, and none.
_QUARTER_RAD, _NEAR_QUARTER, _NEAR_AGAIN = 0.5 * math.pi, 2.0, 1.0
_TURN_DOUBT = 0.3  # one sigma of a turn told by tilts, as a share of it; of a quarter:
_QUARTER_DOUBT_RAD = math.radians(8.0)


class KnockCheck:
    """One that is knocked shows in one image a turn that no gyro has felt, and none after it.

    Attributes:
        knock: what an image has shown, before those after it have agreed; None while none has.
    """

    def __init__(self, attitudes: AttitudeHistory) -> None:
        """`attitudes` as they are believed, and what the gyro says: a compass may be reset."""
        self._attitudes = attitudes
        self.knock: Recalibrated | None = None
        self._after = 0

    def turned(self, motion: OdometryMotion, told: Innovation) -> Recalibrated | None:
        """The turn that an image has shown alone, once those after it agree with the gyro."""
        if told.verdict is Verdict.IMPOSSIBLE:
            self._leapt(motion)
        heading, knock = told.parts[0] if told.parts else None, self.knock
        if heading is None or heading.residual is None:
            return None
        if heading.verdict is Verdict.GATED:
            self._showed(-float(heading.residual[0]), motion)
        elif knock is not None and motion.t1_s > knock.t_s + _WITHIN_S:
            self.knock = None
        elif knock is not None and told.verdict is Verdict.FUSED and motion.t0_s >= knock.t_s:
            self._after += 1
            return knock if self._after == _AGAIN else None
        return None

    def _leapt(self, motion: OdometryMotion) -> None:
        """Take one whose way no aircraft flies: a camera that is tilted at once shows such.

        One image of another place does, too, and the next one that it was none of this.
        """
        before_rad = 0.0 if self.knock is None else self.knock.turned_rad
        yaw0_rad, yaw1_rad = (
            self._attitudes.exposure(t_s).yaw_rad for t_s in (motion.t0_s, motion.t1_s)
        )
        turned_rad = before_rad + motion.yaw_increment_rad - (yaw1_rad - yaw0_rad)
        self._showed(wrap_pi(turned_rad), motion)

    def _showed(self, turned_rad: float, motion: OdometryMotion) -> None:
        by = Recalibrated(motion.t1_s, turned_rad, _SIGMA_RAD, knocked=True)
        self.knock = by if abs(turned_rad) >= LEAST_TURN_RAD and self._joins(motion) else None
        self._after = 0

    def _joins(self, motion: OdometryMotion) -> bool:
        """Whether a gyro has felt the turns that the attitude tells: it has not jumped then."""
        jumped_rad = self._attitudes.jumped_rad(
            max(motion.t0_s, motion.t1_s - _NEWS_S), motion.t1_s
        )
        return jumped_rad is not None and jumped_rad < _JUMPED_RAD


def hangs(
    sums: Sequence[float], t_s: float, knocked: bool, had_fix: bool, again: bool, is_new: bool
) -> Recalibrated | None:
    """How a camera hangs by how its images tilt; as told, or not sure: None.

    Mirrored images show the same as those of a camera that is turned, as long as the aircraft tilts
    about one axis. A turn is told first, for an image upside down costs a take-off; mirrored images
    have to be likelier by as much as that, and a second turn likelier than they.

    Args:
        sums: over its images, of the terms of `MountCheck`: z.w and z x w, what they overstate
            taken out of z - w; S z.w and S z x w, as much smaller (S: `ground_motion.tilt_seen`);
            w.w; and of the time in seconds.
        t_s: from when on it hangs so.
        knocked: the images are those since one could not be followed.
        had_fix: a map fix has been believed.
        again: it was told before, and this is to put it right.
        is_new: it was gone just before: no camera begins to mirror its images while it shows them.
    """
    along, across, mirror_along, mirror_across, told, seen_s = sums
    shown, mirrored = math.hypot(along, across), math.hypot(mirror_along, mirror_across)
    stated = math.hypot(along - told * (1.0 - 1.0 / OVERSTATED), across)  # as S z.w is
    can_be = (knocked and is_new) or not had_fix
    if mirrored - stated >= _SURE and can_be:
        repeats = knocked and mirrored > _MOST_SHOWN * told
        if mirrored < _LEAST_MIRRORED * told or repeats or seen_s < _LEAST_LIFTING_S:
            return None
        turned_rad = math.atan2(mirror_across, mirror_along)
        turned_rad, sigma_rad = _snapped(turned_rad, _NEAR_QUARTER / math.sqrt(mirrored))
        return Recalibrated(t_s, turned_rad, sigma_rad, knocked=knocked, mirrored=True)
    turned_rad = math.atan2(across, along)
    is_quarter = abs(turned_rad) > _MOST_TURN_RAD
    least_s = _LEAST_LIFTING_S if is_quarter or knocked else _LEAST_TILTED_S
    sure = LEAST_SURE if again and not knocked else _SURE
    if shown - along < sure or shown < _LEAST_SHOWN * told:
        return None
    if seen_s < least_s or (again and can_be and stated - mirrored < sure):
        return None
    if abs(turned_rad) < LEAST_TURN_RAD or (is_quarter and had_fix and not knocked):
        return None
    sigma_rad = _TURN_DOUBT * abs(turned_rad)
    if is_quarter:
        near = _NEAR_AGAIN if again else _NEAR_QUARTER
        turned_rad, sigma_rad = _snapped(turned_rad, near / math.sqrt(shown))
    return Recalibrated(t_s, turned_rad, sigma_rad, knocked=knocked)


def _snapped(turned_rad: float, near_rad: float) -> tuple[float, float]:
    """To the quarter that it is near, for so it is put on; its sigma."""
    quarter_rad = _QUARTER_RAD * round(turned_rad / _QUARTER_RAD)
    if abs(turned_rad - quarter_rad) < near_rad:
        return wrap_pi(quarter_rad), _QUARTER_DOUBT_RAD
    return turned_rad, _TURN_DOUBT * abs(turned_rad)


def tilted(state: FilterState) -> Recalibrated | None:
    """How the camera is tilted; None while that is not sure, or not worth another camera.

    The filter follows a tilt as far as its square does not count.
    """
    tilt, variances = state.x[States.CAMERA_TILT], np.diag(state.P)[States.CAMERA_TILT]
    off_rad, sigma_rad = float(np.hypot(*tilt)), math.sqrt(float(np.max(variances)))
    if off_rad < LEAST_TILT_RAD or sigma_rad > min(_TILT_SIGMA_RAD, off_rad / _TILT_SIGMAS):
        return None
    return Recalibrated(state.t_s, forward_rad=-float(tilt[0]), right_rad=-float(tilt[1]))
