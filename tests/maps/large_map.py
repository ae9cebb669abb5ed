"""A map that is written again and again beside itself."""

import json
import math
import sqlite3
from pathlib import Path

from vwnav.maps.schema import metadata_checksum

_SHIFTED = {
    "tiles": "zoom_level, tile_column + ?, tile_row + ?, tile_data",
    "vwnav_tiles": "zoom_level, tile_column + ?, tile_row + ?, crc32",
    "vwnav_features": "set_name, zoom_level, tile_column + ?, tile_row + ?, keypoints, crc32, data",
}


def spread(pack: Path, times: int) -> None:
    """Write all that the pack shows `times` x `times` times, most of it north and east.

    Copies lie whole tiles of the coarsest level apart, so that each tile is what it was.
    """
    with sqlite3.connect(pack) as connection:
        told = connection.execute("SELECT value FROM vwnav_metadata WHERE name = 'levels'")
        coarsest = min(json.loads(told.fetchone()[0]))
        columns, rows = _extent(connection, coarsest)
        shifts = [(i, j) for i in range(times) for j in range(times) if (i, j) != (0, 0)]
        for table, values in _SHIFTED.items():
            connection.execute(f"CREATE TEMP TABLE first AS SELECT * FROM {table}")
            for (zoom,) in connection.execute("SELECT DISTINCT zoom_level FROM first").fetchall():
                finer = 1 << (zoom - coarsest)
                connection.executemany(
                    f"INSERT INTO {table} SELECT {values} FROM first WHERE zoom_level = {zoom}",
                    [(i * columns * finer, j * rows * finer) for i, j in shifts],
                )
            connection.execute("DROP TABLE first")
        shown = connection.execute("SELECT value FROM metadata WHERE name = 'bounds'").fetchone()[0]
        west, south, east, north = map(float, shown.split(","))
        east += (times - 1) * columns * 360.0 / 2**coarsest
        north = _lat_deg(_tile(north, coarsest) + (times - 1) * rows, coarsest)
        bounds = f"{west!r},{south!r},{east!r},{north!r}"
        connection.execute("UPDATE metadata SET value = ? WHERE name = 'bounds'", [bounds])
        checksum = metadata_checksum(connection)
        connection.execute(
            "UPDATE vwnav_metadata SET value = ? WHERE name = 'checksum'", [checksum]
        )


def _extent(connection: sqlite3.Connection, zoom: int) -> tuple[int, int]:
    """How many columns and rows of tiles it has there."""
    spans = "MAX(tile_column) - MIN(tile_column) + 1, MAX(tile_row) - MIN(tile_row) + 1"
    found = connection.execute(f"SELECT {spans} FROM tiles WHERE zoom_level = {zoom}").fetchone()
    return int(found[0]), int(found[1])


def _tile(lat_deg: float, zoom: int) -> float:
    """Row of a latitude, from the south (TMS), with its fraction."""
    return (math.asinh(math.tan(math.radians(lat_deg))) / math.pi + 1.0) * 2 ** (zoom - 1)


def _lat_deg(row: float, zoom: int) -> float:
    return math.degrees(math.atan(math.sinh(math.pi * (row / 2 ** (zoom - 1) - 1.0))))
