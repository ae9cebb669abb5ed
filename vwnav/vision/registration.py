"""Registering a query on a piece of map: match, find the consensus, and weigh it."""

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.geometry.geodesy import (
    horizontal_distance_m,
    lat_lon_from_mercator_px,
    mercator_px_per_m,
)
from vwnav.geometry.homography import transform_points
from vwnav.geometry.pose import MapPose, PoseErrors, pose_from_rectified
from vwnav.geometry.rotations import wrap_pi
from vwnav.maps.pack import MapPack
from vwnav.maps.picture import MapFeatures, Window
from vwnav.types import Array, Features, Rejected, RejectReason
from vwnav.vision.candidates import Candidate, Hypothesis
from vwnav.vision.consensus import Consensus, SimilarityBounds, find_consensus
from vwnav.vision.correlation import peak_sigmas
from vwnav.vision.features.checks import take
from vwnav.vision.matching import match, similarities
from vwnav.vision.query import Query, View, seen

MIN_KEYPOINTS = 12
MIN_MATCHES = 8
MAX_RIVALRY = 0.7  # of the best place's occupied cells for another place: neither is believed
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Acceptance:
    """What makes a registration worth keeping, and the errors behind its pose.

    Attributes:
        threshold_px: largest error of an inlier, map pixels.
        max_log10_nfa: expected chance agreements, log10.
        sigma_tilt_rad: of roll and pitch, when they are known.
        sigma_georeference_m: of the map, per axis.
    """

    threshold_px: float
    max_log10_nfa: float
    sigma_tilt_rad: float
    sigma_georeference_m: float


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

    def lat_lon(self, map_uv: Array) -> tuple[float, float]:
        """Of a pixel (2,) of the piece of map, centre convention."""
        x, y = self.piece.origin_px + map_uv + 0.5
        return lat_lon_from_mercator_px(float(x), float(y), self.candidate.level.zoom)

    def lat_lon_of_view(self, view_uv: Array) -> tuple[float, float]:
        """Of a pixel (2,) of the view."""
        return self.lat_lon(transform_points(self.consensus.H_map_view, view_uv)[0])

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

    def correlation_sigmas(self, pack: MapPack, query: Query) -> float:
        """How far the view's correlation with the map there stands above that beside it."""
        H, (h, w) = self.consensus.H_map_view, self.view.gray.shape
        window = self.window.grown(2)
        # Pixels of the piece of map that the matches refer to start at `origin_px`.
        shift = np.eye(3)
        shift[:2, 2] = self.piece.origin_px - np.array(window[:2])
        gray, data = pack.image(self.candidate.level.zoom, *window)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        on_view = cv2.warpPerspective(gray, shift @ H, (w, h), flags=flags)
        known = cv2.warpPerspective(data.astype(np.uint8), shift @ H, (w, h), flags=flags)
        shown = seen(query, self.view.rectification)
        return peak_sigmas(
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
        refusal = _refusal(query, consensus, accept.max_log10_nfa)
        if refusal is not None:
            return refusal
        origin_px = map_.origin_px.astype(np.float64)
        pose = _pose(query, candidate, view, origin_px, consensus, accept)
    if pose is None:
        geometry = RejectReason.GEOMETRY
        return query.rejected(geometry, "the matches do not fix a position", matches=len(pairs))
    matched, landmarks = (
        take(features, pairs[consensus.inliers, i])
        for i, features in enumerate((view.features, map_.features))
    )
    likeness = similarities(matched.descriptors, landmarks.descriptors).diagonal()
    return Registration(candidate, view, map_, consensus, landmarks, likeness, pose)


def _matches(query: Query, view: View, map_: MapFeatures) -> NDArray[np.int64] | Rejected:
    """Pairs (m, 2) of a view's features and those of a piece of map."""
    few = RejectReason.FEW_KEYPOINTS
    if len(view.features) < MIN_KEYPOINTS:
        return query.rejected(few, f"{len(view.features)} keypoints in the picture")
    if len(map_.features) < MIN_KEYPOINTS:
        return query.rejected(few, f"{len(map_.features)} keypoints on the map there")
    pairs = match(view.features, map_.features)
    if len(pairs) < MIN_MATCHES:
        detail = f"{len(pairs)} matches"
        return query.rejected(RejectReason.FEW_MATCHES, detail, matches=len(pairs))
    return pairs


def may_be_chance(query: Query, consensus: Consensus) -> Rejected:
    """The refusal of a registration that too little speaks for."""
    matches, inliers = consensus.matches, len(consensus.uv_view)
    detail = f"{inliers} of {matches} matches agree, which may be chance"
    return query.rejected(RejectReason.FEW_INLIERS, detail, matches=matches, inliers=inliers)


def _refusal(query: Query, consensus: Consensus, max_log10_nfa: float) -> Rejected | None:
    """Why a consensus is not believed, None when it is."""
    matches, inliers = consensus.matches, len(consensus.uv_view)
    spread = consensus.uv_view - consensus.uv_view.mean(axis=0)
    width_px = float(np.linalg.svd(spread, compute_uv=False)[1]) / np.sqrt(inliers)
    if consensus.log10_nfa > max_log10_nfa:
        return may_be_chance(query, consensus)
    if consensus.rival_cells > MAX_RIVALRY * consensus.cells:
        reason = RejectReason.AMBIGUOUS
        detail = f"{consensus.rival_cells} agree on another place, {consensus.cells} on the best"
    elif width_px < MIN_WIDTH_PX:
        reason, detail = RejectReason.GEOMETRY, f"the {inliers} inliers lie on a line"
    else:
        return None
    return query.rejected(reason, detail, matches=matches, inliers=inliers)


def _pose(
    query: Query,
    candidate: Candidate,
    view: View,
    origin_px: Array,
    consensus: Consensus,
    accept: Acceptance,
) -> MapPose | None:
    """Pose of the point that is reported: below the camera, or the image's centre."""
    H, made, known = consensus.H_map_view, view.rectification, query.attitude_known
    point_uv = made.nadir_uv if known else view.center_uv
    x, y = origin_px + transform_points(H, point_uv)[0] + 0.5
    lat_deg, _ = lat_lon_from_mercator_px(float(x), float(y), candidate.level.zoom)
    error = transform_points(H, consensus.uv_view) - consensus.uv_map
    scatter_px = max(MIN_SIGMA_PX, math.sqrt(float(np.mean(error**2))))
    # Neighbours err alike: only as many are independent as there are cells with an inlier.
    repeats = len(consensus.uv_view) / consensus.cells
    tilt_rad = accept.sigma_tilt_rad
    errors = PoseErrors(
        sigma_px=scatter_px * math.sqrt(repeats),
        sigma_tilt_rad=tilt_rad if known else 0.0,
        sigma_lean_rad=tilt_rad if known else SIGMA_LEVEL_RAD,
        sigma_georeference_m=math.hypot(accept.sigma_georeference_m, SYSTEMATIC_PX * made.m_per_px),
    )
    return pose_from_rectified(
        H,
        replace(made, nadir_uv=point_uv),
        consensus.uv_view,
        consensus.uv_map,
        mercator_px_per_m(lat_deg, candidate.level.zoom),
        errors,
    )
