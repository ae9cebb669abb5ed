"""One feature set on one scene, and the mean over a group of scenes."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.bench.features.methods import FeatureSet
from vwnav.bench.features.repeatability import KEYPOINTS, Repeatability, repeatability
from vwnav.bench.features.scenes import BLOCK_PX, EDGE_PX, MARGIN_PX, Mask, ReferenceMap, Scene
from vwnav.geometry.homography import estimate_homography, transform_points
from vwnav.geometry.similarity import estimate_similarity
from vwnav.types import Array, Features, Gray

RIGHT_PX = 3.0  # a match nearer to the truth than this is an inlier
FIT_PX = 5.0  # of the similarity: it does not follow tilt and relief
AUC_PX = (1.0, 3.0, 5.0)
NEAR, FAR = 3.0, 8.0  # metres on flights, pixels on pairs
_MAX_OVERSAMPLING = 2.5
_SEED = 0


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SceneResult:
    """How one method did on one scene.

    Attributes:
        uv0, uv1: (m, 2) matches in image and map.
        right: (m,) the inliers: near the true homography, or near the fit where there is none.
        errors_px: (inliers,) their distances from it.
        place_error: of the similarity, in the scene's unit; infinite where there is no fit.
        corner_error_px: mean over the image's corners of the homography; None without a truth.
        repeated: share of keypoints that the other image has too; None without a truth.
        repeatable: the same of 1000 keypoints, beside chance; None where nobody finds the place.
    """

    scene: Scene
    method: str
    keypoints: int
    uv0: Array
    uv1: Array
    right: NDArray[np.bool_]
    errors_px: Array
    place_error: float
    corner_error_px: float | None
    repeated: float | None
    repeatable: Repeatability | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class FeatureScore:
    """Means over the scenes of a group; see docs/benchmarks.md for each."""

    scenes: int
    keypoints: float
    matches: float
    inliers: float
    precision: float
    reprojection_px: float | None  # median over all inliers
    repeatability: float | None
    repeated_above_chance: float | None
    auc: dict[str, float] | None
    located_near: float
    located_far: float
    place_error: float | None  # median of those within `FAR`


@dataclass(slots=True)
class Judge:
    """Scores scenes one after another; remembers the features of the map it saw last."""

    feature_sets: list[FeatureSet]
    _map: ReferenceMap | None = None
    _map_features: dict[str, Features] = field(default_factory=dict)

    def judge(self, scene: Scene) -> Iterator[SceneResult]:
        """One outcome for each method."""
        if scene.map_ is not self._map:
            self._map, self._map_features = scene.map_, {}
        outcomes: list[tuple[FeatureSet, list[SceneResult]]] = []
        for each in self.feature_sets:
            if each.name not in self._map_features:
                self._map_features[each.name] = map_features(each, scene.map_)
            reference = inside_window(self._map_features[each.name], scene.window)
            outcomes.append((each, list(_outcomes(each, scene, reference))))
        H_1_0 = scene.H_1_0
        if H_1_0 is None:
            H_1_0 = agreed_homography([o for _, of_set in outcomes for o in of_set])
        for each, of_set in outcomes:
            repeatable = None if H_1_0 is None else self._repeatable(each, scene, H_1_0)
            yield from (replace(outcome, repeatable=repeatable) for outcome in of_set)

    def _repeatable(self, each: FeatureSet, scene: Scene, H_1_0: Array) -> Repeatability | None:
        """1000 keypoints of the image beside as many per area of its map."""
        reference = self._map_features[each.name]
        if scene.keypoints != KEYPOINTS:
            budget = round(scene.map_.keypoints * KEYPOINTS / scene.keypoints)
            reference = map_features(each, replace(scene.map_, keypoints=budget))
        found = masked_features(each, scene.image, scene.mask, KEYPOINTS)
        return repeatability(found, reference, H_1_0, scene.map_)


def _outcomes(each: FeatureSet, scene: Scene, reference: Features) -> Iterator[SceneResult]:
    """One feature set on one scene, matched in all its ways."""
    found = masked_features(each, scene.image, scene.mask, scene.keypoints)
    repeated = _repeated(found, reference, scene)
    for method in each.methods:
        index = method.match(found, reference)
        pair = (found.uv[index[:, 0]], reference.uv[index[:, 1]])
        uv0, uv1 = (uv.astype(np.float64) for uv in pair)
        yield _outcome(scene, method.name, len(found), uv0, uv1, repeated)


def agreed_homography(outcomes: list[SceneResult]) -> Array | None:
    """What the right matches of all methods say together, where no label is that exact."""
    placed = [o for o in outcomes if o.place_error < FAR]
    if not placed:
        return None
    uv0 = np.concatenate([o.uv0[o.right] for o in placed])
    uv1 = np.concatenate([o.uv1[o.right] for o in placed])
    fit = estimate_homography(uv0, uv1, RIGHT_PX, _SEED)
    return None if fit is None else fit.H


def masked_features(each: FeatureSet, gray: Gray, mask: Mask, budget: int) -> Features:
    """The strongest keypoints that lie on ground, at most `budget`."""
    if mask.all():
        return each.extract(gray, budget)
    kernel = np.ones((2 * EDGE_PX + 1, 2 * EDGE_PX + 1), np.uint8)
    inner = cv2.erode(mask.astype(np.uint8), kernel) > 0
    share = min(_MAX_OVERSAMPLING, mask.size / max(int(inner.sum()), 1))
    found = each.extract(gray, round(budget * share))
    column, row = np.round(found.uv).astype(np.int64).T
    h, w = mask.shape
    usable = inner[np.clip(row, 0, h - 1), np.clip(column, 0, w - 1)]
    return found.take(np.flatnonzero(usable)[:budget])


def map_features(each: FeatureSet, map_: ReferenceMap) -> Features:
    """The map's features: as many per area everywhere, whatever the size of the map."""
    h, w = map_.gray.shape
    if max(h, w) <= BLOCK_PX:
        return masked_features(each, map_.gray, map_.mask, map_.keypoints)
    density = map_.keypoints / map_.mask.sum()
    parts = []
    for v0, v_low, v_high in _blocks(h):
        for u0, u_low, u_high in _blocks(w):
            block = (slice(v0, v0 + BLOCK_PX), slice(u0, u0 + BLOCK_PX))
            covered = int(map_.mask[block].sum())
            if covered == 0:
                continue
            found = masked_features(
                each, map_.gray[block], map_.mask[block], round(density * covered)
            )
            uv = found.uv + np.array([u0, v0], np.float32)
            own = (uv >= (u_low, v_low)) & (uv < (u_high, v_high))
            parts.append(
                Features(uv, found.descriptors, found.scores).take(np.flatnonzero(own.all(axis=1)))
            )
    return Features(
        np.concatenate([part.uv for part in parts]),
        np.concatenate([part.descriptors for part in parts]),
        np.concatenate([part.scores for part in parts]),
    )


def _blocks(side_px: int) -> Iterator[tuple[int, float, float]]:
    """Start of each block along one side, and the range of pixels that is its own."""
    if side_px <= BLOCK_PX:
        yield 0, -0.5, side_px - 0.5
        return
    for start in range(0, side_px - 2 * MARGIN_PX, BLOCK_PX - 2 * MARGIN_PX):
        end = start + BLOCK_PX
        low = start + (MARGIN_PX if start > 0 else 0)
        high = end - (MARGIN_PX if end < side_px else 0)
        yield start, low - 0.5, high - 0.5


def inside_window(features: Features, window: tuple[float, float, float, float]) -> Features:
    """Those between (u0, v0) and (u1, v1)."""
    near = (features.uv >= window[:2]) & (features.uv < window[2:])
    return features.take(np.flatnonzero(near.all(axis=1)))


def _outcome(
    scene: Scene, method: str, keypoints: int, uv0: Array, uv1: Array, repeated: float | None
) -> SceneResult:
    fit = estimate_similarity(uv0, uv1, FIT_PX, _SEED)
    place_error = np.inf
    if fit is not None:
        placed = transform_points(fit.H, scene.point0_uv)[0]
        place_error = float(np.linalg.norm(placed - scene.point1_uv)) * scene.map_.unit_per_px
    if scene.H_1_0 is not None:
        errors = _distances(scene.H_1_0, uv0, uv1)
        right = errors < RIGHT_PX
    elif fit is not None:
        errors, right = _distances(fit.H, uv0, uv1), fit.inliers
    else:
        errors, right = np.full(len(uv0), np.inf), np.zeros(len(uv0), np.bool_)
    return SceneResult(
        scene=scene,
        method=method,
        keypoints=keypoints,
        uv0=uv0,
        uv1=uv1,
        right=right,
        errors_px=errors[right],
        place_error=place_error,
        corner_error_px=None if scene.H_1_0 is None else corner_error(scene, uv0, uv1),
        repeated=repeated,
    )


def corner_error(scene: Scene, uv0: Array, uv1: Array) -> float:
    """Mean distance of the image's corners under the homography found from where they belong."""
    fit = estimate_homography(uv0, uv1, RIGHT_PX, _SEED)
    if fit is None or scene.H_1_0 is None:
        return np.inf
    h, w = scene.image.shape
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]) * (w - 1.0, h - 1.0)
    error = _distances(fit.H, corners, transform_points(scene.H_1_0, corners)).mean()
    return float(error) if np.isfinite(error) else np.inf


def area_under_curve(errors: Array, threshold: float) -> float:
    """Area under the share of errors below x, for x up to the threshold, as a share of the whole.

    The curve through the sorted errors, as SuperGlue (Sarlin et al. 2020) draws it.
    """
    x = np.concatenate([[0.0], np.sort(errors)])
    y = np.arange(len(x)) / len(errors)
    below = np.searchsorted(x, threshold)
    x = np.concatenate([x[:below], [threshold]])
    y = np.concatenate([y[:below], [y[below - 1]]])
    return float(np.trapezoid(y, x) / threshold)


def score(outcomes: Iterable[SceneResult]) -> FeatureScore:
    """The mean over scenes of one method."""
    each = list(outcomes)
    places = np.array([o.place_error for o in each])
    errors = np.concatenate([o.errors_px for o in each])
    corners = np.array([o.corner_error_px for o in each if o.corner_error_px is not None])
    repeated = [o.repeated for o in each if o.repeated is not None]
    margins = [o.repeatable.above_chance for o in each if o.repeatable is not None]
    near = places[places < FAR]
    # Without a true homography matches are right where the whole fit is.
    trusted = [o.scene.H_1_0 is not None or o.place_error < FAR for o in each]
    shares = [
        o.right.mean() if o.right.size and ok else 0.0 for o, ok in zip(each, trusted, strict=True)
    ]
    auc = {f"{px:g}_px": area_under_curve(corners, px) for px in AUC_PX} if corners.size else None
    return FeatureScore(
        scenes=len(each),
        keypoints=float(np.mean([o.keypoints for o in each])),
        matches=float(np.mean([len(o.uv0) for o in each])),
        inliers=float(np.mean([o.right.sum() for o in each])),
        precision=float(np.mean(shares)),
        reprojection_px=float(np.median(errors)) if errors.size else None,
        repeatability=float(np.mean(repeated)) if repeated else None,
        repeated_above_chance=float(np.mean(margins)) if margins else None,
        auc=auc,
        located_near=float(np.mean(places < NEAR)),
        located_far=float(np.mean(places < FAR)),
        place_error=float(np.median(near)) if near.size else None,
    )


def _distances(H_1_0: Array, uv0: Array, uv1: Array) -> Array:
    return np.asarray(np.linalg.norm(transform_points(H_1_0, uv0) - uv1, axis=1))


def _repeated(found: Features, reference: Features, scene: Scene) -> float | None:
    """Share of the keypoints that both images show which the map has within `RIGHT_PX`."""
    if scene.H_1_0 is None or len(found) == 0 or len(reference) == 0:
        return None
    carried = transform_points(scene.H_1_0, found.uv.astype(np.float64))
    h, w = scene.map_.gray.shape
    column, row = np.round(carried).astype(np.int64).T
    seen = (column >= EDGE_PX) & (column < w - EDGE_PX) & (row >= EDGE_PX) & (row < h - EDGE_PX)
    seen[seen] = scene.map_.mask[row[seen], column[seen]]
    if not seen.any():
        return None
    distance = np.linalg.norm(carried[seen, None] - reference.uv[None], axis=2).min(axis=1)
    return float((distance < RIGHT_PX).mean())
