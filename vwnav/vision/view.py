"""From a picture to features of its north-up nadir view at the resolution of a map level."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.geometry.calibration import check_fits
from vwnav.geometry.camera import Camera
from vwnav.geometry.homography import jacobian_at, transform_points
from vwnav.geometry.rectify import Rectification, rectification
from vwnav.types import Array, FeatureExtractor, Features, Gray
from vwnav.vision.features.checks import take

MAX_VIEW_PX = 1400
EDGE_PX = 6.0  # keypoints nearer to the picture's edge see what is not in the picture
MIN_SHRINK = 0.6  # below this the picture is halved first: a warp alone would alias
MAX_OVERSAMPLING = 2.5


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """Features of a rectified picture.

    Attributes:
        rectification: how the view was made.
        center_uv: (2,) view pixel of the picture's centre.
        gray: (h, w) the view.
        features: those inside the picture, view pixels, centre convention.
    """

    rectification: Rectification
    center_uv: Array
    gray: Gray
    features: Features


class Undistorted:
    """An undistorted picture, halved as often as was needed so far."""

    def __init__(self, gray: Gray, K: Array) -> None:
        self._halved = [gray]
        self.K = K

    @property
    def size_wh(self) -> tuple[int, int]:
        """Width and height of the whole picture."""
        h, w = self._halved[0].shape
        return w, h

    @property
    def contrast(self) -> float:
        """Standard deviation of the gray values."""
        return float(self._halved[0].std())

    def at_scale(self, scale: float) -> tuple[Gray, Array]:
        """The picture halved until a warp by `scale` shrinks it little more.

        Returns:
            The gray picture, and H_frame_halved (3, 3) from its pixels to the whole picture's.
        """
        level = 0
        while scale * 2**level < MIN_SHRINK and min(self._halved[-1].shape) >= 4:
            level += 1
            if level == len(self._halved):
                # An even size, so that a pixel is the mean of exactly four.
                h, w = (side - side % 2 for side in self._halved[-1].shape)
                even = self._halved[-1][:h, :w]
                size = (w // 2, h // 2)
                half = cv2.resize(even, size, interpolation=cv2.INTER_AREA)
                self._halved.append(np.asarray(half, np.uint8))
        ratio = float(2**level)
        offset = 0.5 * ratio - 0.5
        H = np.array([[ratio, 0.0, offset], [0.0, ratio, offset], [0.0, 0.0, 1.0]])
        return self._halved[level], H


class ViewMaker:
    """Undistorts and rectifies the pictures of one camera and extracts their features."""

    def __init__(self, camera: Camera, extractor: FeatureExtractor) -> None:
        self._camera = camera
        self._undistorted = camera.undistorted()
        self._maps = camera.undistort_maps() if camera.distortion else None
        self._extractor = extractor

    def picture(self, image: NDArray[np.uint8]) -> Undistorted:
        """Undistort a picture, (h, w) gray or (h, w, 3) BGR.

        Raises:
            CalibrationError: the calibration is for another picture size.
        """
        check_fits(self._camera, image.shape[1], image.shape[0])
        gray = np.asarray(
            image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8
        )
        if self._maps is not None:
            map1, map2 = self._maps
            straight = cv2.remap(
                gray, map1, map2, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
            )
            gray = np.asarray(straight, np.uint8)
        return Undistorted(gray, self._undistorted.K)

    def rectify(
        self, picture: Undistorted, R_ned_body: Array, agl_m: float, m_per_px: float
    ) -> Rectification | None:
        """The view that a picture would make; None when the camera does not look down."""
        R_ned_camera = R_ned_body @ self._camera.R_body_camera
        return rectification(picture.K, picture.size_wh, R_ned_camera, agl_m, m_per_px, MAX_VIEW_PX)

    def warp(self, picture: Undistorted, rectification: Rectification) -> Gray:
        """The gray view; what the picture does not show continues its edge."""
        center = (np.array(picture.size_wh) - 1.0) / 2.0
        scale = np.sqrt(abs(np.linalg.det(jacobian_at(rectification.H_rect_frame, center))))
        source, H_frame_source = picture.at_scale(float(scale))
        view = cv2.warpPerspective(
            source,
            rectification.H_rect_frame @ H_frame_source,
            rectification.size_wh,
            flags=cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        return np.asarray(view, np.uint8)

    def seen(self, picture: Undistorted, rectification: Rectification) -> NDArray[np.bool_]:
        """Mask (h, w) of the view pixels that the picture shows."""
        w, h = rectification.size_wh
        everywhere = np.ones(picture.size_wh[::-1], np.uint8)
        H = rectification.H_rect_frame
        return np.asarray(cv2.warpPerspective(everywhere, H, (w, h), flags=cv2.INTER_NEAREST) > 0)

    def extract(
        self, picture: Undistorted, rectification: Rectification, gray: Gray, max_keypoints: int
    ) -> View:
        """Features of a view, those that the picture really shows."""
        size = np.array(picture.size_wh, np.float64)
        corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]) * (size - 1.0)
        outline = transform_points(rectification.H_rect_frame, corners)
        covered = cv2.contourArea(outline.astype(np.float32)) / gray.size
        oversampling = min(MAX_OVERSAMPLING, 1.0 / max(covered, 1e-3))
        found = self._extractor.extract(gray, round(max_keypoints * oversampling))
        inside = _inside(found.uv.astype(np.float64), rectification.H_rect_frame, size)
        features = take(found, np.flatnonzero(inside)[:max_keypoints])
        center_uv = transform_points(rectification.H_rect_frame, (size - 1.0) / 2.0)[0]
        return View(rectification, center_uv, gray, features)


def _inside(uv: Array, H_rect_frame: Array, size_wh: Array) -> NDArray[np.bool_]:
    """Which view pixels show the picture's inside, `EDGE_PX` of the view away from its edge."""
    H_frame_rect = np.asarray(np.linalg.inv(H_rect_frame), np.float64)
    center = transform_points(H_rect_frame, (size_wh - 1.0) / 2.0)[0]
    frame_px_per_px = np.sqrt(abs(np.linalg.det(jacobian_at(H_frame_rect, center))))
    frame_uv = transform_points(H_frame_rect, uv)
    margin = EDGE_PX * frame_px_per_px
    low, high = margin, size_wh - 1.0 - margin
    # Behind the horizon the third coordinate changes its sign.
    depth = uv @ H_frame_rect[2, :2] + H_frame_rect[2, 2]
    ahead = depth * (center @ H_frame_rect[2, :2] + H_frame_rect[2, 2]) > 0.0
    return np.asarray(ahead & np.all((frame_uv >= low) & (frame_uv <= high), axis=1))
