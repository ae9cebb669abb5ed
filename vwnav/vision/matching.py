"""Matches, and what their agreement proves.

Features that are each other's nearest are matches. Could so many of them agree by chance? An
a-contrario test in place of a fixed inlier count, after Moisan and Stival, "A probabilistic
criterion to detect rigid point matches between two images" (IJCV 2004): the expected number of
places where unrelated matches would agree as well.

And does the map look alike elsewhere, or turned? Then a registration may be any of the places.
A road with a hedge fits anywhere along itself, a crossing fits turned by a quarter, a runway by a
half. Which of them it is, matches between two dates do not say; the map itself says that it
repeats. Each landmark of a registration is looked for elsewhere: what is nearly as like to it as
the query's feature is could have been matched as well. Where most landmarks have their like at one
and the same shift, the query may be there too.

From image to image, where little has changed, corners are followed by pyramidal Lucas-Kanade with a
check backwards. Dense flow and matching of ORB, SIFT or learned features between the same images
are slower and no more exact (docs/estimation.md has the table).
"""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.geometry.homography import transform_points
from vwnav.types import Array, Features, Gray

CHUNK = 8192  # map features compared at once: 1000 x 8192 float32 are 32 MB
BITS_PER_BYTE = 8
CELL_PX = 16.0  # matches within one cell see the same thing: counted once
MAX_SAMPLE = 160
MAX_LANDMARKS = 150  # that are looked for elsewhere
# Of its likeness to the query, what makes a like of a landmark: the matched are the luckiest.
AS_LIKE = np.float32(0.8)
MIN_SHIFT_PX = 8.0  # what is nearer is the same place
SHIFT_CELL_PX = 4.0  # of the table of shifts, of which 3 x 3 are taken together
_WINDOW_PX = 15  # of a corner that is followed
_LEVELS = 3
_FORTH_AND_BACK_PX = 0.7
_STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 0.02)
_NORMAL_BLOCK_PX, _NORMAL_BLOCKS = 4, 9  # of what a pixel's contrast is relative to: 36 px
_NORMAL_GRAY, _NORMAL_LEVELS, _NORMAL_NOISE = 128.0, 40.0, 4.0  # middle, one deviation; a sensor's
_LEAST_RESPONSE = 2e-5  # smaller eigenvalue of the gradients, gray from 0 to 1: above sensor noise
Descriptors = NDArray[np.float32] | NDArray[np.uint8]
Points = NDArray[np.float32]
BoolArray = NDArray[np.bool_]


def match(frame: Features, map_: Features, *, min_similarity: float = -1.0) -> NDArray[np.int64]:
    """Pairs of features that are each other's nearest.

    Similarity is the cosine of descriptors of unit length, or for binary ones
    1 - 2 * (share of differing bits); both are 1 for equal ones and about 0 for unrelated ones.

    Args:
        frame: n0 features.
        map_: n1 features of the same kind; memory stays bounded however many there are.
        min_similarity: pairs that are less similar are dropped.

    Returns:
        (m, 2) indices into frame and map, the most similar pair first.

    Raises:
        ValueError: the descriptors are of different kinds.
    """
    if frame.descriptors.dtype != map_.descriptors.dtype or (
        frame.descriptors.shape[1] != map_.descriptors.shape[1]
    ):
        raise ValueError(
            f"expected descriptors of one kind, got {frame.descriptors.dtype} x "
            f"{frame.descriptors.shape[1]} and {map_.descriptors.dtype} x "
            f"{map_.descriptors.shape[1]}"
        )
    if 0 in (len(frame.descriptors), len(map_.descriptors)):
        return np.zeros((0, 2), np.int64)
    binary = frame.descriptors.dtype == np.uint8
    mutual_nearest = _mutual_bits if binary else _mutual_cosine
    chosen, similarity, is_mutual = mutual_nearest(frame.descriptors, map_.descriptors)
    mutual = np.flatnonzero(is_mutual & (similarity >= min_similarity))
    best_first = mutual[np.argsort(-similarity[mutual], kind="stable")]
    return np.stack([best_first, chosen[best_first]], axis=1)


def similarities(queries: Descriptors, references: Descriptors) -> NDArray[np.float32]:
    """Similarity (n0, n1) of every descriptor with every other, as `match` has it."""
    if queries.dtype != np.uint8:
        return np.asarray(queries @ references.T, np.float32)
    signs0, signs1 = (
        2.0 * np.unpackbits(each.astype(np.uint8), axis=1).astype(np.float32) - 1.0
        for each in (queries, references)
    )
    return np.asarray(signs0 @ signs1.T / signs0.shape[1], np.float32)


def paired_similarity(queries: Descriptors, references: Descriptors) -> NDArray[np.float32]:
    """Similarity (n,) of each descriptor with the one in the same row, as `match` has it."""
    if queries.dtype != np.uint8:
        return np.asarray(np.einsum("nd,nd->n", queries, references), np.float32)
    differing = np.unpackbits(queries.astype(np.uint8) ^ references.astype(np.uint8), axis=1)
    return np.asarray(1.0 - 2.0 * differing.mean(axis=1), np.float32)


def _mutual_cosine(
    queries: Descriptors, references: Descriptors
) -> tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.bool_]]:
    """The most similar reference of each query, how similar it is, and to no query more so."""
    rows = np.arange(len(queries))
    nearest = np.zeros(len(queries), np.int64)
    similarity = np.full(len(queries), -np.inf, np.float32)
    mutual = np.zeros(len(queries), np.bool_)
    for start in range(0, len(references), CHUNK):
        table = queries @ references[start : start + CHUNK].T
        candidate = np.argmax(table, axis=1)
        value = table[rows, candidate]
        better = value > similarity
        nearest[better] = candidate[better] + start
        similarity[better] = value[better]
        # Of the same product: another one could round otherwise.
        mutual[better] = (value == table.max(axis=0)[candidate])[better]
    return nearest, similarity, mutual


def _mutual_bits(
    queries: Descriptors, references: Descriptors
) -> tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.bool_]]:
    """As `_mutual_cosine`, for binary descriptors."""
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING)
    found = matcher.match(queries, references)
    nearest = np.array([pair.trainIdx for pair in found], np.int64)
    distance = np.array([pair.distance for pair in found], np.float32)
    # Back from the map's side: only the chosen map features have to be asked.
    back = [pair.trainIdx for pair in matcher.match(references[nearest], queries)]
    similarity = 1.0 - 2.0 * distance / np.float32(BITS_PER_BYTE * queries.shape[1])
    return nearest, similarity, np.array(back) == np.arange(len(back))


def log10_nfa(
    H_map_view: Array,
    uv_view: Array,
    uv_map: Array,
    agree: NDArray[np.bool_],
    threshold_px: float,
) -> float:
    """log10 of how often unrelated images would show as good an agreement.

    That a wrong match agrees with a fit by chance is measured on the matches themselves: how often
    the map point of one match lies where the fit puts another. The more the matches crowd there,
    the less their agreement says.

    Args:
        H_map_view: (3, 3) the fit.
        uv_view: (m, 2) all the matches in the view.
        uv_map: (m, 2) their partners on the map.
        agree: (m,) those within the threshold of the fit.
        threshold_px: of agreement.
    """
    cells, agreeing = occupied_cells(uv_view), occupied_cells(uv_view[agree])
    if agreeing <= 2:
        return 0.0
    # How often the map point of another match is within the threshold of the fit.
    step = max(1, len(uv_view) // MAX_SAMPLE)
    mapped = transform_points(H_map_view, uv_view[::step])
    # A wider circle counts more pairs; the area brings it back.
    radius_px = 4.0 * threshold_px
    # Axis by axis: sums of two over a last axis take eight times as long.
    du = mapped[:, None, 0] - uv_map[:, 0]
    dv = mapped[:, None, 1] - uv_map[:, 1]
    near = np.count_nonzero(du**2 + dv**2 <= radius_px**2)
    own = np.count_nonzero(np.sum((mapped - uv_map[::step]) ** 2, axis=1) <= radius_px**2)
    # One pair more than was seen: absence of evidence is no evidence of zero.
    one = (near - own + 1) / (len(mapped) * (len(uv_map) - 1)) / 16.0
    chance = min(1.0, len(uv_view) / cells * one)  # that any of a cell agrees
    couples = cells * (cells - 1) / 2.0  # each makes a similarity that is looked at
    return math.log10(couples) + _log10_tail(cells - 2, agreeing - 2, chance)


def occupied_cells(uv_view: Array) -> int:
    """In how many cells of the view the points (m, 2) lie."""
    column, row = np.floor((uv_view + 0.5) / CELL_PX).astype(np.int64).T
    return len(np.unique(column + 100_000 * row))


def _log10_tail(n: int, k: int, p: float) -> float:
    """log10 of the probability of k or more successes in n trials of probability p."""
    if k <= n * p:
        return 0.0
    i = np.arange(k, n + 1)
    log_factorial = np.concatenate([[0.0], np.cumsum(np.log(np.arange(1, n + 1)))])
    log_terms = (
        log_factorial[n]
        - log_factorial[i]
        - log_factorial[n - i]
        + i * math.log(p)
        + (n - i) * math.log1p(-min(p, 1.0 - 1e-12))
    )
    top = float(log_terms.max())
    return (top + math.log(float(np.sum(np.exp(log_terms - top))))) / math.log(10.0)


def share_alike(
    landmarks: Features,
    likeness: NDArray[np.float32],
    others: Features,
    within_px: float = math.inf,
    beyond_px: float = MIN_SHIFT_PX,
) -> float:
    """Share of the cells with landmarks whose like lies at one shift, the best there is.

    Args:
        landmarks: map features that carry a registration.
        likeness: (k,) similarity of each with the query's feature that was matched to it.
        others: features of the map, their pixels those of the landmarks but for a shift.
        within_px: a longer shift does not count.
        beyond_px: nor does one that is not longer.
    """
    step = math.ceil(len(landmarks.uv) / MAX_LANDMARKS)
    uv, onto = landmarks.uv[::step], others.uv
    if len(onto) == 0:
        return 0.0
    alike = similarities(landmarks.descriptors[::step], others.descriptors)
    # Of some kinds of features unrelated ones are alike by half: what counts is more than that.
    # The median: np.median asks for three places at once, and takes ten times as long.
    middle, odd = divmod(alike.shape[1], 2)
    ranked = np.partition(alike, middle, axis=1)
    upper = ranked[:, middle]
    lower = upper if odd else ranked[:, :middle].max(axis=1)
    unrelated = (lower + upper) / np.float32(2.0)
    least = unrelated + AS_LIKE * (likeness[::step] - unrelated)
    owners, twins = np.nonzero(alike >= least[:, None])
    shifts = (onto[twins] - uv[owners]).astype(np.float64)
    length_px = np.linalg.norm(shifts, axis=1)
    counted = (length_px > beyond_px) & (length_px <= within_px)
    shifts, owners = shifts[counted], owners[counted]
    if len(shifts) == 0:
        return 0.0
    best = _peak(shifts)
    at_best = np.abs(shifts - best).max(axis=1) <= 1.5 * SHIFT_CELL_PX
    agreeing = uv[np.unique(owners[at_best])].astype(np.float64)
    return occupied_cells(agreeing) / occupied_cells(uv.astype(np.float64))


def _peak(shifts: Array) -> Array:
    """The shift (2,) that most agree upon."""
    origin = shifts.min(axis=0)
    column, row = ((shifts - origin) / SHIFT_CELL_PX).astype(np.int64).T
    shape = (int(row.max()) + 1, int(column.max()) + 1)
    table = np.bincount(row * shape[1] + column, minlength=shape[0] * shape[1]).reshape(shape)
    # 3 x 3 sums, so that a peak on a cell's edge is not split.
    summed = cv2.boxFilter(
        table.astype(np.float32), -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT
    )
    v, u = np.unravel_index(int(np.argmax(summed)), shape)
    return np.asarray(origin + SHIFT_CELL_PX * (np.array([u, v]) + 0.5))


def find_corners(gray: Gray, cell_px: int) -> Points:
    """The strongest corner (n, 2) of each cell of the image, if it is one (Shi and Tomasi 1994).

    One per cell spreads them evenly, which is what tells tilting from moving.
    """
    response = cv2.cornerMinEigenVal(gray, 5)
    margin = _WINDOW_PX // 2
    rows, columns = ((size - 2 * margin) // cell_px for size in gray.shape)
    if rows < 1 or columns < 1:
        return np.zeros((0, 2), np.float32)
    inner = response[margin : margin + rows * cell_px, margin : margin + columns * cell_px]
    cells = inner.reshape(rows, cell_px, columns, cell_px).transpose(0, 2, 1, 3)
    flat = cells.reshape(rows * columns, cell_px * cell_px)
    best = np.argmax(flat, axis=1)
    strong = np.flatnonzero(flat[np.arange(len(flat)), best] > _LEAST_RESPONSE)
    u = margin + (strong % columns) * cell_px + best[strong] % cell_px
    v = margin + (strong // columns) * cell_px + best[strong] // cell_px
    return np.column_stack([u, v]).astype(np.float32)


def normalize_contrast(gray: Gray) -> Gray:
    """The image (h, w) less its local mean, over its local standard deviation, about 128.

    Lucas and Kanade take brightness for constant: of an exposure that changes by 5 % between two
    images they lose one corner in seven, of 20 % half of them, and what they keep is off by twice
    and four times as much. To this an exposure, a cloud's shadow or haze is nothing. Local contrast
    normalisation: Jarrett et al., What is the Best Multi-Stage Architecture for Object
    Recognition?, ICCV 2009.
    """
    h, w = gray.shape
    small_wh = max(w // _NORMAL_BLOCK_PX, 1), max(h // _NORMAL_BLOCK_PX, 1)
    squared = cv2.multiply(gray, gray, dtype=cv2.CV_32F)
    small = cv2.resize(gray, small_wh, interpolation=cv2.INTER_AREA).astype(np.float32)
    small_squared = cv2.resize(squared, small_wh, interpolation=cv2.INTER_AREA)
    mean = cv2.blur(small, (_NORMAL_BLOCKS, _NORMAL_BLOCKS))
    variance = cv2.blur(small_squared, (_NORMAL_BLOCKS, _NORMAL_BLOCKS)) - mean * mean
    gain = _NORMAL_LEVELS / (np.sqrt(np.maximum(variance, 0.0)) + _NORMAL_NOISE)
    levels = cv2.multiply(gray, cv2.resize(gain, (w, h)), dtype=cv2.CV_32F)
    levels = cv2.add(levels, cv2.resize(_NORMAL_GRAY - gain * mean, (w, h)), dtype=cv2.CV_8U)
    return np.asarray(levels, np.uint8)


def track(gray0: Gray, gray1: Gray, uv0: Points, guess_uv1: Points) -> tuple[Points, BoolArray]:
    """Follow points from image 0 to image 1.

    Args:
        gray0: image 0, of a contrast that is normalized: brightness is taken for constant.
        gray1: image 1, of the same size.
        uv0: (n, 2) where they are in image 0.
        guess_uv1: (n, 2) where they are thought to be in image 1.

    Returns:
        (n, 2) where they are, and (n,) whether they came back to where they started.
    """
    height, width = gray1.shape
    inside = np.all((guess_uv1 >= 0) & (guess_uv1 <= (width - 1, height - 1)), axis=1)
    uv1 = guess_uv1.copy()
    kept = np.zeros(len(uv0), dtype=np.bool_)
    if not np.any(inside):
        return uv1, kept
    start, guess = np.ascontiguousarray(uv0[inside]), np.ascontiguousarray(guess_uv1[inside])
    forth, found = _lucas_kanade(gray0, gray1, start, guess)
    # Backwards from the same guess of the motion, not from the answer, or any answer would agree.
    back, found_back = _lucas_kanade(gray1, gray0, forth, forth - (guess - start))
    good = found & found_back & (np.max(np.abs(back - start), axis=1) < _FORTH_AND_BACK_PX)
    uv1[inside] = forth
    kept[inside] = good
    return uv1, kept


def _lucas_kanade(
    gray0: Gray, gray1: Gray, uv0: Points, guess_uv1: Points
) -> tuple[Points, BoolArray]:
    uv1, status, _ = cv2.calcOpticalFlowPyrLK(
        gray0,
        gray1,
        uv0,
        guess_uv1.copy(),
        winSize=(_WINDOW_PX, _WINDOW_PX),
        maxLevel=_LEVELS,
        criteria=_STOP,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    points = np.asarray(uv1, dtype=np.float32).reshape(-1, 2)
    found = status.ravel().astype(np.bool_) & np.all(np.isfinite(points), axis=1)
    return points, found
