"""What may happen to the filter, each at its own time."""

import math
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from vwnav.geometry.rotations import wrap_pi
from vwnav.types import Array, Height, OdometryMotion, Range, Stationary


class EventRank(IntEnum):
    """Order of events at the same time; clones are last, so that they copy what others left."""

    LATE_FIX = 0
    STATIONARY = 1
    HEIGHT = 2
    RANGE = 3
    FIX = 4
    ODOMETRY = 5
    DRAG = 6
    ANCHOR = 7
    EXPOSURE = 8


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NedFix:
    """A map fix in the filter's own frame.

    Attributes:
        t_s: exposure of the picture.
        position_ne_m: (2,) north and east of the camera. covariance_ne_m2: (2, 2).
        yaw_rad: true heading; None when the fix has none. agl_m: likewise.
        sigma_tilt_rad: the attitude error that `covariance_ne_m2` contains. It moves the fix by
            AGL times tilt, slowly: the filter carries it as a state, so it is taken out.
        sigma_map_m: likewise what all fixes of a place share: the map's own error.
    """

    t_s: float
    position_ne_m: Array
    covariance_ne_m2: Array
    yaw_rad: float | None = None
    sigma_yaw_rad: float | None = None
    agl_m: float | None = None
    sigma_agl_m: float | None = None
    sigma_tilt_rad: float = 0.0
    sigma_map_m: float = 0.0

    def sensible(self) -> bool:
        """Whether every number is finite and every covariance positive."""
        return (
            math.isfinite(self.t_s)
            and np.shape(self.position_ne_m) == (2,)
            and bool(np.all(np.isfinite(self.position_ne_m)))
            and is_covariance(self.covariance_ne_m2, 2)
            and _pair_sensible(self.yaw_rad, self.sigma_yaw_rad)
            and _pair_sensible(self.agl_m, self.sigma_agl_m)
            and math.isfinite(self.sigma_tilt_rad)
            and math.isfinite(self.sigma_map_m)
        )


@dataclass(frozen=True, slots=True, eq=False)
class Displacement:
    """Odometry between its keyframe and a picture."""

    motion: OdometryMotion

    @property
    def t_s(self) -> float:
        """Exposure of the later picture."""
        return self.motion.t1_s

    def sensible(self) -> bool:
        """Whether it is finite, forward in time, and its covariances are positive."""
        m = self.motion
        return (
            math.isfinite(m.t0_s)
            and math.isfinite(m.t1_s)
            and m.t1_s > m.t0_s
            and np.shape(m.displacement_ned_m) == (3,)
            and bool(np.all(np.isfinite(m.displacement_ned_m)))
            and is_covariance(m.covariance_ned_m2, 3)
            and _pair_sensible(m.yaw_increment_rad, m.sigma_yaw_rad)
            and math.isfinite(m.agl_m)
            and m.agl_m > 0.0
            and 0.0 <= m.tilt_share <= 1.0
        )


def between(before: OdometryMotion, after: OdometryMotion) -> OdometryMotion:
    """The way from one picture to a later one that were both compared with the same keyframe.

    For a keyframe that the filter has forgotten: over a spot where nothing changes odometry keeps
    it for minutes, and a filter that begins anew meanwhile would have no ways at all.
    """
    return replace(
        after,
        t0_s=before.t1_s,
        displacement_ned_m=after.displacement_ned_m - before.displacement_ned_m,
        covariance_ned_m2=after.covariance_ned_m2 + before.covariance_ned_m2,
        yaw_increment_rad=wrap_pi(after.yaw_increment_rad - before.yaw_increment_rad),
        sigma_yaw_rad=math.hypot(after.sigma_yaw_rad, before.sigma_yaw_rad),
    )


@dataclass(frozen=True, slots=True, eq=False)
class NewKeyframe:
    """Odometry starts a keyframe: the position is cloned.

    The clone is where the keyframe *seems* to have been taken: `covariance_ned_m2` and
    `sigma_yaw_rad` are what the keyframe itself adds to every displacement measured from it.
    """

    t_s: float
    covariance_ned_m2: Array
    sigma_yaw_rad: float

    def sensible(self) -> bool:
        """Always: it is made of a sensible displacement."""
        return True


@dataclass(frozen=True, slots=True)
class Exposed:
    """A picture was taken that is now being matched to the map: its pose is cloned.

    However long the search takes, its fix meets the clone.
    """

    t_s: float

    def sensible(self) -> bool:
        """Whether the time is finite."""
        return math.isfinite(self.t_s)


@dataclass(frozen=True, slots=True, eq=False)
class LateFix:
    """The fix of the picture whose pose is cloned, older than the history that begins at `t_s`."""

    t_s: float
    fix: NedFix

    def sensible(self) -> bool:
        """Whether its fix is."""
        return self.fix.sensible()


@dataclass(frozen=True, slots=True)
class Drag:
    """The IMU has felt for a while what the air does to the aircraft."""

    t_s: float

    def sensible(self) -> bool:
        """Always: it is made of samples that were believed."""
        return True


Event = NedFix | Height | Range | Stationary | Displacement | NewKeyframe | Exposed | LateFix | Drag

_RANKS = {
    Stationary: EventRank.STATIONARY, Height: EventRank.HEIGHT, Range: EventRank.RANGE,
    NedFix: EventRank.FIX, Displacement: EventRank.ODOMETRY, NewKeyframe: EventRank.ANCHOR,
    Exposed: EventRank.EXPOSURE, LateFix: EventRank.LATE_FIX, Drag: EventRank.DRAG,
}  # fmt: skip


def rank_of(event: Event) -> EventRank:
    """Its place among events of the same time."""
    return _RANKS[type(event)]


def is_covariance(matrix: Array, n: int) -> bool:
    """Whether it is a finite, symmetric, positive definite matrix (n, n)."""
    if np.shape(matrix) != (n, n) or not np.all(np.isfinite(matrix)):
        return False
    scale = float(np.max(np.abs(matrix)))
    if scale > 1e12 or np.max(np.abs(matrix - matrix.T)) > 1e-6 * scale:
        return False
    return bool(np.linalg.eigvalsh(matrix)[0] > 1e-12 * max(scale, 1e-6))


def _pair_sensible(value: float | None, sigma: float | None) -> bool:
    if value is None:
        return True
    return math.isfinite(value) and sigma is not None and 1e-9 < sigma < 1e6
