"""Robust homographies and similarities between two images of the ground.

`H_1_0` takes pixels of image 0 to image 1. Neither image is ever mirrored, so a fit that
mirrors, folds or flattens the points is no fit. Bad input gives None, never an exception.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.types import Array

BoolArray = NDArray[np.bool_]
_CONFIDENCE = 0.9999
_MIN_AREA_RATIO = 1e-6
_HYPOTHESES = 6000
_CHUNK = 500
_SCORED_POINTS = 400


@dataclass(frozen=True, slots=True, eq=False)
class RobustFit:
    """A fit and the pairs it explains.

    Attributes:
        H: (3, 3), `H[2, 2] == 1`; the last row of a similarity is exactly 0 0 1.
        inliers: (n,) bool, of the pairs that were handed in.
    """

    H: Array
    inliers: BoolArray

    @property
    def count(self) -> int:
        """How many pairs are inliers."""
        return int(np.count_nonzero(self.inliers))


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
    problem = _centred(uv0, uv1)
    if problem is None or np.count_nonzero(problem.valid) < 4:
        return None
    H = _magsac(problem.p0, problem.p1, threshold_px, seed)
    for _ in range(2):
        inliers = None if H is None else _inliers(H, problem.p0, problem.p1, threshold_px)
        if H is None or inliers is None or not _spread_enough(problem.p0[inliers], threshold_px):
            return None
        H = _least_squares_homography(problem.p0[inliers], problem.p1[inliers])
    return None if H is None else problem.fit(H, threshold_px, minimum=4)


def estimate_similarity(
    uv0: Array,
    uv1: Array,
    threshold_px: float,
    seed: int,
    scale_bounds: tuple[float, float] = (0.05, 20.0),
) -> RobustFit | None:
    """Shift, rotation and one scale of pixel pairs (n, 2), refined on the inliers.

    Two pairs make a hypothesis, so a few inliers among a hundred pairs are enough: all couples are
    tried where they are few, else a seeded draw of them. Scored as MSAC. Arguments as in
    `estimate_homography`; `scale_bounds` are the least and the greatest scale believed.
    """
    problem = _centred(uv0, uv1)
    if problem is None or np.count_nonzero(problem.valid) < 3:
        return None
    # One complex number per point: a similarity is z1 = a z0 + b.
    z0, z1 = (p[problem.valid] @ np.array([1.0, 1.0j]) for p in (problem.p0, problem.p1))
    best = _best_similarity(z0, z1, threshold_px, np.random.default_rng(seed), scale_bounds)
    for _ in range(5):
        if best is None:
            return None
        near = np.abs(best[0] * z0 + best[1] - z1) < threshold_px
        best = _least_squares_similarity(z0[near], z1[near])
    if best is None or not scale_bounds[0] <= abs(best[0]) <= scale_bounds[1]:
        return None
    a, b = best
    H = np.array([[a.real, -a.imag, b.real], [a.imag, a.real, b.imag], [0.0, 0.0, 1.0]])
    return problem.fit(H, threshold_px, minimum=3)


@dataclass(frozen=True, slots=True, eq=False)
class _Centred:
    """The pairs about their medians: float32 inside OpenCV then loses nothing far from 0, 0."""

    p0: Array
    p1: Array
    valid: BoolArray
    centre0: Array
    centre1: Array

    def fit(self, H_centred: Array, threshold_px: float, minimum: int) -> RobustFit | None:
        """The fit in the caller's pixels, None when it has fewer inliers than `minimum`."""
        inliers = _inliers(H_centred, self.p0, self.p1, threshold_px)
        if inliers is None or np.count_nonzero(inliers) < minimum:
            return None
        H = _shift(self.centre1) @ H_centred @ _shift(-self.centre0)
        if abs(H[2, 2]) < 1e-12 or not np.all(np.isfinite(H)):
            return None
        return RobustFit(H / H[2, 2], inliers)


def _centred(uv0: Array, uv1: Array) -> _Centred | None:
    p0 = np.array(uv0, dtype=np.float64).reshape(-1, 2)
    p1 = np.array(uv1, dtype=np.float64).reshape(-1, 2)
    if len(p0) != len(p1):
        raise ValueError(f"expected pairs of equal length, got {len(p0)} and {len(p1)}")
    valid = np.all(np.isfinite(p0) & np.isfinite(p1), axis=1)
    if not np.any(valid):
        return None
    centre0, centre1 = np.median(p0[valid], axis=0), np.median(p1[valid], axis=0)
    p0[~valid] = p1[~valid] = np.nan
    return _Centred(p0 - centre0, p1 - centre1, valid, centre0, centre1)


def _shift(by_uv: Array) -> Array:
    return np.array([[1.0, 0.0, by_uv[0]], [0.0, 1.0, by_uv[1]], [0.0, 0.0, 1.0]])


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


def _magsac(p0: Array, p1: Array, threshold_px: float, seed: int) -> Array | None:
    params = cv2.UsacParams()
    params.threshold = threshold_px
    params.confidence = _CONFIDENCE
    params.maxIterations = 5000
    params.sampler = cv2.SAMPLING_UNIFORM
    params.score = cv2.SCORE_METHOD_MAGSAC
    params.loMethod = cv2.LOCAL_OPTIM_SIGMA
    params.loIterations = 10
    params.loSampleSize = 50
    params.randomGeneratorState = seed % (2**31 - 1)
    valid = np.isfinite(p0[:, 0])
    try:
        H, _ = cv2.findHomography(
            p0[valid].astype(np.float32), p1[valid].astype(np.float32), params
        )
    except cv2.error:
        return None  # OpenCV raises on some degenerate samples, where other builds return nothing
    return _as_homography(H)


def _least_squares_homography(p0: Array, p1: Array) -> Array | None:
    H, _ = cv2.findHomography(p0.astype(np.float32), p1.astype(np.float32), 0)
    return _as_homography(H)


def _as_homography(H: NDArray[Any] | None) -> Array | None:
    """What OpenCV found, None when it is empty or not finite."""
    if H is None or H.shape != (3, 3) or not np.all(np.isfinite(H)):
        return None
    return H.astype(np.float64)


def _best_similarity(
    z0: NDArray[np.complex128],
    z1: NDArray[np.complex128],
    threshold_px: float,
    rng: np.random.Generator,
    scale_bounds: tuple[float, float],
) -> tuple[complex, complex] | None:
    first, second = _couples(len(z0), rng)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        a = (z1[second] - z1[first]) / (z0[second] - z0[first])
        keep = (np.abs(a) >= scale_bounds[0]) & (np.abs(a) <= scale_bounds[1])
    a, first = a[keep], first[keep]
    b = z1[first] - a * z0[first]
    scored = rng.permutation(len(z0))[:_SCORED_POINTS]
    best, best_score, tried = None, 0.0, 0
    for start in range(0, len(a), _CHUNK):
        part = slice(start, start + _CHUNK)
        error = np.abs(a[part, None] * z0[scored] + b[part, None] - z1[scored]) / threshold_px
        scores = np.sum(np.maximum(1.0 - error**2, 0.0), axis=1)
        top = int(np.argmax(scores))
        if scores[top] > best_score:
            best, best_score = (complex(a[start + top]), complex(b[start + top])), scores[top]
            share = np.count_nonzero(error[top] < 1.0) / len(scored)
        tried += len(scores)
        # Enough couples drawn that one of two inliers was among them (Fischler 1981).
        if best is not None and (1.0 - share**2) ** tried < 1.0 - _CONFIDENCE:
            break
    return best


def _couples(n: int, rng: np.random.Generator) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Indices of all couples of n points in random order, or of a draw of them."""
    if n * (n - 1) // 2 <= _HYPOTHESES:
        first, second = np.triu_indices(n, 1)
        order = rng.permutation(len(first))
        return first[order], second[order]
    first = rng.integers(0, n, _HYPOTHESES)
    second = (first + rng.integers(1, n, _HYPOTHESES)) % n
    return first, second


def _least_squares_similarity(
    z0: NDArray[np.complex128], z1: NDArray[np.complex128]
) -> tuple[complex, complex] | None:
    if len(z0) < 3:
        return None
    mean0, mean1 = z0.mean(), z1.mean()
    spread = float(np.sum(np.abs(z0 - mean0) ** 2))
    if spread < 1e-9:
        return None
    a = complex(np.sum((z1 - mean1) * np.conj(z0 - mean0)) / spread)
    return a, complex(mean1 - a * mean0)
