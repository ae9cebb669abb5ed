"""Visual odometry over the ground: how far the body under the camera went since a keyframe.

The keyframe stays until the view has changed too much, and every image is compared with it
directly: a hovering aircraft does not drift, and errors add up per keyframe, not per image.
"""

import math
from dataclasses import replace

import cv2
import numpy as np

from vwnav.geometry.camera import Camera
from vwnav.geometry.homography import continuous_homography, skew_per_s
from vwnav.geometry.rotations import (
    quat_from_rotation,
    rotation_from_euler,
)
from vwnav.types import (
    Array,
    Attitude,
    Frame,
    MatchStats,
    OdometryMotion,
    Rejected,
    RejectReason,
)
from vwnav.vision.config import OdometryConfig
from vwnav.vision.matching import Points, find_corners, normalize_contrast, track
from vwnav.vision.odometry.alone import centre_way, turned_level
from vwnav.vision.odometry.ground_motion import (
    Motion,
    MotionPrior,
    Sightings,
    TiltSeen,
    fit_motion,
    tilt_seen,
)
from vwnav.vision.odometry.views import Alike, Course, Keyframe, Overlay, ReducedView, turned

_LEAST_COS_TILT = 0.5  # of the optical axis against the vertical
_LEAST_COS_RAY = 0.35  # 70 degrees: further out a pixel is a long stretch of ground
_MOST_ZOOM = 0.5
_STEEPEST = 0.5  # slope that ground is thought to have
_WENT_BY_PX = 20.0  # the ground since the keyframe: no pixel shows what it showed
# One picture, encoded anew or shaken: corners move by less, while the camera leans by 4 times that.
_STILL_PX, _STILL_SHARE, _STILL_S, _STILL_FROM_M, _TURNED_PX, _TURNS = 1.5, 0.9, 1.0, 3.0, 1.0, 4.0
_ALIKE = 8  # such images, a second after each other
_STILL = "they stand still while the aircraft turns"
_ANY_READOUT_S, _CALIBRATED_S = (0.0, 0.015), 0.002  # not known, with one sigma; that of a known
_KNOCKS_RAD = tuple(math.radians(each) for each in (20.0, -20.0, 40.0, -40.0))


class Odometry:
    """Motion of the body between a keyframe and each image.

    What an image shows is how the camera moved; where it sits on a lever arm, a turn of the body
    swings it, and that is taken off.

    Attitudes are the autopilot's own, not corrected by an estimator that uses this odometry: the
    displacement is in NED as they have it: its covariance leaves out the tilt and heading errors
    that keyframe and image share, which turn it whole.

    Of a video `alone`, without any telemetry, the camera is taken as level, its heading is counted
    from the first image (`counted_attitude` tells it), and the displacement is that of the ground
    point in the image's centre.

    Attributes:
        readout_s: what a rolling shutter is thought to take for its rows, and one sigma: as it was
            calibrated, or nothing at first, and as images of turns and brakes have shown it since.
    """

    def __init__(self, camera: Camera, config: OdometryConfig, alone: bool = False) -> None:
        self._config = config
        self._alone = alone
        self._factor = max(1, math.ceil(camera.width_px / config.widest_px))
        self._full_wh = (camera.width_px, camera.height_px)
        w, h = (size // self._factor for size in self._full_wh)
        whole = replace(camera, width_px=w * self._factor, height_px=h * self._factor)
        self._camera = whole.scaled(w, h)
        self.readout_s = _ANY_READOUT_S if (s := camera.readout_s) is None else (s, _CALIBRATED_S)
        self._mount = camera.R_body_camera, camera.t_body_camera_m
        self._arm_camera_m = camera.R_body_camera.T @ camera.t_body_camera_m
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._keyframe: Keyframe | None = None
        self._last: ReducedView | None = None
        self._course = Course(0.0, np.zeros(3), np.eye(3), np.zeros(3))
        self._slope_ne: Array | None = None  # of the ground at the keyframe, by the images before
        self._heading_rad = 0.0
        self._read_s = self.readout_s  # and by what was followed since the keyframe
        self._overlay = Overlay(self._camera.width_px, self._camera.height_px)
        self._broke = False  # the image before could not be followed
        self._alike: list[Alike] = []  # images of the keyframe that the newest is like
        self._hangs = False  # the camera: it is always the same picture

    def mistook(self) -> None:
        """What was followed was not the ground: from the newest image on, and not as that led."""
        self._course = Course(0.0, np.zeros(3), np.eye(3), np.zeros(3))
        self._keyframe = self._slope_ne = None
        self._read_s = self.readout_s
        if self._last is not None:
            self._start(self._last)

    def counted_attitude(self, t_s: float) -> Attitude:
        """Of a video alone: level, with the heading counted up to the last image."""
        R_ned_body = rotation_from_euler(0.0, 0.0, self._heading_rad)
        return Attitude(t_s, quat_from_rotation(R_ned_body))

    def step(
        self, frame: Frame, R_ned_body: Array | None, agl_m: float
    ) -> OdometryMotion | Rejected:
        """Take the next image.

        Args:
            frame: gray, later than the one before, of the camera's size.
            R_ned_body: (3, 3) at its exposure; None when it is not known: nothing is followed
                then, unless the video is alone.
            agl_m: height above ground at its exposure, of the body; the camera's own height, to
                which the motion is proportional, is less by what the camera sits below it.

        Returns:
            The motion since the keyframe, or why there is none.
        """
        view = self._view(frame, R_ned_body, agl_m)
        if isinstance(view, Rejected):
            return view
        last, self._last = self._last, view
        if self._keyframe is None:
            return self._begin(view)
        result = self._follow(self._keyframe, view)
        if self._hangs:
            return Rejected(view.t_s, RejectReason.NO_FRAME, _STILL)
        if isinstance(result, Rejected) and last is not None and last is not self._keyframe.view:
            # The image before sees more of what this one sees than the keyframe does.
            keyframe = self._start(last)
            result = self._follow(keyframe, view) if keyframe is not None else result
        if isinstance(result, Rejected) and last is not None and not self._broke:
            result = self._follow_knocked(last, view, result)
        self._broke = isinstance(result, Rejected)
        if isinstance(result, Rejected):
            self._keyframe = self._slope_ne = None
            self._start(view)
        return result

    def _follow_knocked(
        self, last: ReducedView, view: ReducedView, lost: Rejected
    ) -> OdometryMotion | Rejected:
        """A camera that is knocked round on its mount shows the same ground, turned at once.

        Corners are found again up to some 15 degrees beside where they are looked for.
        """
        keyframe = None if self._alone else self._start(last)
        if keyframe is None:
            return lost
        for turn_rad in _KNOCKS_RAD:
            found = self._follow(turned(keyframe, turn_rad), view)
            if isinstance(found, OdometryMotion):
                return found
        return lost

    def _view(self, frame: Frame, R_ned_body: Array | None, agl_m: float) -> ReducedView | Rejected:
        if frame.image.shape[1::-1] != self._full_wh:
            sizes = f"picture of {frame.image.shape[1::-1]}, camera of {self._full_wh}"
            return Rejected(frame.t_s, RejectReason.NO_FRAME, sizes)
        if self._last is not None and frame.t_s <= self._last.t_s:
            return Rejected(frame.t_s, RejectReason.NOT_TRIED, "not later than the one before")
        if self._alone:
            R_ned_body = rotation_from_euler(0.0, 0.0, self._heading_rad)
        if R_ned_body is None:
            return Rejected(frame.t_s, RejectReason.NOT_TRIED, "attitude not known")
        R_ned_camera = R_ned_body @ self._camera.R_body_camera
        height_m = agl_m - float((R_ned_camera @ self._arm_camera_m)[2])
        if not (math.isfinite(agl_m) and height_m >= self._config.least_agl_m):
            return self._lost(frame.t_s, RejectReason.TOO_LOW, f"{height_m:.2f} m above ground")
        if not np.all(np.isfinite(R_ned_camera)) or R_ned_camera[2, 2] < _LEAST_COS_TILT:
            return self._lost(frame.t_s, RejectReason.TILTED, "the camera does not look down")
        h, w, k = self._camera.height_px, self._camera.width_px, self._factor
        cut = frame.image[: h * k, : w * k]
        gray = np.asarray(cv2.resize(cut, (w, h), interpolation=cv2.INTER_AREA), np.uint8)
        contrast = float(cv2.meanStdDev(gray)[1][0, 0])
        if contrast < self._config.least_contrast:
            return self._lost(frame.t_s, RejectReason.TOO_DARK, f"contrast {contrast:.1f}")
        flow = continuous_homography(frame, self._mount, R_ned_camera[2], height_m)
        heading_rad = math.atan2(R_ned_body[1, 0], R_ned_body[0, 0])
        images = gray, normalize_contrast(gray)
        return ReducedView(frame.t_s, *images, R_ned_camera, heading_rad, agl_m, height_m, flow)

    def _lost(self, t_s: float, reason: RejectReason, detail: str) -> Rejected:
        """An image that shows nothing: what comes after it starts anew."""
        self._keyframe = self._slope_ne = None
        return Rejected(t_s, reason, detail)

    def _begin(self, view: ReducedView) -> Rejected:
        keyframe = self._start(view)
        if keyframe is None:
            return Rejected(view.t_s, RejectReason.FEW_KEYPOINTS, "no corners on the ground")
        stats = MatchStats(keypoints=len(keyframe.uv))
        return Rejected(view.t_s, RejectReason.NOT_TRIED, "a first picture", stats=stats)

    def _start(self, view: ReducedView) -> Keyframe | None:
        """Make a view the keyframe; None, and no keyframe, when it has too few corners."""
        uv = find_corners(view.gray, self._config.cell_px)
        rays = self._camera.bearings(uv.astype(np.float64))
        skew = skew_per_s(rays, uv[:, 1], self._camera.height_px, view.flow)
        rays, skew = rays @ view.R_ned_camera.T, skew @ view.R_ned_camera.T
        down = rays[:, 2] > _LEAST_COS_RAY
        if self._alone:  # else the IMU tells that it is no ground
            down &= ~self._overlay.shows(uv)
        if np.count_nonzero(down) < self._config.least_corners:
            self._keyframe = None
            return None
        self._keyframe = Keyframe(view, uv[down], rays[down], skew[down])
        self.readout_s = self._read_s
        velocity = self._course.way_per_s
        self._course = Course(view.t_s, np.zeros(3), np.eye(3), velocity)
        return self._keyframe

    def _guess(self, keyframe: Keyframe, view: ReducedView) -> Points:
        """Where the corners (n, 2) should be now if the camera flies on as it did, or hangs."""
        if self._hangs and self._alike[-1].keyframe is keyframe:
            return np.nan_to_num(self._alike[-1].uv, nan=-1e3)
        course = self._course
        way = course.way + (view.t_s - course.t_s) * course.way_per_s
        R_camera_ned = (course.turn @ view.R_ned_camera).T
        ground = keyframe.rays / keyframe.rays[:, 2:]
        guess = np.nan_to_num(self._camera.project((ground - way) @ R_camera_ned.T), nan=-1e3)
        if keyframe.turn is not None:
            guess = cv2.transform(guess[None], keyframe.turn)[0]
        return np.asarray(guess, np.float32)

    def _follow(self, keyframe: Keyframe, view: ReducedView) -> OdometryMotion | Rejected:
        config = self._config
        images, guess = (keyframe.view.normalized, view.normalized), self._guess(keyframe, view)
        uv1, kept = track(*images, keyframe.uv, guess)
        self._hangs = self._is_still(keyframe, view, np.where(kept[:, None], uv1, np.nan))
        stats = MatchStats(keypoints=len(keyframe.uv), matches=int(np.count_nonzero(kept)))
        if stats.matches < config.least_inliers:
            return Rejected(view.t_s, RejectReason.FEW_MATCHES, "tracks lost", stats=stats)
        rays1 = self._camera.bearings(uv1[kept].astype(np.float64))
        rays1, focal_px = rays1 / rays1[:, 2:], float(self._camera.K[0, 0])
        skew1 = skew_per_s(rays1, uv1[kept, 1], self._camera.height_px, view.flow)
        rays0, skew0 = keyframe.rays[kept], keyframe.skew[kept]
        seen = Sightings(rays0, rays1, view.R_ned_camera, focal_px, skew0, skew1)
        prior = self._prior(keyframe.view, view)
        motion = fit_motion(seen, prior, config.threshold_px)
        count = 0 if motion is None else int(np.count_nonzero(motion.inliers))
        stats = replace(stats, inliers=count)
        if motion is None or count < max(
            config.least_inliers, config.least_inlier_ratio * stats.matches
        ):
            return Rejected(view.t_s, RejectReason.FEW_INLIERS, "no common motion", stats=stats)
        sigma = math.sqrt(float(np.max(np.diag(motion.covariance)[:3])))
        if not (sigma < config.most_sigma_ratio and abs(float(motion.way[2])) < _MOST_ZOOM):
            return Rejected(view.t_s, RejectReason.GEOMETRY, "points hang together", stats=stats)
        attitudes = keyframe.view.R_ned_camera, view.R_ned_camera
        tilt = TiltSeen() if self._alone else tilt_seen(motion, prior, *attitudes)
        unsure = replace(motion, covariance=motion.doubt * motion.covariance)
        slope = None if self._alone else motion.told_slope
        return self._accept(keyframe, view, unsure, count, tilt, slope)

    def _is_still(self, keyframe: Keyframe, view: ReducedView, uv: Points) -> bool:
        """Whether it is always one picture: what a camera that lives shows turns with it.

        Held against images of each of the last seconds: what it showed before it hung had moved.
        """
        before, self._alike, tells = self._alike, [], False
        for image in before if before and before[0].keyframe is keyframe else ():
            moved_px = np.sort(np.hypot(*(uv - image.uv).T))  # NaN at the end
            far_px = moved_px[int(_STILL_SHARE * np.count_nonzero(np.isfinite(moved_px)))]
            if far_px < _STILL_PX:
                most_px = max(image.most_px, float(far_px))
                self._alike.append(image._replace(most_px=most_px))
                turned = np.linalg.norm((view.R_ned_camera - image.view.R_ned_camera)[:, 2])
                lasts = view.t_s - image.view.t_s >= _STILL_S and view.height_m > _STILL_FROM_M
                least_px = max(_TURNED_PX, _TURNS * most_px)
                tells = tells or bool(lasts and self._camera.K[0, 0] * turned > least_px)
        if self._alike and (tells or self._hangs):
            return True
        if not self._alike or view.t_s - self._alike[-1].view.t_s >= _STILL_S:
            self._alike = [*self._alike[1 - _ALIKE :], Alike(keyframe, uv, view, 0.0)]
        return False

    def _prior(self, keyframe: ReducedView, view: ReducedView) -> MotionPrior:
        """The ground slopes much as it did before the keyframe; nobody knows how at first."""
        c = self._config
        tilt_rad, slope = c.tilt_increment_level_rad, c.slope_level
        if not self._alone:
            turned_rad = abs(math.remainder(keyframe.heading_rad - view.heading_rad, math.tau))
            tilt_rad, slope = math.hypot(c.tilt_increment_rad, c.tilt_rad * turned_rad), c.slope
        before = self._slope_ne
        rise = (np.zeros(2), slope) if before is None else (before, c.slope_change)
        return MotionPrior(tilt_rad, *rise, c.bend, c.sigma_px, *self.readout_s)

    def _accept(
        self,
        keyframe: Keyframe,
        view: ReducedView,
        motion: Motion,
        count: int,
        tilt: TiltSeen,
        slope: tuple[Array, Array] | None,
    ) -> OdometryMotion:
        turn = np.asarray(cv2.Rodrigues(motion.turn_rad)[0], np.float64)
        R1_ned_body = turn @ view.R_ned_camera @ self._camera.R_body_camera.T
        heading1_rad = math.atan2(R1_ned_body[1, 0], R1_ned_body[0, 0])
        increment_rad = math.remainder(heading1_rad - keyframe.view.heading_rad, math.tau)
        height_m = keyframe.view.height_m
        if self._alone:
            axes = keyframe.view.R_ned_camera[:, 2], view.R_ned_camera[:, 2]
            way, covariance = centre_way(motion, *axes)
            view, self._heading_rad = turned_level(view, heading1_rad, self._camera), heading1_rad
        else:
            way, covariance = motion.way, motion.covariance[:3, :3]
        swung_m = (view.R_ned_camera - keyframe.view.R_ned_camera) @ self._arm_camera_m
        before, self._last = self._course, view
        velocity = (motion.way - before.way) / (view.t_s - before.t_s)
        self._course = Course(view.t_s, motion.way, np.eye(3) if self._alone else turn, velocity)
        self._read_s = motion.readout_s
        if not self._hangs and (
            count < self._config.keep_ratio * len(keyframe.uv)
            or abs(increment_rad) > self._config.keep_turn_rad
            or abs(motion.way[2]) > self._config.keep_zoom
        ):
            if self._alone and self._camera.K[0, 0] * np.hypot(*motion.way[:2]) > _WENT_BY_PX:
                self._overlay.look(keyframe.view.gray, view.gray)
            self._slope_ne = np.clip(motion.slope, -_STEEPEST, _STEEPEST)
            self._start(view)
        return OdometryMotion(
            t0_s=keyframe.view.t_s,
            t1_s=view.t_s,
            displacement_ned_m=way * height_m - swung_m,
            covariance_ned_m2=covariance * height_m**2,
            yaw_increment_rad=increment_rad,
            sigma_yaw_rad=math.hypot(motion.covariance[5, 5] ** 0.5, self._config.yaw_sigma_rad),
            agl_m=keyframe.view.agl_m,
            tracks=count,
            tilt_share=tilt.share,
            tilts_along=tilt.along,
            slope_ne=None if slope is None else slope[0],
            slope_covariance=None if slope is None else slope[1],
            relief=motion.relief,
            tilts_turned=tilt.turned,
        )
