"""Black and white collars: what surrounds a mosaic whose file declares no missing data."""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.geometry.geodesy import Window
from vwnav.maps.image import MapImage, Mask

_CELL_PX = 4
_STRIP_PX = 512  # a multiple of the cell
_BLACK_MAX = 3  # JPEG makes its zeros a little noisy
_WHITE_MIN = 253


@dataclass(frozen=True, slots=True, eq=False)
class Collar:
    """Where a raster's black or white border regions lie, in cells of 4 px.

    Attributes:
        black, white: (rows, columns) bool.
    """

    black: Mask
    white: Mask

    def at(self, bgr: NDArray[np.uint8], window: Window) -> Mask:
        """Which pixels (h, w) of a window of the raster belong to the collar."""
        rows = np.arange(window.y0, window.y1) // _CELL_PX
        columns = np.arange(window.x0, window.x1) // _CELL_PX
        cells = np.ix_(rows, columns)
        black, white = _extremes(bgr)
        return np.asarray((black & self.black[cells]) | (white & self.white[cells]))


def find_collar(read: Callable[[Window], MapImage], size_wh: tuple[int, int]) -> Collar | None:
    """Find what is black or white and hangs together with the raster's edge.

    Dark water and shadows inside of the image stay: they do not reach the edge.

    Args:
        read: gives the image of a window of the raster.
        size_wh: of the raster in pixels.

    Returns:
        None when there is none.
    """
    w, h = size_wh
    strips = []
    for y0 in range(0, h, _STRIP_PX):
        bgr = read(Window(0, y0, w, min(y0 + _STRIP_PX, h))).bgr
        strips.append([_full_cells(extreme) for extreme in _extremes(bgr)])
    black, white = (_reaching_edge(np.concatenate(parts)) for parts in zip(*strips, strict=True))
    return Collar(black, white) if black.any() or white.any() else None


def _extremes(bgr: NDArray[np.uint8]) -> tuple[Mask, Mask]:
    black = cv2.inRange(bgr, (0, 0, 0), (_BLACK_MAX,) * 3)
    white = cv2.inRange(bgr, (_WHITE_MIN,) * 3, (255, 255, 255))
    return black > 0, white > 0


def _full_cells(extreme: Mask) -> Mask:
    """Cells (rows, columns) all of whose pixels are set; those at the far edges may be smaller."""
    h, w = extreme.shape
    padded = np.pad(extreme, ((0, -h % _CELL_PX), (0, -w % _CELL_PX)), constant_values=True)
    rows, columns = padded.shape[0] // _CELL_PX, padded.shape[1] // _CELL_PX
    return np.asarray(padded.reshape(rows, _CELL_PX, columns, _CELL_PX).all(axis=(1, 3)))


def _reaching_edge(cells: Mask) -> Mask:
    """The connected regions that touch the raster's edge, and the cells next to them."""
    _, labels = cv2.connectedComponents(cells.astype(np.uint8), connectivity=8)
    edge = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
    reaching = np.isin(labels, np.unique(edge[edge > 0]))
    grown = cv2.dilate(reaching.astype(np.uint8), np.ones((3, 3), np.uint8))
    return np.asarray(grown > 0)
