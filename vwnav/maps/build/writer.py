"""Writes a pack: to a temporary file beside it, renamed when it is whole, else removed."""

import os
import re
import sqlite3
import zlib
from contextlib import suppress
from pathlib import Path
from types import TracebackType

import numpy as np

from vwnav.errors import MapError
from vwnav.geometry.geodesy import Tile, Window
from vwnav.maps.codec import (
    DescriptorKind,
    decode_tile,
    descriptor_kind,
    encode_features,
    encode_tile,
)
from vwnav.maps.heights import HeightGrid
from vwnav.maps.image import MapImage, assemble
from vwnav.maps.schema import APPLICATION_ID, TABLES, is_pack, metadata_checksum
from vwnav.types import FeatureExtractor, FeatureName, Features


class PackWriter:
    """A pack being made: a context manager; `begin` starts it, `finish` puts it under its name."""

    def __init__(self, output: Path) -> None:
        """Check the output's place; the disk is not touched yet.

        Raises:
            MapError: there is no such folder, or the output is a file of another kind.
        """
        check_replaceable(output)
        self._output = output
        self._temporary = output.with_name(f".{output.name}.{os.getpid()}.tmp")
        self._connection = sqlite3.connect(":memory:")
        self._kinds: dict[FeatureName, DescriptorKind] = {}

    def __enter__(self) -> "PackWriter":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._connection.close()
        self._temporary.unlink(missing_ok=True)
        if isinstance(error, sqlite3.OperationalError):
            raise MapError(
                f"cannot write {self._output}: {error}; is there room, and may it be written?"
            ) from error

    def begin(self) -> None:
        """Make the temporary file; inside of the context, so that an interrupt leaves nothing."""
        _remove_abandoned(self._output)
        self._connection = sqlite3.connect(self._temporary, isolation_level=None)
        # Whole or removed: neither a journal nor a sync before the last one is needed.
        self._connection.execute("PRAGMA journal_mode = OFF")
        self._connection.execute("PRAGMA synchronous = OFF")
        self._connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
        self._connection.executescript(TABLES)

    def put_tile(self, tile: Tile, image: MapImage) -> None:
        """Write a tile; one without any data is left out."""
        if not image.mask.any():
            return
        data = encode_tile(image)
        place = (tile.zoom, tile.x, tile.row)
        self._connection.execute("INSERT INTO tiles VALUES (?, ?, ?, ?)", (*place, data))
        self._connection.execute(
            "INSERT INTO vwnav_tiles VALUES (?, ?, ?, ?)", (*place, zlib.crc32(data))
        )

    def colour_image(self, zoom: int, window: Window) -> MapImage:
        """Read back what is written of a level."""
        return assemble(zoom, window, self._tile)

    def tiles(self, zoom: int) -> list[Tile]:
        """The tiles written of a level, in order of columns."""
        rows = self._connection.execute(
            "SELECT tile_column, tile_row FROM tiles WHERE zoom_level = ? ORDER BY 1, 2", (zoom,)
        )
        return [Tile(zoom, x, 2**zoom - 1 - row) for x, row in rows]

    def add_feature_set(self, extractor: FeatureExtractor) -> None:
        """Announce a feature set before its features."""
        name, kind = extractor.name, descriptor_kind(extractor.name)
        # An image without contrast tells the length of a descriptor as well as any other.
        dimension = extractor.extract(np.zeros((64, 64), np.uint8), 1).descriptors.shape[1]
        self._kinds[name] = kind
        self._connection.execute(
            "INSERT INTO vwnav_feature_sets VALUES (?, ?, ?, ?)",
            (name, extractor.feature_set_id, kind, dimension),
        )

    def put_features(self, name: FeatureName, tile: Tile, features: Features) -> None:
        """Write a tile's features of an announced set."""
        data = encode_features(features, self._kinds[name])
        self._connection.execute(
            "INSERT INTO vwnav_features VALUES (?, ?, ?, ?, ?, ?, ?)",
            (name, tile.zoom, tile.x, tile.row, len(features), zlib.crc32(data), data),
        )

    def put_heights(self, heights: HeightGrid) -> None:
        """Write the terrain heights."""
        data = heights.encoded()
        rows, columns = heights.heights_m.shape
        bounds = ",".join(f"{value:.9f}" for value in heights.bounds)
        self._connection.execute(
            "INSERT INTO vwnav_heights VALUES (?, ?, ?, ?, ?)",
            (rows, columns, bounds, zlib.crc32(data), data),
        )

    def finish(self, mbtiles: dict[str, str], own: dict[str, str]) -> None:
        """Write what describes the pack, and put it in its place.

        Args:
            mbtiles: rows of the MBTiles metadata.
            own: rows of vwnav's metadata, to which the checksum is added.

        Raises:
            MapError: the disk refuses.
        """
        database = self._connection
        database.executemany("INSERT INTO metadata VALUES (?, ?)", mbtiles.items())
        database.executemany("INSERT INTO vwnav_metadata VALUES (?, ?)", own.items())
        checksum = metadata_checksum(database)
        database.execute("INSERT INTO vwnav_metadata VALUES ('checksum', ?)", (checksum,))
        database.close()
        try:
            _sync(self._temporary)
            self._temporary.replace(self._output)
            _sync(self._output.parent)
        except OSError as error:
            raise MapError(f"cannot write {self._output}: {error.strerror}") from error

    def _tile(self, tile: Tile) -> MapImage | None:
        row = self._connection.execute(
            "SELECT tile_data FROM tiles WHERE zoom_level = ? AND tile_column = ? AND tile_row = ?",
            (tile.zoom, tile.x, tile.row),
        ).fetchone()
        return None if row is None else decode_tile(row[0])


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def check_replaceable(output: Path) -> None:
    """Refuse to overwrite anything but a pack: a photograph, another program's database.

    Raises:
        MapError: it is there and no pack, or in no folder.
    """
    if not output.parent.is_dir():
        raise MapError(f"{output.parent} is no folder; make it first")
    if output.is_dir():
        raise MapError(f"{output} is a folder; name a file to write, such as site.mbtiles")
    if output.exists() and not (output.is_file() and _may_be_replaced(output)):
        raise MapError(f"{output} exists and is no map pack; write to another name")


def _may_be_replaced(output: Path) -> bool:
    """An empty file holds nothing; of a damaged database nobody knows what it was."""
    try:
        return not output.stat().st_size or is_pack(output)
    except sqlite3.Error:
        return False


def _remove_abandoned(output: Path) -> None:
    """Remove what builds of the same pack left when they were killed and could not clean up."""
    pattern = re.compile(re.escape(f".{output.name}.") + r"(\d+)\.tmp")
    for path in output.parent.iterdir():
        match = pattern.fullmatch(path.name)
        if match and not _is_running(int(match[1])):
            with suppress(OSError):
                path.unlink()


def _is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return pid != os.getpid()
