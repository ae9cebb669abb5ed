"""Robust homographies between two images of the ground.

`H_1_0` takes pixels of image 0 to image 1. Neither image is ever mirrored, so a fit that
mirrors, folds or flattens the points is no fit. Bad input gives None, never an exception.

While a rolling shutter reads its rows the image moves on. A point of level ground that is seen in
direction d while the middle row is exposed is seen a time t later, for small angles, at

    d - t A d,  A = [w]x + v n^T / h

in camera axes, with the camera's turn rate w, its velocity v, the vertical n, and its height h
above the ground: the continuous homography of Ma et al., An Invitation to 3-D Vision, section 5.3.
Within a read-out of 20 ms at 60 degrees a second the squares that are left out are 0.02 px.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.geometry.rotations import MOST_TURN_RAD_S
from vwnav.types import Array, Frame

BoolArray = NDArray[np.bool_]
CONFIDENCE = 0.9999
_MIN_AREA_RATIO = 1e-6
_LEAST_SQUARES = 0  # OpenCV's name for it


@dataclass(frozen=True, slots=True, eq=False)
class RobustFit:
    """A fit and the pairs it explains.

    Attributes:
        H: (3, 3), `H[2, 2] == 1`; the last row of a similarity is exactly 0 0 1.
        inliers: (n,) bool, of the pairs that were handed in.
        count: how many they are.
    """

    H: Array
    inliers: BoolArray
    count: int


def transform_points(H_1_0: Array, uv0: Array) -> Array:
    """Points (n, 2) of image 0 in image 1; not finite where they fall on the horizon."""
    points = np.asarray(uv0, dtype=np.float64).reshape(-1, 2) @ H_1_0[:, :2].T + H_1_0[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(points[:, :2] / points[:, 2:])


def jacobian_at(H_1_0: Array, uv0: Array) -> Array:
    """Derivative (2, 2) of the mapped point by the point `uv0` (2,)."""
    x, y, w = H_1_0 @ np.array([uv0[0], uv0[1], 1.0])
    mapped = np.array([[x / w], [y / w]])
    return np.asarray((H_1_0[:2, :2] - mapped @ H_1_0[2:, :2]) / w)


def estimate_homography(uv0: Array, uv1: Array, threshold_px: float, seed: int) -> RobustFit | None:
    """Homography of pixel pairs (n, 2) by MAGSAC++, refined on its inliers.

    Args:
        uv0: pixels of image 0.
        uv1: their partners in image 1, same length.
        threshold_px: largest error in image 1 of an inlier.
        seed: of the sampling; equal input and seed give equal output.
    """
    problem = centred(uv0, uv1)
    if problem is None or np.count_nonzero(problem.valid) < 4:
        return None
    H = _fitted(problem.p0[problem.valid], problem.p1[problem.valid], _magsac(threshold_px, seed))
    for _ in range(2):
        inliers = None if H is None else _inliers(H, problem.p0, problem.p1, threshold_px)
        if H is None or inliers is None or not _spread_enough(problem.p0[inliers], threshold_px):
            return None
        H = _fitted(problem.p0[inliers], problem.p1[inliers], _LEAST_SQUARES)
    return None if H is None else problem.fit(H, threshold_px, minimum=4)


def grown_homography(uv0: Array, uv1: Array, H_1_0: Array, threshold_px: float) -> RobustFit | None:
    """Homography of pixel pairs (n, 2) that grows out of a fit to some of them.

    The normalised linear fit (Hartley and Zisserman, 2nd edition, algorithm 4.2) over shrinking
    neighbourhoods. What is fitted is not far from a similarity: the weights that would make its
    algebraic errors those of the pixels are all near one.

    Args:
        uv0: finite pixels of image 0.
        uv1: their partners in image 1, same length.
        H_1_0: (3, 3) to begin with, good to some thresholds.
        threshold_px: largest error in image 1 of an inlier.
    """
    unit0, unit1 = to_unit(uv0), to_unit(uv1)
    x = np.column_stack([uv0, np.ones(len(uv0))]) @ unit0.T
    u, v = transform_points(unit1, uv1).T
    # With rows h of H, u (h3.x) = h1.x and v (h3.x) = h2.x: all that the normal equations need
    # are sums of x x^T times 1, u, v and their squares.
    products = (x[:, :, None] * x[:, None, :]).reshape(-1, 9)
    weights = np.stack([np.ones(len(u)), u, v, u**2 + v**2])
    H, normal = H_1_0, np.zeros((9, 9))
    for factor in (3.0, 1.5, 1.0):
        error2 = np.sum((transform_points(H, uv0) - uv1) ** 2, axis=1)
        sums = (weights * (error2 <= (factor * threshold_px) ** 2)) @ products
        one, of_u, of_v, squares = sums.reshape(4, 3, 3)
        normal[:3, :3] = normal[3:6, 3:6] = one
        normal[:3, 6:] = normal[6:, :3] = -of_u
        normal[3:6, 6:] = normal[6:, 3:6] = -of_v
        normal[6:, 6:] = squares
        try:
            h = np.linalg.solve(normal[:8, :8], -normal[:8, 8])
        except np.linalg.LinAlgError:
            return None
        H = np.asarray(np.linalg.solve(unit1, np.append(h, 1.0).reshape(3, 3) @ unit0))
    inliers = _inliers(H, uv0, uv1, threshold_px)
    if inliers is None:
        return None
    return RobustFit(H / H[2, 2], inliers, int(np.count_nonzero(inliers)))


def to_unit(uv: Array) -> Array:
    """Similarity (3, 3) that centres points (n, 2) and brings them to unit size: conditioning."""
    centre = uv.mean(axis=0)
    size = max(float(np.sqrt(np.mean((uv - centre) ** 2))), 1e-9)
    scale = 1.0 / size
    return np.array([[scale, 0, -scale * centre[0]], [0, scale, -scale * centre[1]], [0, 0, 1.0]])


@dataclass(frozen=True, slots=True, eq=False)
class CentredPairs:
    """The pairs about their medians: float32 inside OpenCV then loses nothing far from 0, 0."""

    p0: Array
    p1: Array
    valid: BoolArray
    centre0: Array
    centre1: Array

    def fit(self, H_centred: Array, threshold_px: float, minimum: int) -> RobustFit | None:
        """The fit in the caller's pixels, None when it has fewer inliers than `minimum`."""
        inliers = _inliers(H_centred, self.p0, self.p1, threshold_px)
        count = 0 if inliers is None else int(np.count_nonzero(inliers))
        if inliers is None or count < minimum:
            return None
        to_centre0, from_centre1 = np.eye(3), np.eye(3)
        to_centre0[:2, 2], from_centre1[:2, 2] = -self.centre0, self.centre1
        H = from_centre1 @ H_centred @ to_centre0
        if abs(H[2, 2]) < 1e-12 or not np.all(np.isfinite(H)):
            return None
        return RobustFit(H / H[2, 2], inliers, count)


def centred(uv0: Array, uv1: Array) -> CentredPairs | None:
    """Pixel pairs (n, 2) about their medians; None where no pair is finite."""
    p0 = np.array(uv0, dtype=np.float64).reshape(-1, 2)
    p1 = np.array(uv1, dtype=np.float64).reshape(-1, 2)
    if len(p0) != len(p1):
        raise ValueError(f"expected pairs of equal length, got {len(p0)} and {len(p1)}")
    valid = np.all(np.isfinite(p0) & np.isfinite(p1), axis=1)
    if not np.any(valid):
        return None
    centre0, centre1 = np.median(p0[valid], axis=0), np.median(p1[valid], axis=0)
    p0[~valid] = p1[~valid] = np.nan
    return CentredPairs(p0 - centre0, p1 - centre1, valid, centre0, centre1)


def _inliers(H: Array, p0: Array, p1: Array, threshold_px: float) -> BoolArray | None:
    """Pairs within the threshold on the right side of the horizon; None if H mirrors or folds."""
    depth = p0 @ H[2, :2] + H[2, 2]
    with np.errstate(invalid="ignore", over="ignore"):
        near = np.sum((transform_points(H, p0) - p1) ** 2, axis=1) < threshold_px**2
        # The area of the surroundings of a point grows by det(H) / depth^3.
        area = np.linalg.det(H) / depth**3
    if not np.any(near) or not np.all(np.isfinite(H)):
        return None
    inliers = near & (depth * depth[np.flatnonzero(near)[0]] > 0.0)
    return inliers if np.all(area[inliers] > _MIN_AREA_RATIO) else None


def _spread_enough(points: Array, threshold_px: float) -> bool:
    """At least four points that do not lie on one line within the threshold."""
    if len(points) < 4:
        return False
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) / np.sqrt(len(points))
    return bool(spread[1] > threshold_px)


def _magsac(threshold_px: float, seed: int) -> cv2.UsacParams:
    params = cv2.UsacParams()
    params.threshold = threshold_px
    params.confidence = CONFIDENCE
    params.maxIterations = 5000
    params.sampler = cv2.SAMPLING_UNIFORM
    params.score = cv2.SCORE_METHOD_MAGSAC
    params.loMethod = cv2.LOCAL_OPTIM_SIGMA
    params.loIterations = 10
    params.loSampleSize = 50
    params.randomGeneratorState = seed % (2**31 - 1)
    return params


def _fitted(p0: Array, p1: Array, method: cv2.UsacParams | int) -> Array | None:
    """What OpenCV makes of the pairs; None when that is nothing, or not finite."""
    try:
        H, _ = cv2.findHomography(p0.astype(np.float32), p1.astype(np.float32), method)
    except cv2.error:
        return None  # OpenCV raises on some degenerate samples, where other builds return nothing
    if H is None or H.shape != (3, 3) or not np.all(np.isfinite(H)):
        return None
    return np.asarray(H, np.float64)


def continuous_homography(
    frame: Frame, mount: tuple[Array, Array], down_camera: Array, height_m: float
) -> Array:
    """A (3, 3), per second; zero where it is not known, or none that a body has.

    Args:
        frame: with the body's motion.
        mount: R_body_camera (3, 3) and t_body_camera_m (3,).
        down_camera: (3,) the vertical n.
        height_m: of the camera above ground.
    """
    rates_rad_s, velocity_m_s = frame.rates_rad_s, frame.velocity_body_m_s
    if rates_rad_s is None or velocity_m_s is None or not height_m > 0.0:
        return np.zeros((3, 3))
    if not rates_rad_s @ rates_rad_s < MOST_TURN_RAD_S**2:
        return np.zeros((3, 3))
    R_camera_body = mount[0].T
    velocity_m_s = velocity_m_s + np.cross(rates_rad_s, mount[1])
    flow = np.outer(R_camera_body @ velocity_m_s, down_camera) / height_m
    flow += np.cross(np.eye(3), R_camera_body @ rates_rad_s)
    return np.asarray(flow)


def skew_per_s(rays: Array, v: Array | NDArray[np.float32], height_px: int, flow: Array) -> Array:
    """What a second of read-out has taken off directions (n, 3), of pixels in rows v (n,).

    With that times the read-out added they are as a global shutter would have seen them; `flow` is
    A above. The read-out counts from the middle of an image of so many rows.
    """
    since = (v + 0.5) / height_px - 0.5
    return np.asarray(since[:, None] * (rays @ flow.T))
