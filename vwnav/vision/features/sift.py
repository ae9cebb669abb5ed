"""SIFT keypoints with root-SIFT descriptors (Lowe 2004; Arandjelovic and Zisserman 2012)."""

from collections.abc import Sequence
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.types import Features, Gray
from vwnav.vision.features.checks import check_gray, no_features

DESCRIPTOR_SIZE = 128
MIN_SIDE_PX = 16
CONTRAST_THRESHOLD = 0.02  # half of OpenCV's: ground seen through haze has little contrast


class SiftFeatures:
    """OpenCV's SIFT behind the `FeatureExtractor` protocol.

    Rectified images are north-up, so by default the descriptor is upright: its orientation is
    fixed instead of taken from the gradient, which makes it more distinctive. `upright=False` is
    for images whose rotation is unknown; the two kinds cannot be compared.
    """

    name: Literal["sift"] = "sift"
    # Measured: of 1000 unrelated pairs 1 and 0.1 % were below -0.7 and -1.2.
    log10_per_decade: float = 1.5

    def __init__(self, *, upright: bool = True) -> None:
        self._upright = upright
        self.feature_set_id = "sift-root-upright-1" if upright else "sift-root-1"

    def extract(self, gray: Gray, max_keypoints: int) -> Features:
        """Detect and describe.

        Args:
            gray: (h, w) uint8.
            max_keypoints: at most so many, the ones of the highest contrast.

        Returns:
            Features with uv (n, 2), pixels, centre convention, and 128 values of unit length.

        Raises:
            ValueError: not a gray image.
        """
        check_gray(gray)
        if min(gray.shape) < MIN_SIDE_PX or max_keypoints < 1:
            return no_features(DESCRIPTOR_SIZE, np.float32)
        # Precise upscaling: without it OpenCV's keypoints sit a quarter of a pixel off.
        sift = cv2.SIFT.create(contrastThreshold=CONTRAST_THRESHOLD, enable_precise_upscale=True)
        keypoints = _strongest(sift.detect(gray, None), max_keypoints, self._upright)
        if not keypoints:
            return no_features(DESCRIPTOR_SIZE, np.float32)
        described, descriptors = sift.compute(gray, keypoints)
        scores = np.array([point.response for point in described], np.float32)
        uv = np.array([point.pt for point in described], np.float32)
        return Features(uv, _root(np.asarray(descriptors, np.float32)), scores)


def _strongest(keypoints: Sequence[cv2.KeyPoint], count: int, upright: bool) -> list[cv2.KeyPoint]:
    ranked = sorted(keypoints, key=lambda point: -point.response)
    if not upright:
        return ranked[:count]
    # OpenCV repeats a keypoint for each of its orientations; upright they are the same.
    seen: set[tuple[float, ...]] = set()
    kept: list[cv2.KeyPoint] = []
    for point in ranked:
        key = (*point.pt, point.size)
        if key in seen:
            continue
        seen.add(key)
        point.angle = 0.0
        kept.append(point)
        if len(kept) == count:
            break
    return kept


def _root(descriptors: NDArray[np.float32]) -> NDArray[np.float32]:
    total = np.abs(descriptors).sum(axis=1, keepdims=True)
    root: NDArray[np.float32] = np.sqrt(descriptors / np.maximum(total, 1e-9))
    return root.astype(np.float32)
