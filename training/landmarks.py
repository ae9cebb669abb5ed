"""SIFT landmarks that images of one ground are registered by, and the homography of two."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from training import warps
from training.photometric import to_grey
from training.warps import FloatArray, Image

OVERLAP_WIDTH_PX = 640  # neighbouring frames are registered at about this width
LANDMARKS = 2000
LEAST_OVERLAP_INLIERS = 60


@dataclass(frozen=True, slots=True, eq=False)
class Landmarks:
    """SIFT features of an image, to register it with."""

    uv: FloatArray  # (n, 2), pixels of the full image
    descriptors: NDArray[np.float32]  # (n, 128)
    shrunk: float  # of the full size, in which they were found
    size_wh: tuple[int, int]


def landmarks(image: Image) -> Landmarks:
    """Find what an image can be registered with."""
    width = image.shape[1]
    small, H_small_full = warps.shrunk(image, max(1.0, width / OVERLAP_WIDTH_PX))
    sift = cv2.SIFT.create(LANDMARKS, contrastThreshold=0.02, enable_precise_upscale=True)
    found, told = sift.detectAndCompute(to_grey(small), None)
    descriptors = np.zeros((0, sift.descriptorSize()), np.float32)
    if told is not None:
        descriptors = told.astype(np.float32, copy=False)
    points = np.array([keypoint.pt for keypoint in found], np.float64).reshape(-1, 2)
    uv = warps.warp_points(np.linalg.inv(H_small_full), points)
    return Landmarks(uv, descriptors, small.shape[1] / width, (width, image.shape[0]))


def register(a: Landmarks, b: Landmarks) -> FloatArray | None:
    """Homography b from a of two overlapping images, None where there is none to be sure of."""
    if min(len(a.uv), len(b.uv)) < LEAST_OVERLAP_INLIERS:
        return None
    similarity = a.descriptors @ b.descriptors.T  # SIFT's descriptors are all of one length
    nearest_b, nearest_a = similarity.argmax(axis=1), similarity.argmax(axis=0)
    mutual = np.flatnonzero(nearest_a[nearest_b] == np.arange(len(nearest_b)))
    if len(mutual) < LEAST_OVERLAP_INLIERS:
        return None
    points_a, points_b = a.uv[mutual], b.uv[nearest_b[mutual]]
    H_b_a, inliers = cv2.findHomography(points_a, points_b, cv2.USAC_MAGSAC, 3.0 / b.shrunk)
    if H_b_a is None or inliers.sum() < LEAST_OVERLAP_INLIERS:
        return None
    width, height = a.size_wh
    corners = np.array([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]])
    sizes = [warps.local_scale(H_b_a, corner) for corner in corners]
    return H_b_a if min(sizes) > 0.5 and max(sizes) < 2.0 else None
