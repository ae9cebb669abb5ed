"""ORB keypoints with upright binary descriptors (Rublee et al. 2011)."""

from typing import Literal

import cv2
import numpy as np

from vwnav.types import Features, Gray
from vwnav.vision.features.checks import check_gray, no_features

DESCRIPTOR_SIZE = 32
PATCH_PX = 31
MIN_SIDE_PX = 2 * PATCH_PX + 2
SCALE_FACTOR = 1.2
LEVELS = 4  # a rectified image has the map's scale to some 15 %; 1.2**3 = 1.73 is ample
FAST_THRESHOLD = 8  # grass and fields have few corners of OpenCV's 20 gray levels


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
        if min(gray.shape) < MIN_SIDE_PX or max_keypoints < 1:
            return no_features(DESCRIPTOR_SIZE, np.uint8)
        orb = cv2.ORB.create(
            nfeatures=max_keypoints,
            scaleFactor=SCALE_FACTOR,
            nlevels=LEVELS,
            patchSize=PATCH_PX,
            edgeThreshold=PATCH_PX // 2 + 1,
            fastThreshold=FAST_THRESHOLD,
        )
        keypoints = sorted(orb.detect(gray, None), key=lambda point: -point.response)
        for point in keypoints:
            point.angle = 0.0
        if not keypoints:
            return no_features(DESCRIPTOR_SIZE, np.uint8)
        described, descriptors = orb.compute(gray, keypoints[:max_keypoints])
        if not described:
            return no_features(DESCRIPTOR_SIZE, np.uint8)
        scores = np.array([point.response for point in described], np.float32)
        uv = np.array([point.pt for point in described], np.float32)
        # OpenCV multiplies by the level's scale without the half pixel of the centre convention.
        scales = SCALE_FACTOR ** np.array([point.octave for point in described], np.float32)
        uv += 0.5 * (scales[:, None] - 1.0)
        best = np.argsort(-scores, kind="stable")  # OpenCV put them in order of their level
        return Features(uv[best], np.asarray(descriptors, np.uint8)[best], scores[best])
