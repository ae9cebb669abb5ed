"""The truth of a registered pair, checked without features: blocks of both images correlate.

Labels made from a few marked points are off by pixels, and what stands on the ground leans. Blocks
of edges say by how much, here and there: an affinity through them corrects the label, and their
spread about it is the label's own error.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.bench.features.scenes import Mask, look_at
from vwnav.types import Array, Gray

UNCONFIRMED_PX = 3.0  # one sigma per axis where too few blocks correlate
LEAST_PX = 0.3
_BLOCK_PX, _STEP_PX, _REACH_PX = 96, 40, 20
_MIN_PEAK, _MAX_RIVAL = 0.25, 0.85  # of correlation; another peak of it, as a share
_RIVAL_PX = 6  # further off than this it is another peak
_AGREE_PX = 4.0
_LEAST_BLOCKS, _LEAST_SHARE = 8, 0.5


def corrected(a: Gray, mask_a: Mask, b: Gray, mask_b: Mask, H_b_a: Array) -> tuple[Array, float]:
    """The homography b from a as the images correlate, and one sigma per axis, pixels of b."""
    h, w = b.shape
    warped, seen = look_at(a, mask_a, np.asarray(np.linalg.inv(H_b_a)), (w, h))
    labelled, found = _blocks(_edges(warped), _edges(b), seen & mask_b)
    if len(labelled) < _LEAST_BLOCKS:
        return H_b_a, UNCONFIRMED_PX
    affine, inliers = cv2.estimateAffine2D(labelled, found, ransacReprojThreshold=_AGREE_PX)
    near = np.asarray(inliers).ravel() > 0
    if affine is None or near.sum() < max(_LEAST_BLOCKS, _LEAST_SHARE * len(labelled)):
        return H_b_a, UNCONFIRMED_PX
    error = labelled[near] @ affine[:, :2].T + affine[:, 2] - found[near]
    moved = np.vstack([affine, [0.0, 0.0, 1.0]])
    return moved @ H_b_a, max(LEAST_PX, float(np.sqrt(np.mean(error**2))))


def _edges(gray: Gray) -> NDArray[np.float32]:
    """Strength of edges, whatever their sign: light and season turn it."""
    smooth = cv2.GaussianBlur(gray, (0, 0), 1.5).astype(np.float32)
    du, dv = (cv2.Sobel(smooth, cv2.CV_32F, *order) for order in ((1, 0), (0, 1)))
    return np.asarray(np.sqrt(cv2.magnitude(du, dv)), np.float32)


def _blocks(
    a: NDArray[np.float32], b: NDArray[np.float32], known: Mask
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Middles of blocks of a (n, 2), and where b shows them."""
    h, w = a.shape
    labelled, found = [], []
    for top in range(_REACH_PX, h - _BLOCK_PX - _REACH_PX, _STEP_PX):
        for left in range(_REACH_PX, w - _BLOCK_PX - _REACH_PX, _STEP_PX):
            around = (
                slice(top - _REACH_PX, top + _BLOCK_PX + _REACH_PX),
                slice(left - _REACH_PX, left + _BLOCK_PX + _REACH_PX),
            )
            if not known[around].all():
                continue
            block = a[top : top + _BLOCK_PX, left : left + _BLOCK_PX]
            found_at = cv2.matchTemplate(b[around], block, cv2.TM_CCOEFF_NORMED)
            shift = _peak(np.asarray(found_at, np.float32))
            if shift is not None:
                middle = np.array([left, top]) + (_BLOCK_PX - 1) / 2.0
                labelled.append(middle)
                found.append(middle + shift)
    return np.array(labelled, np.float32), np.array(found, np.float32)


def _peak(correlation: NDArray[np.float32]) -> Array | None:
    """Shift (2,) of the one peak that stands out, to a fraction of a pixel; else None."""
    row, column = np.unravel_index(int(correlation.argmax()), correlation.shape)
    best, last = float(correlation[row, column]), 2 * _REACH_PX
    if best < _MIN_PEAK or not (0 < row < last and 0 < column < last):
        return None
    others = correlation.copy()
    others[
        max(row - _RIVAL_PX, 0) : row + _RIVAL_PX + 1,
        max(column - _RIVAL_PX, 0) : column + _RIVAL_PX + 1,
    ] = -1.0
    if float(others.max()) > _MAX_RIVAL * best:
        return None
    # The vertex of a parabola through the peak and its neighbours, along each axis.
    shift = []
    for low, high, at in (
        (correlation[row, column - 1], correlation[row, column + 1], column),
        (correlation[row - 1, column], correlation[row + 1, column], row),
    ):
        bend = float(low) - 2.0 * best + float(high)
        shift.append(at - _REACH_PX + (0.5 * (float(low) - float(high)) / bend if bend else 0.0))
    return np.array(shift)
