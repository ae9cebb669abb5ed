"""What views of the board have shown so far, and what is missing still, in words."""

import math
from collections.abc import Iterator

import cv2
import numpy as np

from vwnav.calibration.board import COLUMNS, ROWS, BoardView
from vwnav.types import Array

GRID_COLUMNS, GRID_ROWS = 5, 4  # cells of the image, each of which wants a corner
ENOUGH_VIEWS = 20
ENOUGH_COVERED = 0.9  # of the cells
TILT_RAD = math.radians(15.0)  # a view leans to a side when it leans by this much
VIEWS_A_SIDE = 2
MOST_VIEWS = 60
NEW_SHARE = 0.06  # of the image's width: the board's outline has moved by so much
_ACROSS = ("left", "", "right")
_DOWN = ("upper", "", "lower")
_SIDES = {(0, 1): "right", (0, -1): "left", (1, 1): "lower", (1, -1): "upper"}


class Coverage:
    """The different views of one camera.

    Attributes:
        views: those that were kept, each unlike the others.
    """

    def __init__(self, size_wh: tuple[int, int]) -> None:
        self.views: list[BoardView] = []
        self._size_wh = size_wh
        self._outlines: list[Array] = []
        self._seen = np.zeros((GRID_ROWS, GRID_COLUMNS), bool)
        self._leaning: list[tuple[float, float]] = []

    def add(self, view: BoardView) -> bool:
        """Keep a view, if it shows something that no other does."""
        outline = _outline(view) / self._size_wh[0]
        near = any(float(np.abs(outline - each).max()) < NEW_SHARE for each in self._outlines)
        if near or len(self.views) >= MOST_VIEWS:
            return False
        self.views.append(view)
        self._outlines.append(outline)
        cells = view.uv / self._size_wh * (GRID_COLUMNS, GRID_ROWS)
        column, row = np.floor(cells).astype(int).T
        inside = (column >= 0) & (column < GRID_COLUMNS) & (row >= 0) & (row < GRID_ROWS)
        self._seen[row[inside], column[inside]] = True
        self._leaning.append(_leaning(view, self._size_wh))
        return True

    @property
    def covered(self) -> float:
        """Share of the image's cells in which a corner has been."""
        return float(np.mean(self._seen))

    @property
    def most_leaning(self) -> float:
        """How far the board leaned at most in a view, in radians."""
        return max((math.hypot(*each) for each in self._leaning), default=0.0)

    def missing(self) -> list[str]:
        """What is to be shown still, the most important first; empty when it is enough."""
        wanted = [*self._places(), *self._tilts()]
        if len(self.views) < ENOUGH_VIEWS:
            wanted.append(f"{ENOUGH_VIEWS - len(self.views)} more views, nearer and farther")
        return wanted

    def _places(self) -> Iterator[str]:
        if self.covered >= ENOUGH_COVERED:
            return
        empty = np.argwhere(~self._seen)
        middle = (np.array([GRID_ROWS, GRID_COLUMNS]) - 1.0) / 2.0
        row, column = empty[int(np.argmax(np.abs(empty - middle).sum(axis=1)))]
        down = _DOWN[0 if row == 0 else 2 if row == GRID_ROWS - 1 else 1]
        across = _ACROSS[0 if column == 0 else 2 if column == GRID_COLUMNS - 1 else 1]
        place = " ".join(word for word in (down, across) if word)
        kind = "corner" if down and across else "edge" if place else "middle"
        yield f"the board in the {place + ' ' if place else ''}{kind} of the picture"

    def _tilts(self) -> Iterator[str]:
        for (axis, sign), side in _SIDES.items():
            count = sum(sign * each[axis] > TILT_RAD for each in self._leaning)
            if count < VIEWS_A_SIDE:
                yield f"the board tilted, its {side} edge nearer"


def _homography(view: BoardView) -> Array:
    """(3, 3) from the board, in squares, to pixels."""
    H, _ = cv2.findHomography(view.places[:, :2], view.uv)
    return np.asarray(H, np.float64)


def _outline(view: BoardView) -> Array:
    """(4, 2) pixels of the board's corners, those outside of the image too."""
    corners = np.array([[0.0, 0.0], [COLUMNS, 0.0], [COLUMNS, ROWS], [0.0, ROWS]])
    return np.asarray(cv2.perspectiveTransform(corners[None], _homography(view))[0])


def _leaning(view: BoardView, size_wh: tuple[int, int]) -> tuple[float, float]:
    """By how much its right and its lower edge are nearer, in radians; a lens of 65 degrees."""
    f_px = 0.8 * size_wh[0]
    K = np.array([[f_px, 0.0, size_wh[0] / 2.0], [0.0, f_px, size_wh[1] / 2.0], [0.0, 0.0, 1.0]])
    good, turn, _ = cv2.solvePnP(view.places, view.uv, K, None)
    if not good:
        return 0.0, 0.0
    normal = np.asarray(cv2.Rodrigues(turn)[0])[:, 2]
    normal = normal if normal[2] > 0.0 else -normal
    # The plane's depth along the ray (x, y, 1) goes with one over normal @ (x, y, 1).
    return math.atan2(normal[0], normal[2]), math.atan2(normal[1], normal[2])
