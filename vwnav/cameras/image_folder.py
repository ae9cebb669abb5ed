"""A folder of images, in the order of their names."""

import itertools
import re
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np

from vwnav.errors import SourceError
from vwnav.files.folder import PICTURES, files_in
from vwnav.files.pictures import read_picture
from vwnav.types import Frame

_EXIF_BYTES = 1 << 16
# Exif 2.32, 4.6.5: dates are ASCII "YYYY:MM:DD HH:MM:SS" with a closing zero.
_EXIF_DATE = re.compile(rb"(\d{4}:\d\d:\d\d \d\d:\d\d:\d\d)\0")


class ImageFolder:
    """A `FrameSource` over a folder.

    `t_s` counts from the first image: by EXIF where every image has a time and they rise,
    else by number and rate.

    Args:
        folder: images are taken in natural order of their names (`2.jpg` before `10.jpg`).
        fps: images per second where EXIF does not say.

    Raises:
        SourceError: there is no image in it.
    """

    def __init__(self, folder: Path, fps: float) -> None:
        self._paths = sorted(files_in(folder, PICTURES), key=lambda path: _natural_key(path.name))
        if not self._paths:
            raise SourceError(f"{folder} holds no picture ({', '.join(PICTURES)})")
        self._times_s = _times(self._paths, fps)
        self._next = 0

    def next_frame(self) -> Frame | None:
        """The next image, None after the last.

        Raises:
            SourceError: it cannot be decoded.
        """
        if self._next >= len(self._paths):
            return None
        index, self._next = self._next, self._next + 1
        return Frame(self._times_s[index], read_image(self._paths[index]), index)

    def close(self) -> None:
        """Nothing is held open."""


def read_image(path: Path) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    """(h, w, 3) BGR uint8 of an image file, not turned by its EXIF orientation.

    Raises:
        SourceError: it cannot be read or decoded.
    """
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    return np.asarray(read_picture(path, flags, SourceError), dtype=np.uint8)


def _natural_key(name: str) -> list[tuple[int, str]]:
    parts = re.findall(r"\d+|\D+", name)
    return [(int(part), "") if part.isdecimal() else (0, part.lower()) for part in parts]


def _times(paths: list[Path], fps: float) -> list[float]:
    dates = [_exposure_date(path) for path in paths]
    known = [date.timestamp() for date in dates if date is not None]
    if len(known) == len(paths) and all(a < b for a, b in itertools.pairwise(known)):
        return [t_s - known[0] for t_s in known]
    return [index / fps for index in range(len(paths))]


def _exposure_date(path: Path) -> datetime | None:
    """The earliest of the EXIF dates: the others tell when the file was written or edited."""
    with path.open("rb") as file:
        head = file.read(_EXIF_BYTES)
    dates = []
    for text in _EXIF_DATE.findall(head):
        try:
            date = datetime.strptime(text.decode(), "%Y:%m:%d %H:%M:%S")
        except ValueError:  # "0000:00:00 00:00:00", a camera whose clock was never set
            continue
        dates.append(date.replace(tzinfo=UTC))
    return min(dates, default=None)
