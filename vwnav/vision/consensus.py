"""What matches between a view and a piece of map agree upon.

Pairs of matches vote for where the view might be, so a tenth of right matches is enough; the best
place is fitted by a homography where that explains more.

Points are complex numbers here, z = u + i v: a similarity is then `z_map = a z_view + b`, with the
scale |a| and the clockwise rotation arg(a).
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.geometry.homography import grown_homography, jacobian_at, transform_points
from vwnav.types import Array
from vwnav.vision.matching import log10_nfa, occupied_cells

Complex = NDArray[np.complex128]
MAX_PAIRS = 40_000
CELL_PX = 12.0
PLACES = 6
MIN_AGREEING = 3
MIN_BASELINE_RATIO = 0.08  # of the view's diagonal: shorter pairs tell no rotation
MIN_FOR_HOMOGRAPHY = 16
HOMOGRAPHY_GAIN = 1.08  # eight unknowns must explain so many times the matches that four do


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
        # As |arg(a)| <= max_rotation_rad, without an arcus.
        rotation_ok = a.real >= math.cos(min(self.max_rotation_rad, math.pi)) * scale
        return rotation_ok & (scale <= self.max_scale) & (scale * self.max_scale >= 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Similarity:
    """A similarity that several matches agree on.

    Attributes:
        H_map_view: (3, 3).
        near: (m,) bool, matches within the threshold of it, which agree.
        count: how many they are.
        center_uv: (2,) where it puts the reference point.
    """

    H_map_view: Array
    near: NDArray[np.bool_]
    count: int
    center_uv: Array


@dataclass(frozen=True, slots=True, eq=False)
class Consensus:
    """The transform that most matches agree upon.

    Attributes:
        H_map_view: (3, 3) from view pixels to the piece's pixels.
        uv_view, uv_map: (k, 2) the inliers.
        inliers: (m,) bool, which of the matches they are.
        matches: how many there were, m.
        log10_nfa: expected chance agreements as good as this, see `significance`.
        cells: of the view that hold an inlier.
        rival_cells: the same of the best other place.
    """

    H_map_view: Array
    uv_view: Array
    uv_map: Array
    inliers: NDArray[np.bool_]
    matches: int
    log10_nfa: float
    cells: int
    rival_cells: int


def find_consensus(
    uv_view: Array,
    uv_map: Array,
    size_wh: tuple[int, int],
    bounds: SimilarityBounds,
    threshold_px: float,
    max_stretch: float,
    seed: int,
) -> Consensus | None:
    """Where the matches put the view; None where no two agree.

    Args:
        uv_view: (m, 2) matched points of the view, pixels.
        uv_map: (m, 2) their partners on the map.
        size_wh: of the view.
        bounds: scale and rotation that the prior allows.
        threshold_px: largest error of an inlier, map pixels.
        max_stretch: of a homography against a similarity, along an axis or across the view.
        seed: of the random choices.
    """
    middle = (np.array(size_wh) - 1.0) / 2.0
    places = vote(uv_view, uv_map, middle, bounds, threshold_px, seed)
    if not places:
        return None
    H, inliers = _fit(uv_view, uv_map, places[0], size_wh, threshold_px, max_stretch)
    rival_cells = 0
    for place in places[1:]:
        rival_cells = max(rival_cells, occupied_cells(uv_view[place.near]))
    return Consensus(
        H_map_view=H,
        uv_view=uv_view[inliers],
        uv_map=uv_map[inliers],
        inliers=inliers,
        matches=len(inliers),
        log10_nfa=log10_nfa(H, uv_view, uv_map, inliers, threshold_px),
        cells=occupied_cells(uv_view[inliers]),
        rival_cells=rival_cells,
    )


def _fit(
    uv_view: Array,
    uv_map: Array,
    place: Similarity,
    size_wh: tuple[int, int],
    threshold_px: float,
    max_stretch: float,
) -> tuple[Array, NDArray[np.bool_]]:
    """The better of the similarity and a homography about it, and its inliers."""
    error = np.linalg.norm(transform_points(place.H_map_view, uv_view) - uv_map, axis=1)
    around = np.flatnonzero(error <= 3.0 * threshold_px)
    # With all of them it must explain so many.
    if len(around) < max(MIN_FOR_HOMOGRAPHY, HOMOGRAPHY_GAIN * place.count):
        return place.H_map_view, place.near
    fit = grown_homography(uv_view[around], uv_map[around], place.H_map_view, threshold_px)
    if (
        fit is None
        or fit.count < HOMOGRAPHY_GAIN * place.count
        or _stretch(fit.H, size_wh) > max_stretch
    ):
        return place.H_map_view, place.near
    inliers = np.zeros(len(uv_view), np.bool_)
    inliers[around[fit.inliers]] = True
    return fit.H, inliers


def _stretch(H_map_view: Array, size_wh: tuple[int, int]) -> float:
    """How far a homography is from a similarity: 1 when it is one.

    The largest ratio of local lengths, between directions at the view's middle, or between its
    middle and the middles of its sides.
    """
    w, h = size_wh
    middle = np.array([(w - 1) / 2.0, (h - 1) / 2.0])
    lengths = np.linalg.svd(jacobian_at(H_map_view, middle), compute_uv=False)
    areas = [
        abs(float(np.linalg.det(jacobian_at(H_map_view, middle + offset))))
        for offset in ([0, 0], [w / 2, 0], [-w / 2, 0], [0, h / 2], [0, -h / 2])
    ]
    across = np.sqrt(max(areas) / max(min(areas), 1e-12))
    return float(max(lengths[0] / max(lengths[1], 1e-12), across))


def vote(
    uv_view: Array,
    uv_map: Array,
    reference_uv: Array,
    bounds: SimilarityBounds,
    threshold_px: float,
    seed: int,
) -> list[Similarity]:
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
        At most `PLACES`, which put the reference point on different places.
    """
    if len(uv_view) < MIN_AGREEING:
        return []
    z0 = np.ascontiguousarray(uv_view - reference_uv).view(np.complex128)[:, 0]
    z1 = np.ascontiguousarray(uv_map).view(np.complex128)[:, 0]
    a, centers = _votes(z0, z1, bounds, seed)
    starts = _starts(a, centers)
    if len(starts) == 0:
        return []
    a, b, near = _refine(z0, z1, starts, threshold_px)
    counts = np.count_nonzero(near, axis=1)
    best_first = np.argsort(-counts, kind="stable")
    right = (bounds.allows(a) & (counts >= MIN_AGREEING))[best_first]
    found: list[Similarity] = []
    centers = np.zeros(0, np.complex128)
    for i in best_first[right]:
        if np.all(np.abs(centers - b[i]) > CELL_PX):
            centers = np.append(centers, b[i])
            center_uv = np.array([b[i].real, b[i].imag])
            H = np.array([[a[i].real, -a[i].imag, 0.0], [a[i].imag, a[i].real, 0.0], [0, 0, 1.0]])
            H[:2, 2] = center_uv - H[:2, :2] @ reference_uv
            found.append(Similarity(H, near[i], int(counts[i]), center_uv))
    return found


def _votes(
    z0: Complex, z1: Complex, bounds: SimilarityBounds, seed: int
) -> tuple[Complex, Complex]:
    """Factor and place of the reference point, of every pair that the bounds allow."""
    n = len(z0)
    if n * (n - 1) // 2 <= MAX_PAIRS:
        first, second = np.triu_indices(n, 1)
    else:  # every match takes part in equally many pairs
        steps = np.random.default_rng(seed).permutation(n - 1)[: MAX_PAIRS // n] + 1
        first = np.tile(np.arange(n), len(steps))
        second = (first + np.repeat(steps, n)) % n
    base, moved = z0[second] - z0[first], z1[second] - z1[first]
    base2, moved2 = base.real**2 + base.imag**2, moved.real**2 + moved.imag**2
    # Lengths first, squared: angles of all would take most of the time.
    most2 = bounds.max_scale**2
    fits = base2 >= (MIN_BASELINE_RATIO * 2.0 * float(np.max(np.abs(z0)))) ** 2
    kept = np.flatnonzero(fits & (moved2 <= most2 * base2) & (base2 <= most2 * moved2))
    a, first = moved[kept] / base[kept], first[kept]
    allowed = bounds.allows(a)
    a, first = a[allowed], first[allowed]
    return a, z1[first] - a * z0[first]


def _peaks(centers: Complex) -> Complex:
    """Places where most votes fall, best first."""
    if len(centers) == 0:
        return centers
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
    best = np.argsort(-summed[peak_rows, peak_columns], kind="stable")[:PLACES]
    peaks = peak_columns[best] + 0.5 + 1j * (peak_rows[best] + 0.5)
    return np.asarray(origin + CELL_PX * peaks, np.complex128)


def _starts(a: Complex, centers: Complex) -> Complex:
    """(k, 2) factor and place of the votes at the places where most of them fall, best first."""
    starts = []
    for peak in _peaks(centers):
        # As wide as the corners of the 3 x 3 cells, so that no peak is without votes.
        away = centers - peak
        close = np.flatnonzero(away.real**2 + away.imag**2 <= (2.2 * CELL_PX) ** 2)
        votes, places = a[close], centers[close]
        parts = np.array([votes.real, votes.imag, places.real, places.imag])
        # The medians; np.median takes twice as long.
        middle, odd = divmod(len(close), 2)
        ranked = np.partition(parts, middle, axis=1)
        upper = ranked[:, middle]
        lower = upper if odd else ranked[:, :middle].max(axis=1)
        starts.append((lower + upper) / 2.0)
    return np.array(starts).reshape(-1, 4).view(np.complex128)


def _refine(
    z0: Complex, z1: Complex, starts: Complex, threshold_px: float
) -> tuple[Complex, Complex, NDArray[np.bool_]]:
    """Least squares over shrinking neighbourhoods of k similarities at once.

    Args:
        z0: (m,) points of the view.
        z1: (m,) their partners on the map.
        starts: (k, 2) factors and shifts to begin with.
        threshold_px: largest error of a match that agrees.

    Returns:
        The factors (k,), the shifts (k,), and who agrees with each (k, m); of a similarity that
        fewer than `MIN_AGREEING` agree with at any time, none do.
    """
    a, b = starts.T
    moments = np.stack([z0, z1, np.abs(z0) ** 2, z1 * np.conj(z0)], axis=1)
    for factor in (4.0, 2.0, 1.0, 1.0):
        near = _near(z0, z1, a, b, factor * threshold_px)
        count = np.count_nonzero(near, axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            mean0, mean1, square, product = (near @ moments / count[:, None]).T
            a = (product - mean1 * np.conj(mean0)) / (square - np.abs(mean0) ** 2)
            a[count < MIN_AGREEING] = np.nan
            b = mean1 - a * mean0
    return a, b, _near(z0, z1, a, b, threshold_px)


def _near(z0: Complex, z1: Complex, a: Complex, b: Complex, within_px: float) -> NDArray[np.bool_]:
    """Which points (m,) each of k similarities puts within a distance of their partners (k, m)."""
    off = a[:, None] * z0 + b[:, None] - z1
    return np.asarray(off.real**2 + off.imag**2 <= within_px**2)
