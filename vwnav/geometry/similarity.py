"""Robust similarities between two images of the ground: shift, rotation and one scale."""

import numpy as np
from numpy.typing import NDArray

from vwnav.geometry.homography import CONFIDENCE, RobustFit, centred
from vwnav.types import Array

_HYPOTHESES = 6000
_CHUNK = 500
_SCORED_POINTS = 400


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
    problem = centred(uv0, uv1)
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
        if best is not None and (1.0 - share**2) ** tried < 1.0 - CONFIDENCE:
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
