"""Does the map look alike elsewhere, or turned? Then a registration may be any of the places.

A road with a hedge fits anywhere along itself, a crossing fits turned by a quarter, a runway by a
half. Which of them it is, matches between two dates do not say; the map itself says that it
repeats. Each landmark of a registration is looked for elsewhere: what is nearly as like to it as
the query's feature is could have been matched as well. Where most landmarks have their like at one
and the same shift, the query may be there too.
"""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.types import Array, Features
from vwnav.vision.matching import similarities
from vwnav.vision.significance import occupied_cells

MAX_SAMPLE = 150  # landmarks that are looked for
# Of its likeness to the query, what makes a like of a landmark: the matched are the luckiest.
AS_LIKE = np.float32(0.8)
MIN_SHIFT_PX = 8.0  # what is nearer is the same place
CELL_PX = 4.0  # of the table of shifts, of which 3 x 3 are taken together


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
