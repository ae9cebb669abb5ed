"""The query: one image that is to be registered, its rectified views and their features."""

import copy
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.geometry.camera import Camera, Rectification, check_fits, rectification, to_gray
from vwnav.geometry.geodesy import Window, horizontal_distance_m
from vwnav.geometry.homography import continuous_homography, jacobian_at, transform_points
from vwnav.geometry.rotations import rotation_from_euler
from vwnav.maps.image import MapFeatures
from vwnav.types import (
    Array,
    FeatureExtractor,
    Features,
    Frame,
    Gray,
    MapFix,
    MatchStats,
    Prior,
    Rejected,
    RejectReason,
    WeakFix,
)
from vwnav.vision.shutter import is_visible, seen_by_rows

MAX_VIEW_PX = 1400
_KNOWN_READOUT_S = 0.003  # one sigma of a read-out by which rows are put back
MOST_VIEWS = 64  # that are kept: a search makes all headings of a height, then those of the next
EDGE_PX = 6.0  # keypoints nearer to the image's edge see what is not in the image
MIN_SHRINK = 0.6  # below this the image is halved first: a warp alone would alias
GRID_PX = 8  # of a view, within which the image bends by some hundredths of a pixel
MAX_OVERSAMPLING = 2.5
MAX_PRIOR_SIGMAS = 4.0
UNKNOWN_TILT = 0.3  # the image's centre may be so far off the nadir, in heights: 17 degrees
MAX_YAW_SIGMA_RAD = 0.5  # beyond this a view may be turned by a quarter


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """Features of a rectified image.

    Attributes:
        rectification: how the view was made.
        center_uv: (2,) view pixel of the image's centre.
        gray: (h, w) the view.
        features: those inside the image, view pixels, centre convention.
    """

    rectification: Rectification
    center_uv: Array
    gray: Gray
    features: Features


class Taken:
    """An image as it was taken, halved as often as was needed so far.

    Attributes:
        K: (3, 3) of its camera.
        size_wh: width and height of the whole image.
        contrast: standard deviation of the gray values.
    """

    def __init__(self, gray: Gray, K: Array) -> None:
        self._halved = [gray]
        self.K = K
        self.size_wh: tuple[int, int] = gray.shape[::-1]
        self.contrast = float(cv2.meanStdDev(gray)[1][0, 0])

    def at_scale(self, scale: float) -> tuple[Gray, Array]:
        """The image halved until a warp by `scale` shrinks it little more.

        Returns:
            The gray image, and H_frame_halved (3, 3) from its pixels to the whole image's.
        """
        level = 0
        while scale * 2**level < MIN_SHRINK and min(self._halved[-1].shape) >= 4:
            level += 1
            if level == len(self._halved):
                # An even size, so that a pixel is the mean of exactly four.
                h, w = self._halved[-1].shape
                even, size_wh = self._halved[-1][: h - h % 2, : w - w % 2], (w // 2, h // 2)
                half = cv2.resize(even, size_wh, interpolation=cv2.INTER_AREA)
                self._halved.append(np.asarray(half, np.uint8))
        ratio = float(2**level)
        offset = 0.5 * ratio - 0.5
        H = np.array([[ratio, 0.0, offset], [0.0, ratio, offset], [0.0, 0.0, 1.0]])
        return self._halved[level], H


class Query:
    """An image of a camera that is to be registered, and what was made of it so far.

    Attributes:
        t_s: time of exposure.
        prior: what is known.
        seed: of every random choice.
        features: name of the feature set.
        image: as it was taken; its K is that of what it is undistorted to.
        flow: A of `continuous_homography`, where rows were exposed one after the other while it
            moved visibly; else None.
        attitude_known: whether roll and pitch are.
        heading_open: whether nothing, or next to nothing, is known of it.
        views: made last, by heading, height in pixels, size and nadir: a cut one has another.
        piece: of the map that was looked at last: its level, its window and its features.
        weak: places found so far that too little speaks for.
        ms: milliseconds spent per stage, named as in `MatchStats`.
    """

    def __init__(
        self,
        camera: Camera,
        extractor: FeatureExtractor,
        frame: Frame,
        prior: Prior,
        seed: int,
        clock: Callable[[], float],
    ) -> None:
        """Take a frame, (h, w) gray or (h, w, 3) BGR; `clock` in seconds is for the times alone.

        Raises:
            CalibrationError: the calibration is for another image size.
        """
        start, image = clock(), frame.image
        check_fits(camera, image.shape[1], image.shape[0])
        if prior.readout_s[1] < _KNOWN_READOUT_S:
            camera = replace(camera, readout_s=prior.readout_s[0])
        self._camera, self._extractor, self._clock = camera, extractor, clock
        self.t_s, self.prior, self.seed, self.features = frame.t_s, prior, seed, extractor.name
        self.image = Taken(image if image.ndim == 2 else to_gray(image), camera.K)
        self.attitude_known = prior.roll_rad is not None and prior.pitch_rad is not None
        self.heading_open = prior.yaw_rad is None or not prior.sigma_yaw_rad < MAX_YAW_SIGMA_RAD
        self.flow: Array | None = None
        if camera.readout_s and self.attitude_known and prior.agl_m is not None:
            R_level_body = rotation_from_euler(prior.roll_rad or 0.0, prior.pitch_rad or 0.0, 0.0)
            down_camera = (R_level_body @ camera.R_body_camera)[2]
            mount = camera.R_body_camera, camera.t_body_camera_m
            flow = continuous_homography(frame, mount, down_camera, prior.agl_m)
            self.flow = flow if is_visible(flow, camera) else None
        self.views: dict[tuple[float, ...], View] = {}
        self.piece: tuple[int, Window, MapFeatures] | None = None
        self.weak: list[WeakFix] = []
        self.ms = {"rectify_ms": 1e3 * (clock() - start)}

    def mirrored(self) -> Self:
        """The query of the image with left and right exchanged; its times count to this one's."""
        other, (gray, _) = copy.copy(self), self.image.at_scale(1.0)
        other.image = Taken(np.ascontiguousarray(gray[:, ::-1]), self.image.K)
        other.views, other.weak = {}, []
        return other

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time of a block to a stage."""
        start = self._clock()
        try:
            yield
        finally:
            self.ms[name] = self.ms.get(name, 0.0) + 1e3 * (self._clock() - start)

    def footprint_m(self, agl_m: float) -> tuple[float, float]:
        """Width and height of the ground that a level camera sees."""
        w, h = self.image.size_wh
        return w * agl_m / self.image.K[0, 0], h * agl_m / self.image.K[1, 1]

    def rejected(
        self,
        reason: RejectReason,
        detail: str,
        *,
        keypoints: int = 0,
        matches: int = 0,
        inliers: int = 0,
    ) -> Rejected:
        """Why there is no fix; the times are filled in at the end."""
        stats = MatchStats(keypoints=keypoints, matches=matches, inliers=inliers)
        return Rejected(self.t_s, reason, detail, self.features, stats)

    def rectify(self, yaw_rad: float, agl_m: float, m_per_px: float) -> Rectification | None:
        """A view's geometry; None when the camera does not look down."""
        prior = self.prior
        R_ned_body = rotation_from_euler(prior.roll_rad or 0.0, prior.pitch_rad or 0.0, yaw_rad)
        sheared = np.eye(3)  # along down, so that the view of a slope is that of level ground
        sheared[2, :2] = prior.slope_ne
        return rectification(
            self.image.K,
            self.image.size_wh,
            sheared @ R_ned_body @ self._camera.R_body_camera,
            agl_m,
            m_per_px,
            MAX_VIEW_PX,
        )

    def view(self, yaw_rad: float, made: Rectification, max_keypoints: int) -> View:
        """The view with its features; kept, since levels of twice the size share it."""
        height_px = round(made.agl_m / made.m_per_px, 1)
        key = (round(yaw_rad, 6), height_px, *made.size_wh, *np.round(made.nadir_uv, 1).tolist())
        if key not in self.views:
            with self.stage("rectify_ms"):
                gray = self.warp(made)
            with self.stage("extract_ms"):
                self.views[key] = self._extract(made, gray, max_keypoints)
            if len(self.views) > MOST_VIEWS:
                del self.views[next(iter(self.views))]
        return replace(self.views[key], rectification=made)

    def warp(self, made: Rectification) -> Gray:
        """The gray view in one warp; what the image does not show continues its edge."""
        center = (np.array(self.image.size_wh) - 1.0) / 2.0
        scale = float(np.sqrt(abs(np.linalg.det(jacobian_at(made.H_rect_frame, center)))))
        source, H_frame_source = self.image.at_scale(scale)
        replicate = cv2.BORDER_REPLICATE
        if not self._camera.distortion and self.flow is None:
            H_view_source = made.H_rect_frame @ H_frame_source
            view = cv2.warpPerspective(
                source, H_view_source, made.size_wh, flags=cv2.INTER_LINEAR, borderMode=replicate
            )
        else:
            shrunk = np.float32(1.0 / H_frame_source[0, 0])
            places = (self.places(made, scale) + np.float32(0.5)) * shrunk - np.float32(0.5)
            u, v = cv2.split(places)
            view = cv2.remap(source, u, v, cv2.INTER_LINEAR, borderMode=replicate)
        return np.asarray(view, np.uint8)

    def places(self, made: Rectification, scale: float) -> NDArray[np.float32]:
        """Pixels (h, w, 2) of the image as it was taken that the view's pixels show.

        They bend smoothly: they are computed on a grid that reaches a cell past the view.
        """
        w, h = made.size_wh
        columns, rows = math.ceil(w / GRID_PX) + 2, math.ceil(h / GRID_PX) + 2
        uv = np.stack(np.meshgrid(np.arange(columns) - 0.5, np.arange(rows) - 0.5), axis=-1)
        H_frame_rect = np.asarray(np.linalg.inv(made.H_rect_frame), np.float64)
        straight = transform_points(H_frame_rect, GRID_PX * uv - 0.5)
        # Far outside of the image a lens model folds back.
        beyond, last = 2.0 * GRID_PX / scale, np.array(self.image.size_wh) - 1.0
        straight = np.clip(np.nan_to_num(straight), -beyond, last + beyond)
        flat = (straight - self._camera.K[:2, 2]) / np.diag(self._camera.K)[:2]
        rays, camera = np.column_stack([flat, np.ones(len(flat))]), self._camera
        flow = self.flow
        grid = camera.project(rays) if flow is None else seen_by_rows(rays, camera, flow)
        fine = cv2.resize(
            grid.reshape(rows, columns, 2).astype(np.float32),
            (GRID_PX * columns, GRID_PX * rows),
            interpolation=cv2.INTER_LINEAR,
        )
        return np.asarray(fine[GRID_PX : GRID_PX + h, GRID_PX : GRID_PX + w])

    def seen(self, made: Rectification) -> NDArray[np.bool_]:
        """Mask (h, w) of the view pixels that the image shows."""
        everywhere = np.ones(self.image.size_wh[::-1], np.uint8)
        shown = cv2.warpPerspective(
            everywhere, made.H_rect_frame, made.size_wh, flags=cv2.INTER_NEAREST
        )
        return np.asarray(shown) > 0

    def _extract(self, made: Rectification, gray: Gray, max_keypoints: int) -> View:
        """Features of a view, those that the image really shows."""
        size = np.array(self.image.size_wh, np.float64)
        corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
        shown_uv = transform_points(
            made.H_rect_frame, np.array([*corners, [0.5, 0.5]]) * (size - 1.0)
        )
        outline, center_uv = shown_uv[:4], shown_uv[4]
        h, w = gray.shape
        canvas = np.array([[0, 0], [w, 0], [w, h], [0, h]], np.float32) - np.float32(0.5)
        shown_px, _ = cv2.intersectConvexConvex(outline.astype(np.float32), canvas)
        covered = shown_px / gray.size
        oversampling = min(MAX_OVERSAMPLING, 1.0 / max(covered, 1e-3))
        found = self._extractor.extract(gray, round(max_keypoints * oversampling))
        inside = _inside(found.uv.astype(np.float64), made.H_rect_frame, size, center_uv)
        features = found.take(np.flatnonzero(inside)[:max_keypoints])
        return View(made, center_uv, gray, features)


def implausible(
    query: Query, fix: MapFix, max_sigma_m: float, sigma_tilt_rad: float
) -> Rejected | None:
    """A refusal of a fix that is too uncertain, or too far from the prior."""
    prior, sigma_m = query.prior, fix.sigma_m
    matches, inliers = fix.stats.matches, fix.stats.inliers
    # What the attitude leaves open is no fault of the matches: 2 degrees are 21 m from 600 m up.
    leant_m = sigma_tilt_rad * (fix.agl_m or 0.0) if fix.point == "nadir" else 0.0
    matched_m = math.sqrt(max(sigma_m**2 - leant_m**2, 0.0))
    if matched_m > max_sigma_m:
        detail = f"the matches fix the position to {matched_m:.0f} m only"
        return query.rejected(RejectReason.GEOMETRY, detail, matches=matches, inliers=inliers)
    if prior.lat_deg is None or prior.lon_deg is None:
        return None
    off_m = horizontal_distance_m(prior.lat_deg, prior.lon_deg, fix.lat_deg, fix.lon_deg)
    allowed_m = MAX_PRIOR_SIGMAS * math.hypot(prior.sigma_m, sigma_m)
    if fix.point == "center" and fix.agl_m is not None:
        allowed_m += UNKNOWN_TILT * fix.agl_m
    if off_m <= allowed_m:
        return None
    detail = f"{off_m:.0f} m from the prior of {prior.sigma_m:.0f} m sigma"
    return query.rejected(RejectReason.PRIOR, detail, matches=matches, inliers=inliers)


def _inside(uv: Array, H_rect_frame: Array, size_wh: Array, center_uv: Array) -> NDArray[np.bool_]:
    """Which view pixels show the image's inside, `EDGE_PX` of the view away from its edge."""
    H_frame_rect = np.asarray(np.linalg.inv(H_rect_frame), np.float64)
    depth = uv @ H_frame_rect[2, :2] + H_frame_rect[2, 2]
    at_center = center_uv @ H_frame_rect[2, :2] + H_frame_rect[2, 2]
    # The area of the surroundings of a point grows by det(H) / depth^3.
    margin = EDGE_PX * np.sqrt(abs(np.linalg.det(H_frame_rect) / at_center**3))
    frame_uv = transform_points(H_frame_rect, uv)
    low, high = margin, size_wh - 1.0 - margin
    # Behind the horizon the third coordinate changes its sign.
    ahead = depth * at_center > 0.0
    return np.asarray(ahead & np.all((frame_uv >= low) & (frame_uv <= high), axis=1))
