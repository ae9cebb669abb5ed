"""OpenCV's features: SIFT with root descriptors, ORB with upright binary ones.

Lowe 2004, Arandjelovic and Zisserman 2012; Rublee et al. 2011.
"""

from collections.abc import Sequence
from operator import attrgetter
from typing import Literal, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.types import Features, Gray

SIFT_SIZE = 128
SIFT_MIN_SIDE_PX = 16
CONTRAST_THRESHOLD = 0.02  # half of OpenCV's: ground seen through haze has little contrast
ORB_SIZE = 32
PATCH_PX = 31
ORB_MIN_SIDE_PX = 2 * PATCH_PX + 2
SCALE_FACTOR = 1.2
LEVELS = 4  # a rectified image has the map's scale to some 15 %; 1.2**3 = 1.73 is ample
FAST_THRESHOLD = 8  # grass and fields have few corners of OpenCV's 20 gray levels
_RESPONSE = attrgetter("response")


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
        if min(gray.shape) < SIFT_MIN_SIDE_PX or max_keypoints < 1:
            return no_features(SIFT_SIZE, np.float32)
        # Precise upscaling: without it OpenCV's keypoints sit a quarter of a pixel off.
        sift = cv2.SIFT.create(contrastThreshold=CONTRAST_THRESHOLD, enable_precise_upscale=True)
        keypoints = _strongest(sift.detect(gray, None), max_keypoints, self._upright)
        if not keypoints:
            return no_features(SIFT_SIZE, np.float32)
        described, descriptors = sift.compute(gray, keypoints)
        scores = np.fromiter(map(_RESPONSE, described), np.float32)
        uv = np.asarray(cv2.KeyPoint.convert(described), np.float32)
        total = np.abs(descriptors).sum(axis=1, keepdims=True)
        root = np.sqrt(descriptors / np.maximum(total, 1e-9)).astype(np.float32)
        return Features(uv, root, scores)


def _strongest(keypoints: Sequence[cv2.KeyPoint], count: int, upright: bool) -> list[cv2.KeyPoint]:
    ranked = sorted(keypoints, key=_RESPONSE, reverse=True)
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


class OrbFeatures:
    """OpenCV's ORB behind the `FeatureExtractor` protocol, without rotation (that is, BRIEF)."""

    name: Literal["orb"] = "orb"
    feature_set_id: str = "orb-upright-1"
    # Measured: of 1800 unrelated pairs 1 and 0.1 % were below -1.7 and -3.9.
    log10_per_decade: float = 2.0

    def extract(self, gray: Gray, max_keypoints: int) -> Features:
        """Detect and describe.

        Args:
            gray: (h, w) uint8.
            max_keypoints: at most so many, the ones of the highest Harris score.

        Returns:
            Features with uv (n, 2), pixels, centre convention, and 32 bytes each.

        Raises:
            ValueError: not a gray image.
        """
        check_gray(gray)
        if min(gray.shape) < ORB_MIN_SIDE_PX or max_keypoints < 1:
            return no_features(ORB_SIZE, np.uint8)
        orb = cv2.ORB.create(
            nfeatures=max_keypoints,
            scaleFactor=SCALE_FACTOR,
            nlevels=LEVELS,
            patchSize=PATCH_PX,
            edgeThreshold=PATCH_PX // 2 + 1,
            fastThreshold=FAST_THRESHOLD,
        )
        keypoints = sorted(orb.detect(gray, None), key=_RESPONSE, reverse=True)
        for point in keypoints:
            point.angle = 0.0
        if not keypoints:
            return no_features(ORB_SIZE, np.uint8)
        described, descriptors = orb.compute(gray, keypoints[:max_keypoints])
        if not described:
            return no_features(ORB_SIZE, np.uint8)
        scores = np.fromiter(map(_RESPONSE, described), np.float32)
        uv = np.asarray(cv2.KeyPoint.convert(described), np.float32)
        # OpenCV multiplies by the level's scale without the half pixel of the centre convention.
        scales = SCALE_FACTOR ** np.array([point.octave for point in described], np.float32)
        uv = uv + 0.5 * (scales[:, None] - 1.0)
        best = np.argsort(-scores, kind="stable")  # OpenCV put them in order of their level
        return Features(uv[best], np.asarray(descriptors, np.uint8)[best], scores[best])


def check_gray(gray: Gray) -> None:
    """Refuse what is not a gray image.

    Raises:
        ValueError: not (h, w) uint8, or empty.
    """
    if gray.ndim != 2 or gray.dtype != np.uint8 or gray.size == 0:
        raise ValueError(f"expected a gray picture (h, w) uint8, got {gray.shape} {gray.dtype}")


def no_features(descriptor_size: int, dtype: type[np.float32] | type[np.uint8]) -> Features:
    """Features of an image in which nothing was found."""
    descriptors = np.zeros((0, descriptor_size), dtype)
    return Features(
        np.zeros((0, 2), np.float32),
        cast("NDArray[np.float32] | NDArray[np.uint8]", descriptors),
        np.zeros(0, np.float32),
    )
