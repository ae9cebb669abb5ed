"""The map as it is read in flight: sqlite3, numpy and OpenCV, only the tiles that are asked for."""

import logging
import threading
from collections import OrderedDict
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from vwnav.errors import ModelError
from vwnav.geometry.geodesy import TILE_PX, Tile, Window, mercator_px
from vwnav.maps.build.keypoints import block_of, block_tiles, extract_block
from vwnav.maps.image import JoinedFeatures, MapFeatures, MapImage, Mask, assemble, join
from vwnav.maps.mbtiles import (
    DAMAGE,
    FeatureSetInfo,
    damaged,
    model_of,
    open_database,
    read_description,
    read_features,
    read_heights,
    read_image,
    read_tile_window,
)
from vwnav.types import FEATURE_NAMES, Array, FeatureExtractor, FeatureName, Features, Gray

_LOG = logging.getLogger(__name__)
_CACHED_IMAGES = 64  # tiles; 0.25 MB each
_CACHED_FEATURES = 192  # tiles of one set; up to 0.2 MB each
MAX_WINDOW_PX = 64_000_000
MAX_KEYPOINTS = 20_000
_CACHED_JOINS = 3  # what steps look at: around the prior, closer, and beside it; some MB each
Key = TypeVar("Key")
Value = TypeVar("Value")


class Lru(Generic[Key, Value]):
    """The values used last, at most `size` of them."""

    def __init__(self, size: int) -> None:
        """`size` may be one or more."""
        self._size = size
        self._values: OrderedDict[Key, Value] = OrderedDict()

    def __contains__(self, key: Key) -> bool:
        return key in self._values

    def get(self, key: Key, make: Callable[[], Value]) -> Value:
        """The value of a key, made now where it is not kept."""
        if key not in self._values:
            self.put(key, make())
        self._values.move_to_end(key)
        return self._values[key]

    def put(self, key: Key, value: Value) -> None:
        """Keep a value; the one that was not used for longest makes room."""
        self._values[key] = value
        while len(self._values) > self._size:
            self._values.popitem(last=False)


class MapPack:
    """An open map pack. Safe to use from several threads: one at a time is served.

    Damage that shows only in flight costs the damaged tile, with one warning, never the flight.

    Attributes:
        path, name, attribution: the file; shown to people.
        bounds: south, west, north, east of the imagery, degrees.
        levels: zoom levels, finest first.
        feature_sets: the precomputed ones.
        georeference_sigma_m: one sigma of the imagery's position, per horizontal axis.
        georeference_basis: how that is known, None if not said.
        sources: names of the files it was built from.
        created_utc: when, ISO 8601, empty if not said.
    """

    def __init__(self, path: Path) -> None:
        """Open a pack for reading.

        Raises:
            MapError: it is missing, damaged, cut off, of another version, or no pack at all.
        """
        self.path = path
        self._lock = threading.RLock()
        self._connection = open_database(path)
        try:
            description = read_description(self._connection)
            self._windows = {
                level.zoom: read_tile_window(self._connection, level.zoom)
                for level in description.levels
            }
            self.heights = read_heights(self._connection)
        except (*DAMAGE, KeyError) as error:
            self._connection.close()
            raise damaged(path, str(error)) from error
        self.name, self.attribution = description.name, description.attribution
        self.bounds, self.levels = description.bounds, description.levels
        self.feature_sets = description.feature_sets
        self.georeference_sigma_m = description.georeference_sigma_m
        self.georeference_basis = description.georeference_basis
        self.sources, self.created_utc = description.sources, description.created_utc
        self._images: Lru[Tile, MapImage | None] = Lru(_CACHED_IMAGES)
        self._features: Lru[tuple[str, Tile], Features | None] = Lru(_CACHED_FEATURES)
        self._joined: Lru[tuple[str, tuple[Tile, ...]], JoinedFeatures | None] = Lru(_CACHED_JOINS)
        self._warned: set[object] = set()

    @classmethod
    def open(cls, path: Path | str) -> "MapPack":
        """Open a pack for reading.

        Raises:
            MapError: it is missing, damaged, cut off, of another version, or no pack at all.
        """
        return cls(Path(path))

    def close(self) -> None:
        """Close the file; the pack cannot be used afterwards."""
        with self._lock:
            self._connection.close()

    def __enter__(self) -> "MapPack":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def middle(self) -> tuple[float, float]:
        """(lat_deg, lon_deg) of its middle: where a run without a home has its origin."""
        south, west, north, east = self.bounds
        return (south + north) / 2.0, (west + east) / 2.0

    def window(self, zoom: int) -> Window:
        """The rectangle of a level's tiles in its global pixels.

        Raises:
            ValueError: not one of the pack's levels.
        """
        if zoom not in self._windows:
            raise ValueError(f"expected one of the levels {sorted(self._windows)}, got {zoom}")
        return self._windows[zoom]

    def covers(self, lat_deg: float, lon_deg: float) -> bool:
        """Whether there is imagery at a place, to a pixel of the coarsest level."""
        zoom = self.levels[-1].zoom
        x, y = mercator_px(lat_deg, lon_deg, zoom)
        if not (np.isfinite(x) and np.isfinite(y)):
            return False
        column, row = int(np.floor(x)), int(np.floor(y))
        image = self._tile_image(Tile(zoom, column // TILE_PX, row // TILE_PX))
        return image is not None and bool(image.mask[row % TILE_PX, column % TILE_PX])

    def image(self, zoom: int, x0: int, y0: int, x1: int, y1: int) -> tuple[Gray, Mask]:
        """The gray image (h, w) of a window of global pixels, and where it has data.

        Raises:
            ValueError: not a level of the pack, or not 1 to `MAX_WINDOW_PX` pixels.
        """
        image = self.colour_image(zoom, Window(int(x0), int(y0), int(x1), int(y1)))
        return image.gray, image.mask

    def colour_image(self, zoom: int, window: Window) -> MapImage:
        """The colour image of a window of global pixels, with its mask.

        Raises:
            ValueError: not a level of the pack, or not 1 to `MAX_WINDOW_PX` pixels.
        """
        h, w = window.shape
        if not 0 < h * w <= MAX_WINDOW_PX:
            raise ValueError(f"expected 1 to {MAX_WINDOW_PX} pixels, got {w} x {h}")
        self.window(zoom)
        return assemble(zoom, window, self._tile_image)

    def features_in(
        self,
        zoom: int,
        x0: int,
        y0: int,
        x1: int,
        y1: int,
        extractor: FeatureExtractor,
        *,
        max_keypoints: int = MAX_KEYPOINTS,
    ) -> MapFeatures:
        """Map features inside a window of global pixels.

        A set that is not in the pack is extracted from the tiles under the window: slowly, with
        one warning, and kept for a while.

        Args:
            zoom: a level of the pack.
            x0: the window's left edge; then its top, right and bottom, end exclusive.
            y0: see `x0`.
            x1: see `x0`.
            y1: see `x0`.
            extractor: whose features are wanted.
            max_keypoints: at most so many; every tile gives its strongest ones.

        Raises:
            ValueError: not a level of the pack.
            ModelError: the pack's set of that name was made by another model.
        """
        window = Window(int(x0), int(y0), int(x1), int(y1)).clipped(self.window(zoom))
        origin_px = np.array(window[:2], np.int64)
        tiles = tuple(window.tiles(zoom))
        with self._lock:
            joined = self._joined.get(
                (extractor.feature_set_id, tiles),
                lambda: join(self._tiled_features(tiles, extractor)),
            )
        if joined is None:
            nothing = extractor.extract(np.zeros((64, 64), np.uint8), 1)
            return MapFeatures(zoom, origin_px, nothing)
        return MapFeatures(zoom, origin_px, _strongest_in(joined, window, max_keypoints))

    def elevation_m(self, lat_deg: float, lon_deg: float) -> float | None:
        """Height of the ground above mean sea level in metres, None where it is not known."""
        return None if self.heights is None else self.heights.at(lat_deg, lon_deg)

    def elevations_m(self, lat_deg: Array, lon_deg: Array) -> Array:
        """The same of places (n,), (n,): (n,), NaN where it is not known."""
        if self.heights is None:
            return np.full(len(lat_deg), np.nan)
        return self.heights.at_each(lat_deg, lon_deg)

    def tile_count(self, zoom: int) -> int:
        """Number of tiles of a level.

        Raises:
            MapError: the pack is damaged.
        """
        return self._count("SELECT COUNT(*) FROM vwnav_tiles WHERE zoom_level = ?", zoom)

    def keypoint_count(self, name: FeatureName) -> int:
        """Number of keypoints of a set over all levels.

        Raises:
            MapError: the pack is damaged.
        """
        return self._count("SELECT SUM(keypoints) FROM vwnav_features WHERE set_name = ?", name)

    def _count(self, query: str, parameter: object) -> int:
        try:
            with self._lock:
                (count,) = self._connection.execute(query, (parameter,)).fetchone()
        except DAMAGE as error:
            raise damaged(self.path, str(error)) from error
        return int(count or 0)

    def check_features(self, extractor: FeatureExtractor) -> FeatureSetInfo | None:
        """The pack's features that can be compared with an extractor's; None where there are none.

        Raises:
            ModelError: they were made by another model; the message holds the repairing command.
        """
        stored = next((info for info in self.feature_sets if info.name == extractor.name), None)
        if stored is None:
            self._warn_once(
                extractor.name,
                f"{self.path}: holds no {extractor.name} features, they are extracted as they are "
                f"needed, slowly; `{self._repair_command(extractor)}` puts them in",
            )
        elif stored.feature_set_id != extractor.feature_set_id:
            raise ModelError(
                f"{self.path}: its {extractor.name} features are of {stored.feature_set_id}, "
                f"those asked for are of {extractor.feature_set_id}; "
                f"{_naming_model(stored, extractor)}"
                f"run `{self._repair_command(extractor)}`"
            )
        return stored

    def _repair_command(self, extractor: FeatureExtractor) -> str:
        names = {info.name for info in self.feature_sets} | {extractor.name}
        ordered = ",".join(name for name in FEATURE_NAMES if name in names)
        command = f"vwnav map build {self.path} -o {self.path} --features {ordered}"
        size = model_of(extractor.feature_set_id)
        return command if size in ("", "default") else f"{command} --model {size}"

    def _tile_image(self, tile: Tile) -> MapImage | None:
        with self._lock:
            return self._images.get(tile, partial(self._read_image, tile))

    def _read_image(self, tile: Tile) -> MapImage | None:
        try:
            return read_image(self._connection, tile)
        except DAMAGE as error:
            self._warn_once(tile, f"{self.path}: imagery of {tile} is damaged, unused ({error})")
            return None

    def _tiled_features(
        self, tiles: tuple[Tile, ...], extractor: FeatureExtractor
    ) -> dict[Tile, Features]:
        """Those of each tile that has any."""
        stored, set_id = self.check_features(extractor), extractor.feature_set_id
        found: dict[Tile, Features] = {}
        for tile in tiles:
            with self._lock:
                if stored is None and (set_id, tile) not in self._features:
                    self._extract(block_of(tile), extractor)
                read = partial(self._read_features, tile, stored) if stored else lambda: None
                features = self._features.get((set_id, tile), read)
            if features is not None:
                found[tile] = features
        return found

    def _extract(self, block: Tile, extractor: FeatureExtractor) -> None:
        found = extract_block(partial(self.colour_image, block.zoom), block, extractor)
        for tile in block_tiles(block):
            self._features.put((extractor.feature_set_id, tile), found.get(tile))

    def _read_features(self, tile: Tile, stored: FeatureSetInfo) -> Features | None:
        try:
            return read_features(self._connection, tile, stored)
        except DAMAGE as error:
            self._warn_once(
                (stored.name, tile),
                f"{self.path}: {stored.name} features of {tile} are damaged, unused ({error})",
            )
            return None

    def _warn_once(self, what: object, message: str) -> None:
        if what not in self._warned:
            self._warned.add(what)
            _LOG.warning(message)


def _naming_model(stored: FeatureSetInfo, extractor: FeatureExtractor) -> str:
    size = model_of(stored.feature_set_id)
    return "" if size in ("", model_of(extractor.feature_set_id)) else f"give --model {size}, or "


def _strongest_in(joined: JoinedFeatures, window: Window, count: int) -> Features:
    """Those in a window, relative to it; where they are too many, the first of every tile."""
    shift_px = (joined.corner_px - np.array(window[:2])).astype(np.float32)
    uv = joined.features.uv + shift_px
    corner, (h, w) = uv + np.float32(0.5), window.shape
    inside = (corner >= 0.0).all(axis=1) & (corner < np.array([w, h], np.float32)).all(axis=1)
    kept = np.flatnonzero(inside)
    if len(kept) > count:
        by_tile = np.argsort(joined.owner[kept], kind="stable")
        owner = joined.owner[kept][by_tile]
        rank = np.empty(len(kept), np.int64)
        rank[by_tile] = np.arange(len(kept)) - np.searchsorted(owner, owner)
        kept = kept[np.sort(np.argsort(rank, kind="stable")[:count])]
    return Features(uv[kept], joined.features.descriptors[kept], joined.features.scores[kept])
