"""Registering a query on a piece of map: match, find the consensus, and weigh it.

Of a registration it is asked what fix it is, and whether the map shows the like elsewhere.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.geometry.geodesy import (
    Window,
    horizontal_distance_m,
    lat_lon_from_mercator_px,
    mercator_px_per_m,
)
from vwnav.geometry.homography import transform_points
from vwnav.geometry.pose import MapPose, PoseErrors, pose_from_rectified
from vwnav.geometry.rotations import wrap_pi
from vwnav.maps.image import MapFeatures, MapReader
from vwnav.types import (
    Array,
    FeatureExtractor,
    Features,
    MapFix,
    MatchStats,
    Rejected,
    RejectReason,
)
from vwnav.vision.candidates import MAX_RIVALRY, PRIOR_SIGMAS, Acceptance, Candidate, Hypothesis
from vwnav.vision.consensus import Consensus, SimilarityBounds, find_consensus
from vwnav.vision.correlation import RING_PX, decades_of_correlation, peak_and_rival
from vwnav.vision.matching import match, paired_similarity, share_alike
from vwnav.vision.query import Query, View

MIN_KEYPOINTS = 12
MIN_MATCHES = 8
MIN_WIDTH_PX = 3.0  # inliers on a line slide along it
MAX_STRETCH = 1.25  # what hills and an error of attitude make of a similarity
MAX_STRETCH_UNKNOWN_TILT = 1.6
# Registered again is what had to be turned or scaled by more than the features like.
MAX_TURN_RAD = math.radians(8.0)
MAX_RESCALE = 1.1
SAME_TURN_RAD = math.radians(30.0)  # views turned by more are two places
REFINED = SimilarityBounds(1.12, math.radians(8.0))  # what is left open then
MIN_SIGMA_PX = 0.5
SYSTEMATIC_PX = 0.3  # errors that all matches share, map pixels
SIGMA_LEVEL_RAD = 0.09  # of the tilt where none is known, as odometry has it
SYSTEMATIC_YAW_RAD = math.radians(0.3)
SYSTEMATIC_SCALE = 0.01
SLOPE = 0.1  # one sigma of the ground's: what is seen aside lies higher or lower than the nadir
QUARTERS = (1, 2, 3)  # turns of the map that are tried
MAX_ALIKE = 0.6  # of the landmarks' cells may have their like at one place, or ...
MIN_UNLIKE_CELLS = 6.0  # ... so many must have none there
BESIDE = 2.0  # views around a registration in which its like is looked for
ALONE_DECADES = 2.0  # that a correlation must have to tell a place from what is beside it
Look = Callable[[Candidate], "Registration | Rejected"]


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """A query found on the map.

    Attributes:
        candidate, view: what was registered.
        piece: of the map, that it was registered on.
        consensus: of the matches.
        landmarks: the map's features that carry it, uv as in `consensus.uv_map`.
        likeness: (k,) similarity of each with the query's feature that was matched to it.
        pose: of the point that is reported: below the camera, or the image's centre.
    """

    candidate: Candidate
    view: View
    piece: MapFeatures
    consensus: Consensus
    landmarks: Features
    likeness: NDArray[np.float32]
    pose: MapPose

    def lat_lon_of_view(self, view_uv: Array) -> tuple[float, float]:
        """Of a pixel (2,) of the view."""
        return _lat_lon(self.piece, transform_points(self.consensus.H_map_view, view_uv)[0])

    @property
    def hypothesis(self) -> Hypothesis:
        """The heading and height that were found; hardly anything is left open."""
        assumed = self.candidate.hypothesis
        yaw_rad = wrap_pi(assumed.yaw_rad + self.pose.yaw_correction_rad)
        return Hypothesis(yaw_rad, assumed.agl_m * self.pose.scale_ratio, REFINED)

    @property
    def is_turned(self) -> bool:
        """Whether the view was turned or scaled by more than the features like."""
        scaled = abs(math.log(self.pose.scale_ratio)) > math.log(MAX_RESCALE)
        return scaled or abs(self.pose.yaw_correction_rad) > MAX_TURN_RAD

    def is_place_of(self, other: "Registration") -> bool:
        """Whether both put the image's centre within a tenth of a view, turned alike."""
        place, other_place = (each.lat_lon_of_view(each.view.center_uv) for each in (self, other))
        view = self.view.rectification
        apart_m = horizontal_distance_m(*place, *other_place)
        turn_rad = abs(wrap_pi(self.hypothesis.yaw_rad - other.hypothesis.yaw_rad))
        return bool(
            apart_m <= 0.1 * max(view.size_wh) * view.m_per_px and turn_rad <= SAME_TURN_RAD
        )

    @property
    def window(self) -> Window:
        """The map under the view, global pixels."""
        h, w = self.view.gray.shape
        corners = np.array([[0, 0], [w, 0], [w, h], [0, h]]) - 0.5
        uv = transform_points(self.consensus.H_map_view, corners) + self.piece.origin_px
        low, high = np.floor(uv.min(axis=0)).astype(int), np.ceil(uv.max(axis=0)).astype(int)
        return Window(*low.tolist(), *high.tolist())

    def correlation(self, pack: MapReader, query: Query) -> tuple[float, float]:
        """How far the view's correlation with the map stands out there, and at best beside it."""
        H, (h, w) = self.consensus.H_map_view, self.view.gray.shape
        window = self.window.grown(2)
        # Pixels of the piece of map that the matches refer to start at `origin_px`.
        shift = np.eye(3)
        shift[:2, 2] = self.piece.origin_px - np.array(window[:2])
        gray, data = pack.image(self.candidate.level.zoom, *window)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        on_view = cv2.warpPerspective(gray, shift @ H, (w, h), flags=flags)
        known = cv2.warpPerspective(data.astype(np.uint8), shift @ H, (w, h), flags=flags)
        shown = query.seen(self.view.rectification)
        return peak_and_rival(
            self.view.gray, shown, np.asarray(on_view, np.uint8), np.asarray(known) > 0
        )


def register(
    query: Query, candidate: Candidate, view: View, map_: MapFeatures, accept: Acceptance
) -> Registration | Rejected:
    """Find where on a piece of map a view belongs.

    Args:
        query: what the view was made of.
        candidate: what the view was made for.
        view: with its features.
        map_: features of the piece of map, at the view's resolution.
        accept: what is worth keeping.
    """
    with query.stage("match_ms"):
        pairs = _matches(query, view, map_)
    if isinstance(pairs, Rejected):
        return pairs
    with query.stage("verify_ms"):
        consensus = find_consensus(
            view.features.uv[pairs[:, 0]].astype(np.float64),
            map_.features.uv[pairs[:, 1]].astype(np.float64),
            view.rectification.size_wh,
            candidate.hypothesis.bounds,
            accept.threshold_px,
            MAX_STRETCH if query.attitude_known else MAX_STRETCH_UNKNOWN_TILT,
            query.seed,
        )
        if consensus is None:
            few = RejectReason.FEW_INLIERS
            return query.rejected(few, "no two matches agree", matches=len(pairs))
        refusal = _refusal(query, consensus, accept)
        if refusal is not None:
            return refusal
        pose = _pose(query, view, map_, consensus, accept)
    if pose is None:
        geometry = RejectReason.GEOMETRY
        return query.rejected(geometry, "the matches do not fix a position", matches=len(pairs))
    of_view, of_map = pairs[consensus.inliers].T
    landmarks = map_.features.take(of_map)
    likeness = paired_similarity(view.features.descriptors[of_view], landmarks.descriptors)
    return Registration(candidate, view, map_, consensus, landmarks, likeness, pose)


def _matches(query: Query, view: View, map_: MapFeatures) -> NDArray[np.int64] | Rejected:
    """Pairs (m, 2) of a view's features and those of a piece of map."""
    few = RejectReason.FEW_KEYPOINTS
    shown, mapped = len(view.features.uv), len(map_.features.uv)
    if shown < MIN_KEYPOINTS:
        return query.rejected(few, f"{shown} keypoints in the picture")
    if mapped < MIN_KEYPOINTS:
        return query.rejected(few, f"{mapped} keypoints on the map there")
    pairs = match(view.features, map_.features)
    if len(pairs) < MIN_MATCHES:
        detail = f"{len(pairs)} matches"
        return query.rejected(RejectReason.FEW_MATCHES, detail, matches=len(pairs))
    return pairs


def may_be_chance(query: Query, consensus: Consensus, why: str = "which may be chance") -> Rejected:
    """The refusal of a registration that too little speaks for."""
    matches, inliers = consensus.matches, len(consensus.uv_view)
    detail = f"{inliers} of {matches} matches agree, {why}"
    return query.rejected(RejectReason.FEW_INLIERS, detail, matches=matches, inliers=inliers)


def _refusal(query: Query, consensus: Consensus, accept: Acceptance) -> Rejected | None:
    """Why a consensus is not believed, None when it is."""
    matches, inliers = consensus.matches, len(consensus.uv_view)
    spread = consensus.uv_view - consensus.uv_view.mean(axis=0)
    width_px = float(np.linalg.svd(spread, compute_uv=False)[1]) / np.sqrt(inliers)
    if consensus.log10_nfa > accept.weak_log10_nfa:
        return may_be_chance(query, consensus)
    if consensus.log10_nfa > accept.max_log10_nfa:
        # A few cells have their equals by chance.
        return None if width_px >= MIN_WIDTH_PX else may_be_chance(query, consensus)
    if consensus.rival_cells > MAX_RIVALRY * consensus.cells:
        reason = RejectReason.AMBIGUOUS
        detail = f"{consensus.rival_cells} agree on another place, {consensus.cells} on the best"
    elif width_px < MIN_WIDTH_PX:
        reason, detail = RejectReason.GEOMETRY, f"the {inliers} inliers lie on a line"
    else:
        return None
    return query.rejected(reason, detail, matches=matches, inliers=inliers)


def _lat_lon(map_: MapFeatures, uv: Array) -> tuple[float, float]:
    """Of a pixel (2,) of a piece of map, centre convention."""
    x, y = map_.origin_px + uv + 0.5
    return lat_lon_from_mercator_px(float(x), float(y), map_.zoom)


def _pose(
    query: Query, view: View, map_: MapFeatures, consensus: Consensus, accept: Acceptance
) -> MapPose | None:
    """Pose of the point that is reported: below the camera, or the image's centre."""
    H, made, known = consensus.H_map_view, view.rectification, query.attitude_known
    point_uv = made.nadir_uv if known else view.center_uv
    mapped = transform_points(H, np.vstack([point_uv, consensus.uv_view]))
    lat_deg, _ = _lat_lon(map_, mapped[0])
    scatter_px = math.sqrt(float(np.mean((mapped[1:] - consensus.uv_map) ** 2)))
    # Neighbours err alike: only as many are independent as there are cells with an inlier.
    repeats = len(consensus.uv_view) / consensus.cells
    tilt_rad = accept.sigma_tilt_rad
    errors = PoseErrors(
        sigma_px=max(MIN_SIGMA_PX, scatter_px) * math.sqrt(repeats),
        sigma_tilt_rad=tilt_rad if known else 0.0,
        sigma_lean_rad=tilt_rad if known else SIGMA_LEVEL_RAD,
        sigma_georeference_m=math.hypot(accept.sigma_georeference_m, SYSTEMATIC_PX * made.m_per_px),
    )
    return pose_from_rectified(
        H,
        replace(made, nadir_uv=point_uv),
        consensus.uv_view,
        consensus.uv_map,
        mercator_px_per_m(lat_deg, map_.zoom),
        errors,
    )


def fix_of(query: Query, found: Registration) -> MapFix:
    """The fix that a registration is."""
    pose, consensus, made = found.pose, found.consensus, found.view.rectification
    lat_deg, lon_deg = _lat_lon(found.piece, pose.nadir_px)
    aside_px = math.dist(found.view.center_uv, made.nadir_uv) if query.attitude_known else 0.0
    rough_m = math.hypot(SYSTEMATIC_SCALE * pose.agl_m, SLOPE * aside_px * made.m_per_px)
    return MapFix(
        t_s=query.t_s,
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        covariance_ne_m2=pose.covariance_ne_m2,
        yaw_rad=found.hypothesis.yaw_rad,
        sigma_yaw_rad=math.hypot(pose.sigma_yaw_rad, SYSTEMATIC_YAW_RAD),
        agl_m=pose.agl_m,
        sigma_agl_m=math.hypot(pose.sigma_agl_m, rough_m),
        point="nadir" if query.attitude_known else "center",
        features=query.features,
        stats=MatchStats(
            keypoints=len(found.view.features.uv),
            matches=consensus.matches,
            inliers=len(consensus.uv_view),
        ),
    )


def ambiguous(
    pack: MapReader, extractor: FeatureExtractor, query: Query, found: Registration
) -> Rejected | None:
    """A refusal where the map shows the like at other places, or turned, that are open too."""
    looks = {"beside it": partial(_share_beside, pack, extractor, query, found)}
    if query.heading_open:
        looks["turned by a quarter or a half"] = partial(_share_turned, pack, extractor, found)
    # A part of the image tells places less apart: twice as many must be unlike.
    cells = found.consensus.cells // (1 + found.candidate.thrifty)
    matches, inliers = found.consensus.matches, len(found.consensus.uv_view)
    for where, look in looks.items():
        share = look()
        if share > MAX_ALIKE and (1.0 - share) * cells < MIN_UNLIKE_CELLS:
            detail = f"{share:.0%} of what was seen is {where} too"
            return query.rejected(RejectReason.AMBIGUOUS, detail, matches=matches, inliers=inliers)
    return None


def fits_turned(query: Query, found: Registration, look: Look) -> Rejected | None:
    """A refusal where the image shows nearly as much put on the map turned as it was found.

    Of another day than the map's it may be as like both ends of a runway, and they less each other.
    """
    view, assumed, cells = found.view.rectification, found.hypothesis, [0]
    lat_deg, lon_deg = found.lat_lon_of_view(view.nadir_uv)
    around_m = max(view.size_wh) * view.m_per_px
    there = replace(found.candidate, lat_deg=lat_deg, lon_deg=lon_deg, radius_m=around_m)
    for quarter in QUARTERS:
        yaw_rad = wrap_pi(assumed.yaw_rad + quarter * math.pi / 2.0)
        rival = look(replace(there, hypothesis=replace(assumed, yaw_rad=yaw_rad)))
        if isinstance(rival, Registration):
            cells.append(rival.consensus.cells)
    share = max(cells) / found.consensus.cells
    if share < MAX_RIVALRY:
        return None
    detail = f"{min(share, 1.0):.0%} of what was seen is turned by a quarter or a half too"
    matches, inliers = found.consensus.matches, len(found.consensus.uv_view)
    return query.rejected(RejectReason.AMBIGUOUS, detail, matches=matches, inliers=inliers)


def _share_beside(
    pack: MapReader, extractor: FeatureExtractor, query: Query, found: Registration
) -> float:
    """Share of the landmarks' cells that the map shows again beside them, where the prior reaches.

    Without a place in the prior that is some views around. Landmarks see far: what is some dozen
    pixels off is like them anywhere, and counts where the image correlates there nearly as well.
    """
    landmarks, there = found.landmarks, found.piece.features
    reach_m = PRIOR_SIGMAS * query.prior.sigma_m if query.prior.lat_deg is not None else math.inf
    within_px = 2.0 * reach_m / found.view.rectification.m_per_px
    if found.candidate.radius_m < reach_m:  # else what was searched is all that is open
        window = found.window.grown(math.ceil(BESIDE * max(found.window.shape)))
        around = pack.features_in(found.candidate.level.zoom, *window, extractor)
        moved = landmarks.uv + (found.piece.origin_px - around.origin_px).astype(np.float32)
        landmarks, there = replace(landmarks, uv=moved), around.features
    share = share_alike(landmarks, found.likeness, there, within_px)
    peak, rival = found.correlation(pack, query) if share > MAX_ALIKE else (0.0, math.inf)
    alone = rival <= MAX_RIVALRY * peak and decades_of_correlation(peak) >= ALONE_DECADES
    return share_alike(landmarks, found.likeness, there, within_px, RING_PX[1]) if alone else share


def _share_turned(pack: MapReader, extractor: FeatureExtractor, found: Registration) -> float:
    """As `_share_beside`, of the map under and around the view turned by one to three quarters."""
    window, zoom = found.window.grown(max(found.window.shape)), found.candidate.level.zoom
    keypoints = len(pack.features_in(zoom, *window, extractor).features)
    gray, _ = pack.image(zoom, *window)
    turned = (np.ascontiguousarray(np.rot90(gray, quarters)) for quarters in QUARTERS)
    others = (extractor.extract(each, keypoints) for each in turned)
    return max(share_alike(found.landmarks, found.likeness, each) for each in others)
