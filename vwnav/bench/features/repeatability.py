"""Do keypoints of two images lie at the same places, and more often than by chance?"""

from dataclasses import dataclass

import numpy as np

from vwnav.bench.features.scenes import EDGE_PX, ReferenceMap
from vwnav.geometry.homography import transform_points
from vwnav.types import Array, Features

KEYPOINTS = 1000  # many keypoints meet others by chance: the budget belongs to the number
REPEATED_PX = 3.0
SHIFTS_PX = (20.0, 30.0, 40.0)  # far enough that a keypoint meets only strangers
_WAYS = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])


@dataclass(frozen=True, slots=True)
class Repeatability:
    """Shares of the keypoints that the map shows too.

    Attributes:
        repeated: the map has a keypoint within 3 px.
        by_chance: the same after all of them were shifted by 20 to 40 px, mean over ways to do so.
    """

    repeated: float
    by_chance: float

    @property
    def above_chance(self) -> float:
        """What the keypoints know about the ground."""
        return self.repeated - self.by_chance


def repeatability(
    found: Features, reference: Features, H_1_0: Array, map_: ReferenceMap
) -> Repeatability | None:
    """Compare the keypoints of an image with those of its map.

    Returns:
        None where no keypoint of the image lies in the map, or the map has none.
    """
    if len(found) == 0 or len(reference) == 0:
        return None
    carried = transform_points(H_1_0, found.uv.astype(np.float64))
    uv1 = reference.uv.astype(np.float64)
    reach = max(SHIFTS_PX) + REPEATED_PX
    near = (uv1 >= carried.min(axis=0) - reach) & (uv1 <= carried.max(axis=0) + reach)
    uv1 = uv1[near.all(axis=1)]  # a map may be far larger than what the image shows
    if len(uv1) == 0:
        return None
    repeated = _share_met(carried, uv1, map_)
    shifts = [way * px for px in SHIFTS_PX for way in _WAYS]
    chances = [_share_met(carried + shift, uv1, map_) for shift in shifts]
    known = [chance for chance in chances if chance is not None]
    if repeated is None or not known:
        return None
    return Repeatability(repeated, float(np.mean(known)))


def _share_met(places: Array, uv1: Array, map_: ReferenceMap) -> float | None:
    """Share of the places that the map shows which have a keypoint of it near them."""
    h, w = map_.gray.shape
    column, row = np.round(places).astype(np.int64).T
    shown = (column >= EDGE_PX) & (column < w - EDGE_PX) & (row >= EDGE_PX) & (row < h - EDGE_PX)
    shown[shown] = map_.mask[row[shown], column[shown]]
    if not shown.any():
        return None
    apart = np.linalg.norm(places[shown, None] - uv1[None], axis=2).min(axis=1)
    return float((apart < REPEATED_PX).mean())
