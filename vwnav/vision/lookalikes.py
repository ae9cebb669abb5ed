"""Does the map look alike elsewhere, or turned? Then a registration may be any of the places.

A road with a hedge fits anywhere along itself, a crossing fits turned by a quarter, a runway by a
half. Which of them it is, matches between two dates do not say; the map itself says that it
repeats. Each landmark of a registration is looked for elsewhere: what is nearly as like to it as
the query's feature is could have been matched as well. Where most landmarks have their like at one
and the same shift, the query may be there too.
"""

import math
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.maps.pack import MapPack
from vwnav.types import Array, FeatureExtractor, Features
from vwnav.vision.candidates import PRIOR_SIGMAS
from vwnav.vision.matching import similarities
from vwnav.vision.query import Query
from vwnav.vision.registration import Registration
from vwnav.vision.significance import occupied_cells

QUARTERS = (1, 2, 3)  # turns of the map that are tried
BESIDE = 2.0  # views around a registration in which its like is looked for
MAX_SAMPLE = 150  # landmarks that are looked for
# Of its likeness to the query, what makes a like of a landmark: the matched are the luckiest.
AS_LIKE = np.float32(0.8)
MIN_SHIFT_PX = 8.0  # what is nearer is the same place
CELL_PX = 4.0  # of the table of shifts, of which 3 x 3 are taken together


def share_beside(
    pack: MapPack, extractor: FeatureExtractor, query: Query, found: Registration
) -> float:
    """Share of the landmarks' cells that the map shows again beside them, where the prior reaches.

    Without a place in the prior that is some views around.
    """
    reach_m = PRIOR_SIGMAS * query.prior.sigma_m
    if query.prior.lat_deg is not None and found.candidate.radius_m >= reach_m:
        # What was searched is all that the prior leaves open.
        return share_alike(found.landmarks, found.likeness, found.piece.features)
    window = found.window.grown(math.ceil(BESIDE * max(found.window.shape)))
    around = pack.features_in(found.candidate.level.zoom, *window, extractor)
    moved = found.landmarks.uv + (found.piece.origin_px - around.origin_px).astype(np.float32)
    landmarks = replace(found.landmarks, uv=moved)
    within_px = math.inf
    if query.prior.lat_deg is not None:
        within_px = 2.0 * reach_m / found.view.rectification.m_per_px
    return share_alike(landmarks, found.likeness, around.features, within_px)


def share_turned(pack: MapPack, extractor: FeatureExtractor, found: Registration) -> float:
    """The same of the map under and around the view, turned by one, two and three quarters."""
    window, zoom = found.window.grown(max(found.window.shape)), found.candidate.level.zoom
    keypoints = len(pack.features_in(zoom, *window, extractor).features)
    gray, _ = pack.image(zoom, *window)
    turned = (np.ascontiguousarray(np.rot90(gray, quarters)) for quarters in QUARTERS)
    others = (extractor.extract(each, keypoints) for each in turned)
    return max(share_alike(found.landmarks, found.likeness, each) for each in others)


def share_alike(
    landmarks: Features,
    likeness: NDArray[np.float32],
    others: Features,
    within_px: float = math.inf,
) -> float:
    """Share of the cells with landmarks whose like lies at one shift, the best there is.

    Args:
        landmarks: map features that carry a registration.
        likeness: (k,) similarity of each with the query's feature that was matched to it.
        others: features of the map, their pixels those of the landmarks but for a shift.
        within_px: a longer shift does not count.
    """
    step = math.ceil(len(landmarks) / MAX_SAMPLE)
    uv, onto = landmarks.uv[::step], others.uv
    if len(others) == 0:
        return 0.0
    alike = similarities(landmarks.descriptors[::step], others.descriptors)
    # Of some kinds of features unrelated ones are alike by half: what counts is more than that.
    unrelated = np.median(alike, axis=1)
    least = unrelated + AS_LIKE * (likeness[::step] - unrelated)
    owners, twins = np.nonzero(alike >= least[:, None])
    shifts = (onto[twins] - uv[owners]).astype(np.float64)
    length_px = np.linalg.norm(shifts, axis=1)
    counted = (length_px > MIN_SHIFT_PX) & (length_px <= within_px)
    shifts, owners = shifts[counted], owners[counted]
    if len(shifts) == 0:
        return 0.0
    best = _peak(shifts)
    at_best = np.abs(shifts - best).max(axis=1) <= 1.5 * CELL_PX
    agreeing = uv[np.unique(owners[at_best])].astype(np.float64)
    return occupied_cells(agreeing) / occupied_cells(uv.astype(np.float64))


def _peak(shifts: Array) -> Array:
    """The shift (2,) that most agree upon."""
    origin = shifts.min(axis=0)
    column, row = ((shifts - origin) / CELL_PX).astype(np.int64).T
    shape = (int(row.max()) + 1, int(column.max()) + 1)
    table = np.bincount(row * shape[1] + column, minlength=shape[0] * shape[1]).reshape(shape)
    # 3 x 3 sums, so that a peak on a cell's edge is not split.
    summed = cv2.boxFilter(
        table.astype(np.float32), -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT
    )
    v, u = np.unravel_index(int(np.argmax(summed)), shape)
    return np.asarray(origin + CELL_PX * (np.array([u, v]) + 0.5))
