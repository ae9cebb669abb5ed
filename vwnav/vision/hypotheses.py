"""Where on the map might the view be? Pairs of matches vote, so a tenth of right matches is enough.

Points are complex numbers here, z = u + i v: a similarity is then `z_map = a z_view + b`, with the
scale |a| and the clockwise rotation arg(a).
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.types import Array

Complex = NDArray[np.complex128]
MAX_PAIRS = 40_000
CELL_PX = 12.0
CANDIDATES = 6
MIN_AGREEING = 3
MIN_BASELINE_RATIO = 0.08  # of the view's diagonal: shorter pairs tell no rotation


@dataclass(frozen=True, slots=True)
class SimilarityBounds:
    """What the prior allows of the similarity from view to map.

    Attributes:
        max_scale: the scale is between 1 / max_scale and max_scale.
        max_rotation_rad: largest rotation, either way.
    """

    max_scale: float
    max_rotation_rad: float

    def allows(self, a: Complex) -> NDArray[np.bool_]:
        """Which of the complex factors are within the bounds."""
        scale = np.abs(a)
        rotation_ok = np.abs(np.angle(a)) <= self.max_rotation_rad
        return rotation_ok & (scale <= self.max_scale) & (scale * self.max_scale >= 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A similarity that several matches agree on.

    Attributes:
        H_map_view: (3, 3).
        near: (m,) bool, matches within the threshold of it.
        center_uv: (2,) where it puts the reference point.
    """

    H_map_view: Array
    near: NDArray[np.bool_]
    center_uv: Array

    @property
    def count(self) -> int:
        """How many matches agree."""
        return int(np.count_nonzero(self.near))


def propose(
    uv_view: Array,
    uv_map: Array,
    reference_uv: Array,
    bounds: SimilarityBounds,
    threshold_px: float,
    seed: int,
) -> list[Candidate]:
    """Similarities that the matches support, best first.

    Each pair of matches makes a similarity; those within the bounds vote for where it puts the
    reference point. Wrong pairs scatter over the map, right ones fall together.

    Args:
        uv_view: (m, 2) matched points of the view, pixels.
        uv_map: (m, 2) their partners on the map.
        reference_uv: (2,) point of the view, best its centre.
        bounds: scale and rotation that the prior allows.
        threshold_px: largest error of a match that agrees.
        seed: of the choice of pairs where there are too many.

    Returns:
        At most `CANDIDATES`, which put the reference point on different places.
    """
    if len(uv_view) < MIN_AGREEING:
        return []
    z0 = _complex(uv_view - reference_uv)
    z1 = _complex(uv_map)
    a, centers = _votes(z0, z1, bounds, seed)
    found: list[Candidate] = []
    for center in _peaks(centers):
        # As wide as the corners of the 3 x 3 cells, so that no peak is without votes.
        close = np.abs(centers - center) <= 2.2 * CELL_PX
        start = (_median(a[close]), _median(centers[close]))
        fit = _refine(z0, z1, *start, threshold_px)
        if fit is not None and bounds.allows(np.array([fit[0]]))[0]:
            found.append(_candidate(*fit, reference_uv))
    return _apart(found)


def _complex(uv: Array) -> Complex:
    return np.asarray(uv[:, 0] + 1j * uv[:, 1], np.complex128)


def _votes(
    z0: Complex, z1: Complex, bounds: SimilarityBounds, seed: int
) -> tuple[Complex, Complex]:
    """Factor and place of the reference point, of every pair that the bounds allow."""
    first, second = _pairs(len(z0), seed)
    base = z0[second] - z0[first]
    long_enough = np.abs(base) >= MIN_BASELINE_RATIO * 2.0 * float(np.max(np.abs(z0)))
    first, second, base = first[long_enough], second[long_enough], base[long_enough]
    a = (z1[second] - z1[first]) / base
    allowed = bounds.allows(a)
    a, first = a[allowed], first[allowed]
    return a, z1[first] - a * z0[first]


def _pairs(n: int, seed: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    if n * (n - 1) // 2 <= MAX_PAIRS:
        upper = np.triu_indices(n, 1)
        return upper[0].astype(np.int64), upper[1].astype(np.int64)
    # Every match takes part in equally many pairs.
    steps = np.random.default_rng(seed).permutation(n - 1)[: MAX_PAIRS // n] + 1
    first = np.tile(np.arange(n), len(steps))
    return first, (first + np.repeat(steps, n)) % n


def _peaks(centers: Complex) -> list[complex]:
    """Places where most votes fall, best first."""
    if len(centers) == 0:
        return []
    origin = complex(centers.real.min(), centers.imag.min())
    cells = (centers - origin) / CELL_PX
    columns, rows = cells.real.astype(np.int64), cells.imag.astype(np.int64)
    shape = (int(rows.max()) + 1, int(columns.max()) + 1)
    counts = np.bincount(rows * shape[1] + columns, minlength=shape[0] * shape[1])
    table = counts.reshape(shape).astype(np.float32)
    # 3 x 3 sums, so that a peak on a cell's edge is not split.
    summed = cv2.boxFilter(table, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
    is_peak = (summed >= cv2.dilate(summed, np.ones((3, 3), np.uint8))) & (summed >= 2.0)
    peak_rows, peak_columns = np.nonzero(is_peak)
    best = np.argsort(-summed[peak_rows, peak_columns], kind="stable")[:CANDIDATES]
    return [origin + CELL_PX * complex(peak_columns[i] + 0.5, peak_rows[i] + 0.5) for i in best]


def _median(z: Complex) -> complex:
    return complex(np.median(z.real), np.median(z.imag))


def _refine(
    z0: Complex, z1: Complex, a: complex, b: complex, threshold_px: float
) -> tuple[complex, complex, NDArray[np.bool_]] | None:
    """Least squares over a shrinking neighbourhood; the factor, the shift, and who agrees."""
    for factor in (4.0, 2.0, 1.0, 1.0):
        near = np.abs(a * z0 + b - z1) <= factor * threshold_px
        if np.count_nonzero(near) < MIN_AGREEING:
            return None
        middle0, middle1 = z0[near].mean(), z1[near].mean()
        spread = float(np.sum(np.abs(z0[near] - middle0) ** 2))
        if spread <= 0.0:
            return None
        a = complex(np.sum((z1[near] - middle1) * np.conj(z0[near] - middle0)) / spread)
        b = complex(middle1 - a * middle0)
    return a, b, np.abs(a * z0 + b - z1) <= threshold_px


def _candidate(a: complex, b: complex, near: NDArray[np.bool_], reference_uv: Array) -> Candidate:
    center_uv = np.array([b.real, b.imag])
    linear = np.array([[a.real, -a.imag], [a.imag, a.real]])
    H = np.eye(3)
    H[:2, :2] = linear
    H[:2, 2] = center_uv - linear @ reference_uv
    return Candidate(H, near, center_uv)


def _apart(found: list[Candidate]) -> list[Candidate]:
    """The best candidate of each place, best first."""
    kept: list[Candidate] = []
    for candidate in sorted(found, key=lambda candidate: -candidate.count):
        distances_px = [np.linalg.norm(candidate.center_uv - other.center_uv) for other in kept]
        if min(distances_px, default=np.inf) > CELL_PX:
            kept.append(candidate)
    return kept
