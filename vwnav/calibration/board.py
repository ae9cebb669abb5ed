"""The ChArUco board: its drawing to scale, and its corners in an image.

One layout on every paper, so that an image need not say which paper it shows: how large the
squares are is nothing that a lens can tell.
"""

import io
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from vwnav.errors import CalibrationError
from vwnav.files.whole import write_whole
from vwnav.types import Array, Gray

COLUMNS, ROWS = 7, 10  # squares
MARKER_SHARE = 0.7  # of a square's side
LEAST_CORNERS = 12  # of the 54: fewer hardly tell how the board lies
_PX_PER_MM = 20
_DPI = 25.4 * _PX_PER_MM
_BAR_MM = 100
_TITLE = "vwnav calibration board"  # in UTF-16 in the PDF


@dataclass(frozen=True, slots=True)
class Paper:
    """A sheet: its size, and the side of the squares that it carries."""

    width_mm: int
    height_mm: int
    square_mm: int


PAPERS = {"a4": Paper(210, 297, 25), "a3": Paper(297, 420, 36)}


@dataclass(frozen=True, slots=True, eq=False)
class BoardView:
    """The board's corners that an image shows.

    Attributes:
        ids: (n,) which of the corners, row by row from 0.
        uv: (n, 2) their pixels, centres at integers.
    """

    ids: NDArray[np.int64]
    uv: Array

    @property
    def places(self) -> Array:
        """(n, 3) of the corners on the board, in squares, z = 0."""
        columns = COLUMNS - 1
        return np.column_stack(
            [self.ids % columns + 1.0, self.ids // columns + 1.0, np.zeros(len(self.ids))]
        )


def write_board(path: Path, paper: str) -> Paper:
    """Draw the board as a PDF of one page, to scale; over nothing but another board.

    Raises:
        CalibrationError: an unknown paper, or the file cannot be written.
    """
    if paper not in PAPERS:
        raise CalibrationError(f"no paper {paper!r}: {' or '.join(PAPERS)}")
    if path.suffix.lower() != ".pdf":
        raise CalibrationError(f"{path}: the board is written as PDF; call it {path.stem}.pdf")
    sheet, drawn = PAPERS[paper], io.BytesIO()
    _page(sheet, paper).save(drawn, "PDF", resolution=_DPI, title=_TITLE)
    try:
        if path.exists() and _TITLE.encode("utf-16-be") not in path.read_bytes():
            raise CalibrationError(f"{path} is there already and no board; give another with -o")
        write_whole(path, drawn.getvalue())
    except OSError as error:
        raise CalibrationError(f"{path}: cannot write ({error.strerror or error})") from error
    return sheet


def board_image(square_px: int) -> Gray:
    """The board alone, without a margin; each corner lies between pixels."""
    size_wh = (COLUMNS * square_px, ROWS * square_px)
    return np.asarray(_board().generateImage(size_wh, None, 0, 1), np.uint8)


class BoardFinder:
    """Finds the board in images."""

    def __init__(self) -> None:
        self._detector = cv2.aruco.CharucoDetector(_board())

    def find(self, gray: Gray) -> BoardView | None:
        """The board as an image (h, w) shows it; None where too little of it is seen."""
        corners, ids, _, _ = self._detector.detectBoard(gray)
        if ids is None or len(ids) < LEAST_CORNERS:
            return None
        found = np.asarray(ids, np.int64).ravel()
        view = BoardView(found, np.asarray(corners, np.float64).reshape(-1, 2))
        on_a_line = min(len(np.unique(view.places[:, axis])) for axis in (0, 1)) < 2
        return None if on_a_line else view


def _board() -> cv2.aruco.CharucoBoard:
    markers = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_50)
    return cv2.aruco.CharucoBoard((COLUMNS, ROWS), 1.0, MARKER_SHARE, markers)


def _page(sheet: Paper, name: str) -> Image.Image:
    page = Image.new("1", (sheet.width_mm * _PX_PER_MM, sheet.height_mm * _PX_PER_MM), 1)
    board = Image.fromarray(board_image(sheet.square_mm * _PX_PER_MM))
    left = (page.width - board.width) // 2
    top = (page.height - board.height) // 3
    page.paste(board.convert("1", dither=Image.Dither.NONE), (left, top))
    draw = ImageDraw.Draw(page)
    below = top + board.height + 3 * _PX_PER_MM
    font = ImageFont.load_default(3.2 * _PX_PER_MM)
    text = (
        f"vwnav calibration board, {name.upper()}: {COLUMNS} x {ROWS} squares of "
        f"{sheet.square_mm:.2f} mm. Print at 100 %, not fitted to the page;\nglue it to something "
        f"flat. This bar is {_BAR_MM} mm long:"
    )
    draw.multiline_text((left, below), text, fill=0, font=font, spacing=_PX_PER_MM)
    bar = below + 9 * _PX_PER_MM
    draw.rectangle((left, bar, left + _BAR_MM * _PX_PER_MM - 1, bar + _PX_PER_MM), fill=0)
    return page
