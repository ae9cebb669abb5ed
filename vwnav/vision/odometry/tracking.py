"""Corners, and where they went: pyramidal Lucas-Kanade with a check backwards.

Dense flow and matching of ORB, SIFT or learned features between the same images are slower and no
more exact (docs/estimation.md has the table).
"""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.geometry.camera import to_gray
from vwnav.types import Gray

Points = NDArray[np.float32]
BoolArray = NDArray[np.bool_]
_WINDOW_PX = 15
_LEVELS = 3
_FORTH_AND_BACK_PX = 0.7
_STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 0.02)
_LEAST_RESPONSE = 2e-5  # smaller eigenvalue of the gradients, gray from 0 to 1: above sensor noise


def reduction(width_px: int, widest_px: int) -> int:
    """The whole number by which images are shrunk so that they are at most `widest_px` wide."""
    return max(1, math.ceil(width_px / widest_px))


def reduced_gray(image: NDArray[np.uint8], factor: int) -> Gray:
    """Gray image shrunk by a whole number; what does not fill a pixel at the end is cut off.

    Args:
        image: (h, w) gray or (h, w, 3) BGR.
        factor: from `reduction`.
    """
    gray = image if image.ndim == 2 else to_gray(image)
    if factor == 1:
        return np.ascontiguousarray(gray, dtype=np.uint8)
    height, width = gray.shape[0] // factor, gray.shape[1] // factor
    cut = gray[: height * factor, : width * factor]
    return np.asarray(cv2.resize(cut, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


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


def track(gray0: Gray, gray1: Gray, uv0: Points, guess_uv1: Points) -> tuple[Points, BoolArray]:
    """Follow points from image 0 to image 1.

    Args:
        gray0: image 0.
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
