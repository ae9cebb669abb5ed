"""The way of a camera that nobody has placed yet: motions between keyframes, added up."""

from dataclasses import dataclass, replace

import numpy as np

from vwnav.types import Array, OdometryMotion, Rejected

_NOWHERE: Array = np.zeros(2)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class WayPose:
    """Where an exposure lies on a way, in units of the height above ground where that began.

    Attributes:
        t_s: of the exposure.
        way: number of the way; between two ways nothing is known.
        place: (2,) from its beginning, along the axes that headings are counted from.
        agl: height above ground, 1 where the way began.
        yaw_rad: heading by the attitude that odometry was handed, or by its own count.
        variance, yaw_variance: of place, per axis, and heading, since the beginning.
    """

    t_s: float
    way: int
    place: Array
    agl: float
    yaw_rad: float
    variance: float = 0.0
    yaw_variance: float = 0.0

    def moved(self, motion: OdometryMotion, yaw_rad: float) -> "WayPose":
        """The pose at the end of a motion that began here."""
        step = motion.displacement_ned_m / motion.agl_m * self.agl
        spread = np.linalg.eigvalsh(motion.covariance_ned_m2[:2, :2])[-1] / motion.agl_m**2
        return replace(
            self,
            t_s=motion.t1_s,
            place=self.place + step[:2],
            agl=self.agl - float(step[2]),
            yaw_rad=yaw_rad,
            variance=self.variance + float(spread) * self.agl**2,
            yaw_variance=self.yaw_variance + motion.sigma_yaw_rad**2,
        )


class WayCounted:
    """Adds up what odometry tells, image by image."""

    def __init__(self) -> None:
        self._keyframe: WayPose | None = None
        self._pose: WayPose | None = None

    def follow(self, motion: OdometryMotion | Rejected, yaw_rad: float) -> WayPose:
        """The pose of the next image.

        One that was not reached may be where another way begins.

        Args:
            motion: what odometry said of it.
            yaw_rad: its heading, as in `WayPose`.
        """
        self._pose = self._next(motion, yaw_rad)
        return self._pose

    def _next(self, motion: OdometryMotion | Rejected, yaw_rad: float) -> WayPose:
        if isinstance(motion, Rejected):
            return self._beginning(motion.t_s, yaw_rad)
        start = self._known(motion.t0_s)
        if start is None:
            start = self._beginning(motion.t0_s, yaw_rad - motion.yaw_increment_rad)
        self._keyframe = start
        pose = start.moved(motion, yaw_rad)
        return pose if pose.agl > 0.0 else self._beginning(motion.t1_s, yaw_rad)

    def _known(self, t_s: float) -> WayPose | None:
        """The pose of a keyframe: the one of the motion before, or that motion's image."""
        poses = (self._keyframe, self._pose)
        return next((each for each in poses if each is not None and each.t_s == t_s), None)

    def _beginning(self, t_s: float, yaw_rad: float) -> WayPose:
        number = 0 if self._pose is None else self._pose.way + 1
        return WayPose(t_s=t_s, way=number, place=_NOWHERE, agl=1.0, yaw_rad=yaw_rad)
