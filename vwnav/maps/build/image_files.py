"""Images whose corners are listed in a table (`map.csv`)."""

import codecs
import logging
import math
import re
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from vwnav.errors import MapError
from vwnav.files.pictures import read_picture
from vwnav.files.tables import numbered_rows
from vwnav.maps.build.raster import Bounds, DrawnSource, corner_georeference
from vwnav.maps.image import MapImage

_LOG = logging.getLogger(__name__)
_IMAGES_IN_MEMORY = 3
_USUAL_NAME = "map.csv"
_TOLD_DELIMITER = re.compile(r"sep=([;,|\t])\s*", re.IGNORECASE)  # Excel's first line

_LATITUDE, _LONGITUDE = r"lat(itude)?", r"(lon(g|gitude)?|lng)"
_TOP_LEFT, _BOTTOM_RIGHT = r"(topleft|upperleft|tl|ul|nw)", r"(bottomright|lowerright|br|lr|se)"
_COLUMNS = {
    "file": r"(file|filename|image|imagename|picture|photo|name|tile)",
    "north": rf"({_TOP_LEFT}(corner)?{_LATITUDE}|{_LATITUDE}{_TOP_LEFT}|north|maxlat|latmax|top)",
    "west": rf"({_TOP_LEFT}(corner)?{_LONGITUDE}|{_LONGITUDE}{_TOP_LEFT}|west|minlon|lonmin|left)",
    "south": rf"({_BOTTOM_RIGHT}(corner)?{_LATITUDE}|{_LATITUDE}{_BOTTOM_RIGHT}"
    r"|south|minlat|latmin|bottom)",
    "east": rf"({_BOTTOM_RIGHT}(corner)?{_LONGITUDE}|{_LONGITUDE}{_BOTTOM_RIGHT}"
    r"|east|maxlon|lonmax|right)",
}


@dataclass(frozen=True, slots=True)
class CornerRow:
    """A line of the table: an image's file name and its (south, west, north, east) in degrees."""

    file: str
    bounds: Bounds


class ImageCache:
    """Decoded images, the few that were used last."""

    def __init__(self) -> None:
        self._images: OrderedDict[Path, MapImage] = OrderedDict()

    def read(self, path: Path) -> MapImage:
        """An image as BGR with its mask.

        Raises:
            MapError: it cannot be decoded.
        """
        if path in self._images:
            self._images.move_to_end(path)
            return self._images[path]
        self._images[path] = _decoded(path)
        while len(self._images) > _IMAGES_IN_MEMORY:
            self._images.popitem(last=False)
        return self._images[path]


def corner_images(table: Path, listed: Sequence[Path] = ()) -> list[DrawnSource]:
    """The images of a table, found beside it or among those listed.

    Missing ones are passed over with a warning.

    Raises:
        MapError: the table makes no sense, or none of its images is there.
    """
    by_name = {path.name: path for path in listed}
    cache = ImageCache()
    found, missing = [], []
    for row in read_corners(table):
        path = by_name.get(Path(row.file).name, table.parent / row.file)
        if path.is_file():
            found.append(_corner_image(path, row.bounds, cache))
        else:
            missing.append(row.file)
    if not found:
        raise MapError(f"{table}: none of its {len(missing)} pictures is there")
    if missing:
        _LOG.warning("%s: left out, not there: %s", table, ", ".join(missing))
    return found


def _corner_image(path: Path, bounds: Bounds, cache: ImageCache) -> DrawnSource:
    h, w = cache.read(path).mask.shape
    georeference = corner_georeference(bounds, (w, h))
    return DrawnSource(
        path.name, (w, h), georeference, lambda window: cache.read(path).crop(window)
    )


def is_corner_table(path: Path) -> bool:
    """Whether a CSV file is meant as a corner table, by its name or by its columns alone.

    What is wrong with its lines is said when it is read.
    """
    if path.name.lower() == _USUAL_NAME:
        return True
    try:
        _columns_and_rows(path, errors="replace")
    except MapError:
        return False
    return True


def read_corners(table: Path) -> list[CornerRow]:
    """Read a table of corner coordinates; spaces, quotes and the header's spelling are free.

    Raises:
        MapError: it cannot be read, or a column or number is missing or wrong, with its line.
    """
    columns, rows = _columns_and_rows(table)
    return [_corner_row(f"{table}, line {line}", row, columns) for line, row in rows if any(row)]


def _columns_and_rows(
    table: Path, errors: Literal["strict", "replace"] = "strict"
) -> tuple[dict[str, int], Iterator[tuple[int, list[str]]]]:
    """Where each column stands, and the rows below the header with their lines."""
    lines = _text(table, errors).splitlines() or [""]
    if told := _TOLD_DELIMITER.fullmatch(lines[0]):
        delimiter, lines[0] = told[1], ""
    else:
        delimiter = next((sign for sign in (";", "\t") if sign in lines[0]), ",")
    rows = numbered_rows(lines, table, MapError, delimiter)
    _, header = next(rows, (0, []))
    return _columns(table, header), rows


def _text(table: Path, errors: Literal["strict", "replace"]) -> str:
    try:
        data = table.read_bytes()
        is_utf16 = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        return data.decode("utf-16" if is_utf16 else "utf-8-sig", errors)
    except (OSError, UnicodeDecodeError) as error:
        raise MapError(f"{table}: cannot be read as text; save it as UTF-8 ({error})") from error


def _columns(table: Path, header: Sequence[str]) -> dict[str, int]:
    spelt = [re.sub(r"[^a-z]", "", cell.lower()) for cell in header]
    spelt = [re.sub(r"(deg|degrees)$", "", cell) for cell in spelt]
    columns = {}
    for column, pattern in _COLUMNS.items():
        matches = [i for i, cell in enumerate(spelt) if re.fullmatch(pattern, cell)]
        if not matches:
            raise MapError(
                f"{table}: no column for {column}; expected a header such as Filename, "
                "Top_left_lat, Top_left_lon, Bottom_right_lat, Bottom_right_lon"
            )
        if len(matches) > len({spelt[i] for i in matches}):
            raise MapError(
                f"{table}: has two columns {header[matches[0]]}; leave out the wrong one"
            )
        columns[column] = matches[0]
    return columns


def _corner_row(where: str, row: Sequence[str], columns: dict[str, int]) -> CornerRow:
    cells = [cell.strip("\"'").strip() for cell in row]
    if len(cells) <= max(columns.values()):
        raise MapError(f"{where}: has {len(cells)} columns of {max(columns.values()) + 1}")
    try:
        bounds = tuple(float(cells[columns[side]]) for side in ("south", "west", "north", "east"))
    except ValueError as error:
        raise MapError(f"{where}: a corner is no number ({error})") from error
    south, west, north, east = bounds
    if not (-90.0 <= south < north <= 90.0 and -180.0 <= west < east <= 180.0):
        raise MapError(f"{where}: the top left corner must lie north-west of the bottom right one")
    if not cells[columns["file"]] or not all(map(math.isfinite, bounds)):
        raise MapError(f"{where}: a file name or a corner is missing")
    return CornerRow(cells[columns["file"]], (south, west, north, east))


def _decoded(path: Path) -> MapImage:
    image = read_picture(path, cv2.IMREAD_UNCHANGED, MapError)
    if image.dtype != np.uint8:
        raise MapError(f"{path}: not a picture of 8 bits; make it one, or a GeoTIFF")
    if image.ndim == 2:
        image = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    if image.shape[2] == 4:
        return MapImage(np.ascontiguousarray(image[..., :3]), image[..., 3] > 0)
    return MapImage(np.asarray(image, np.uint8), np.ones(image.shape[:2], np.bool_))
