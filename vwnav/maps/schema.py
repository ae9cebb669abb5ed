"""The tables of a pack: MBTiles 1.3 and, beside it in the same file, what is vwnav's own."""

import hashlib
import os
import sqlite3
from pathlib import Path
from typing import Literal, get_args
from urllib.parse import quote

SCHEMA_VERSION = 1
SQLITE_MAGIC = b"SQLite format 3\0"
ASSUMED_SIGMA_M = 1.0  # of the imagery's position, where nothing else is known
# How it is known: the operator said it, sources that overlap showed it, or nobody did.
GeoreferenceBasis = Literal["given", "estimated", "assumed"]
GEOREFERENCE_BASES: tuple[GeoreferenceBasis, ...] = get_args(GeoreferenceBasis)
APPLICATION_ID = 0x4D504258  # "MPBX": MBTiles, for those who look at the file's header

TABLES = """
CREATE TABLE metadata (name TEXT, value TEXT);
CREATE TABLE tiles (zoom_level INTEGER, tile_column INTEGER, tile_row INTEGER, tile_data BLOB);
CREATE UNIQUE INDEX tile_index ON tiles (zoom_level, tile_column, tile_row);
CREATE TABLE vwnav_metadata (name TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE vwnav_tiles (
    zoom_level INTEGER, tile_column INTEGER, tile_row INTEGER, crc32 INTEGER NOT NULL,
    PRIMARY KEY (zoom_level, tile_column, tile_row)
);
CREATE TABLE vwnav_feature_sets (
    name TEXT PRIMARY KEY, feature_set_id TEXT NOT NULL,
    descriptor_kind TEXT NOT NULL, dimension INTEGER NOT NULL
);
CREATE TABLE vwnav_features (
    set_name TEXT, zoom_level INTEGER, tile_column INTEGER, tile_row INTEGER,
    keypoints INTEGER NOT NULL, crc32 INTEGER NOT NULL, data BLOB NOT NULL,
    PRIMARY KEY (set_name, zoom_level, tile_column, tile_row)
);
CREATE TABLE vwnav_heights (rows INTEGER, columns INTEGER, bounds TEXT, crc32 INTEGER, data BLOB);
"""

_DESCRIPTIONS = (
    "SELECT name, value FROM metadata ORDER BY name",
    "SELECT name, value FROM vwnav_metadata WHERE name != 'checksum' ORDER BY name",
    "SELECT name, feature_set_id, descriptor_kind, dimension FROM vwnav_feature_sets ORDER BY name",
)


def metadata_checksum(connection: sqlite3.Connection) -> str:
    """SHA-256 over everything that describes the pack, without its tiles and features."""
    digest = hashlib.sha256()
    for query in _DESCRIPTIONS:
        for row in connection.execute(query):
            digest.update(repr(row).encode())
    return digest.hexdigest()


def is_pack(path: Path) -> bool:
    """Whether a file is a pack of ours, which other MBTiles and databases are not.

    Raises:
        sqlite3.Error: it is a damaged database.
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        if file.read(len(SQLITE_MAGIC)) != SQLITE_MAGIC:
            return False
    connection = sqlite3.connect(f"file:{quote(os.fsencode(path.resolve()))}?mode=ro", uri=True)
    try:
        query = "SELECT COUNT(*) FROM sqlite_master WHERE name = 'vwnav_metadata'"
        return bool(connection.execute(query).fetchone()[0])
    finally:
        connection.close()
