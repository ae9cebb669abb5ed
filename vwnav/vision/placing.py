"""Putting a view on a piece of map: match, propose, fit, and ask whether it could be chance."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vwnav.geometry.homography import estimate_homography, jacobian_at, transform_points
from vwnav.types import Array, Features, RejectReason
from vwnav.vision.hypotheses import Candidate, SimilarityBounds, propose
from vwnav.vision.matching import match
from vwnav.vision.significance import log10_false_alarms, witnesses
from vwnav.vision.view import View

MIN_KEYPOINTS = 12
MIN_MATCHES = 8
MIN_FOR_HOMOGRAPHY = 16
HOMOGRAPHY_GAIN = 1.08  # eight unknowns must explain so many times the matches that four do
MAX_RIVALRY = 0.7  # of the best place's witnesses for another place: then neither is believed
MIN_WIDTH_PX = 3.0  # inliers on a line slide along it


@dataclass(frozen=True, slots=True, kw_only=True)
class PlacingRules:
    """What makes a placement believed.

    Attributes:
        threshold_px: largest error of an inlier, map pixels.
        max_log10_false_alarms: expected chance agreements, log10, of what is worth a closer look.
        max_stretch: of a homography against a similarity, along an axis or across the view.
    """

    threshold_px: float
    max_log10_false_alarms: float
    max_stretch: float


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """A view found on a piece of map.

    Attributes:
        H_map_view: (3, 3) from view pixels to the piece's pixels.
        uv_view, uv_map: (k, 2) the inliers.
        matches: how many matches there were.
        log10_false_alarms: see `significance`.
        witnesses: cells of the view that hold an inlier.
    """

    H_map_view: Array
    uv_view: Array
    uv_map: Array
    matches: int
    log10_false_alarms: float
    witnesses: int


@dataclass(frozen=True, slots=True)
class Misplaced:
    """Why a view was not found, with the counts so far."""

    reason: RejectReason
    detail: str
    matches: int = 0
    inliers: int = 0
    keypoints: int = 0


def match_view(view: View, map_: Features) -> NDArray[np.int64] | Misplaced:
    """Pairs (m, 2) of a view's features and those of a piece of map."""
    if len(view.features) < MIN_KEYPOINTS:
        return Misplaced(
            RejectReason.FEW_KEYPOINTS, f"{len(view.features)} keypoints in the picture"
        )
    if len(map_) < MIN_KEYPOINTS:
        return Misplaced(RejectReason.FEW_KEYPOINTS, f"{len(map_)} keypoints on the map there")
    pairs = match(view.features, map_)
    if len(pairs) < MIN_MATCHES:
        return Misplaced(RejectReason.FEW_MATCHES, f"{len(pairs)} matches", len(pairs))
    return pairs


def place(
    view: View,
    map_: Features,
    pairs: NDArray[np.int64],
    bounds: SimilarityBounds,
    rules: PlacingRules,
    seed: int,
) -> Placement | Misplaced:
    """Find where on a piece of map a view belongs.

    Args:
        view: with its features.
        map_: features of the piece of map, at the view's resolution.
        pairs: (m, 2) matches between them.
        bounds: of scale and rotation.
        rules: what is believed.
        seed: of the random choices.
    """
    uv_view = view.features.uv[pairs[:, 0]].astype(np.float64)
    uv_map = map_.uv[pairs[:, 1]].astype(np.float64)
    size_wh = view.rectification.size_wh
    middle = (np.array(size_wh) - 1.0) / 2.0
    candidates = propose(uv_view, uv_map, middle, bounds, rules.threshold_px, seed)
    if not candidates:
        return Misplaced(RejectReason.FEW_INLIERS, "no two matches agree", len(pairs))
    best = _fit(uv_view, uv_map, candidates[0], size_wh, rules, seed)
    rivals = [witnesses(uv_view[rival.near]) for rival in candidates[1:]]
    refusal = _refusal(best, max(rivals, default=0), rules)
    return best if refusal is None else refusal


def _fit(
    uv_view: Array,
    uv_map: Array,
    candidate: Candidate,
    size_wh: tuple[int, int],
    rules: PlacingRules,
    seed: int,
) -> Placement:
    """The better of the similarity and a homography about it."""
    H, inliers = candidate.H_map_view, candidate.near
    error = np.linalg.norm(transform_points(H, uv_view) - uv_map, axis=1)
    around = np.flatnonzero(error <= 3.0 * rules.threshold_px)
    if len(around) >= MIN_FOR_HOMOGRAPHY:
        fit = estimate_homography(uv_view[around], uv_map[around], rules.threshold_px, seed)
        if (
            fit is not None
            and fit.count >= HOMOGRAPHY_GAIN * candidate.count
            and _stretch(fit.H, size_wh) <= rules.max_stretch
        ):
            H, inliers = fit.H, np.zeros(len(uv_view), np.bool_)
            inliers[around[fit.inliers]] = True
    return Placement(
        H_map_view=H,
        uv_view=uv_view[inliers],
        uv_map=uv_map[inliers],
        matches=len(uv_view),
        log10_false_alarms=log10_false_alarms(H, uv_view, uv_map, inliers, rules.threshold_px),
        witnesses=witnesses(uv_view[inliers]),
    )


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


def may_be_chance(placement: Placement) -> Misplaced:
    """The refusal of a placement that too little speaks for."""
    matches, inliers = placement.matches, len(placement.uv_view)
    detail = f"{inliers} of {matches} matches agree, which may be chance"
    return Misplaced(RejectReason.FEW_INLIERS, detail, matches, inliers)


def _refusal(best: Placement, rival_witnesses: int, rules: PlacingRules) -> Misplaced | None:
    """Why a placement is not believed, None when it is."""
    counts = (best.matches, len(best.uv_view))
    spread = np.linalg.svd(best.uv_view - best.uv_view.mean(axis=0), compute_uv=False)
    width_px = float(spread[1]) / np.sqrt(counts[1])
    if best.log10_false_alarms > rules.max_log10_false_alarms:
        return may_be_chance(best)
    if rival_witnesses > MAX_RIVALRY * best.witnesses:
        detail = f"{rival_witnesses} agree on another place, {best.witnesses} on the best"
        return Misplaced(RejectReason.AMBIGUOUS, detail, *counts)
    if width_px < MIN_WIDTH_PX:
        detail = f"the {counts[1]} inliers lie on a line"
        return Misplaced(RejectReason.GEOMETRY, detail, *counts)
    return None
