"""The file of a pack: opening, checking, and reading single rows of it."""

import json
import os
import re
import sqlite3
import zlib
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from vwnav.errors import MapError
from vwnav.geometry.geodesy import Tile, Window, ground_resolution_m_per_px
from vwnav.maps.codec import DESCRIPTOR_KINDS, DescriptorKind, decode_features, decode_tile
from vwnav.maps.heights import HeightGrid
from vwnav.maps.image import Level, MapImage
from vwnav.maps.schema import (
    GEOREFERENCE_BASES,
    SCHEMA_VERSION,
    SQLITE_MAGIC,
    GeoreferenceBasis,
    metadata_checksum,
)
from vwnav.types import FEATURE_NAMES, FeatureName, Features

_HEADER_BYTES = 100

# What reading a damaged row may raise; TypeError is a value of another type than the column's.
DAMAGE = (sqlite3.Error, zlib.error, ValueError, TypeError, OverflowError)


@dataclass(frozen=True, slots=True)
class FeatureSetInfo:
    """A precomputed feature set: what its descriptors can be compared with, and how it is kept."""

    name: FeatureName
    feature_set_id: str
    descriptor_kind: DescriptorKind
    dimension: int


def model_of(feature_set_id: str) -> str:
    """Size of the network that made learned features; "" of others."""
    size = re.match(r"vwnav-learned-(\w+)-", feature_set_id)
    return "" if size is None else size[1]


@dataclass(frozen=True, slots=True)
class Description:
    """What a pack says about itself.

    Attributes:
        bounds: south, west, north, east of the imagery, degrees.
        levels: finest first.
        georeference_sigma_m: one sigma of the imagery's position, per horizontal axis.
        georeference_basis: how that is known; None where the pack does not say.
        sources: names of the files it was built from.
    """

    name: str
    attribution: str
    bounds: tuple[float, float, float, float]
    levels: tuple[Level, ...]
    feature_sets: tuple[FeatureSetInfo, ...]
    georeference_sigma_m: float
    georeference_basis: GeoreferenceBasis | None
    sources: tuple[str, ...]
    created_utc: str


def open_database(path: Path) -> sqlite3.Connection:
    """Open a pack for reading and check all of it but the tiles.

    Raises:
        MapError: missing, damaged, cut off, of another version, or no pack at all.
    """
    _check_file(path)
    # Immutable: no lock files beside it, works from read-only media.
    uri = f"file:{quote(os.fsencode(path.resolve()))}?mode=ro&immutable=1"
    try:
        connection = sqlite3.connect(uri, uri=True, check_same_thread=False)
    except sqlite3.Error as error:
        raise MapError(f"{path}: cannot be opened ({error})") from error
    try:
        _check_schema(path, connection)
    except MapError:
        connection.close()
        raise
    except DAMAGE as error:
        connection.close()
        raise damaged(path, str(error)) from error
    return connection


def damaged(path: Path, why: str) -> MapError:
    """The error for a pack that cannot be used as a whole."""
    return MapError(f"{path}: damaged ({why}); copy it again, or rebuild it with `vwnav map build`")


def read_description(connection: sqlite3.Connection) -> Description:
    """What the pack says about itself.

    Raises:
        KeyError: something is not said. Also what `DAMAGE` lists.
    """
    own = dict(connection.execute("SELECT name, value FROM vwnav_metadata"))
    shown = dict(connection.execute("SELECT name, value FROM metadata"))
    west, south, east, north = (float(edge) for edge in shown["bounds"].split(","))
    sets = connection.execute(
        "SELECT name, feature_set_id, descriptor_kind, dimension FROM vwnav_feature_sets"
    )
    middle_deg = (south + north) / 2.0
    return Description(
        name=shown["name"],
        attribution=shown["attribution"],
        bounds=(south, west, north, east),
        levels=tuple(
            Level(zoom, ground_resolution_m_per_px(middle_deg, zoom))
            for zoom in json.loads(own["levels"])
        ),
        feature_sets=tuple(_feature_set(row) for row in sets),
        georeference_sigma_m=float(own["georeference_sigma_m"]),
        georeference_basis=next(
            (known for known in GEOREFERENCE_BASES if known == own.get("georeference_basis")), None
        ),
        sources=tuple(json.loads(own["sources"])),
        created_utc=own["created_utc"],
    )


def read_tile_window(connection: sqlite3.Connection, zoom: int) -> Window:
    """The rectangle of a level's tiles in its global pixels.

    Raises:
        ValueError: it has none.
    """
    x0, row0, x1, row1 = connection.execute(
        "SELECT MIN(tile_column), MIN(tile_row), MAX(tile_column), MAX(tile_row) FROM vwnav_tiles "
        "WHERE zoom_level = ?",
        (zoom,),
    ).fetchone()
    if x0 is None:
        raise ValueError(f"level {zoom} has no tiles")
    first = Tile(zoom, x0, 2**zoom - 1 - row1).window
    last = Tile(zoom, x1, 2**zoom - 1 - row0).window
    return Window(first.x0, first.y0, last.x1, last.y1)


def read_image(connection: sqlite3.Connection, tile: Tile) -> MapImage | None:
    """The image of a tile, None where the map has nothing; damage raises what `DAMAGE` lists."""
    row = connection.execute(
        "SELECT tile_data, crc32 FROM vwnav_tiles LEFT JOIN tiles "
        "USING (zoom_level, tile_column, tile_row) "
        "WHERE zoom_level = ? AND tile_column = ? AND tile_row = ?",
        (tile.zoom, tile.x, tile.row),
    ).fetchone()
    if row is None:
        return None
    _check_crc(row[0], row[1])
    return decode_tile(row[0])


def read_features(
    connection: sqlite3.Connection, tile: Tile, info: FeatureSetInfo
) -> Features | None:
    """The features of a tile, None where it has none; damage raises what `DAMAGE` lists."""
    row = connection.execute(
        "SELECT data, crc32, keypoints FROM vwnav_features WHERE set_name = ? "
        "AND zoom_level = ? AND tile_column = ? AND tile_row = ?",
        (info.name, tile.zoom, tile.x, tile.row),
    ).fetchone()
    if row is None:
        return None
    _check_crc(row[0], row[1])
    return decode_features(row[0], row[2], info.dimension, info.descriptor_kind)


def read_heights(connection: sqlite3.Connection) -> HeightGrid | None:
    """The terrain heights, None where the pack has none; damage raises what `DAMAGE` lists."""
    row = connection.execute(
        "SELECT rows, columns, bounds, crc32, data FROM vwnav_heights"
    ).fetchone()
    if row is None:
        return None
    rows, columns, bounds, crc32, data = row
    _check_crc(data, crc32)
    south, west, north, east = (float(edge) for edge in bounds.split(","))
    return HeightGrid.decoded(data, (rows, columns), (south, west, north, east))


def _check_crc(data: bytes, crc32: int) -> None:
    if zlib.crc32(data) != crc32:
        raise ValueError("its checksum differs")


def _feature_set(row: tuple[str, str, str, int]) -> FeatureSetInfo:
    name = next((known for known in FEATURE_NAMES if known == row[0]), None)
    kind = next((known for known in DESCRIPTOR_KINDS if known == row[2]), None)
    if name is None or kind is None:
        raise ValueError(f"unknown feature set {row[0]} {row[2]}")
    return FeatureSetInfo(name, row[1], kind, row[3])


def _check_file(path: Path) -> None:
    """Refuse what is missing, no SQLite file, or shorter than its own header says."""
    if not path.is_file():
        raise MapError(f"{path}: no such map pack; make one: `vwnav map build SOURCE -o {path}`")
    try:
        with path.open("rb") as file:
            header = file.read(_HEADER_BYTES)
        size = path.stat().st_size
    except OSError as error:
        raise MapError(f"{path}: cannot be read ({error.strerror})") from error
    if len(header) < _HEADER_BYTES or not header.startswith(SQLITE_MAGIC):
        raise MapError(f"{path}: not a map pack; make one: `vwnav map build SOURCE -o PACK`")
    # SQLite file format, 1.3: page size at 16 (1 means 65536), pages at 28, big-endian.
    page_bytes = int.from_bytes(header[16:18], "big")
    page_bytes = 65536 if page_bytes == 1 else page_bytes
    expected = page_bytes * int.from_bytes(header[28:32], "big")
    if size < expected:
        raise damaged(path, f"cut off: {size} of {expected} bytes")


def _check_schema(path: Path, connection: sqlite3.Connection) -> None:
    tables = {row[0] for row in connection.execute("SELECT name FROM sqlite_master")}
    if "vwnav_metadata" not in tables:
        what = "imagery without features" if "tiles" in tables else "a database of another kind"
        raise MapError(
            f"{path}: not a map pack but {what}; make one: `vwnav map build SOURCE -o PACK`"
        )
    own = dict(connection.execute("SELECT name, value FROM vwnav_metadata"))
    if own.get("schema_version") != str(SCHEMA_VERSION):
        raise MapError(
            f"{path}: a pack of schema {own.get('schema_version')}, this program reads "
            f"{SCHEMA_VERSION}; rebuild it from its sources with `vwnav map build`"
        )
    if own.get("checksum") != metadata_checksum(connection):
        raise damaged(path, "the checksum of its description differs")
