"""Tiles of the ground: drawn once, kept in memory, and on disk where wanted."""

import logging
import os
import tempfile
import threading
from collections import OrderedDict
from collections.abc import Iterable
from pathlib import Path
from typing import Literal, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

LEVELS_M_PER_PX = (0.025, 0.05, 0.1, 0.2, 0.4, 0.8)
TILE_PX = 256
_MEMORY_TILES = 6000  # of 192 KiB each: 1.2 GB at most
_log = logging.getLogger(__name__)
Tile = NDArray[np.uint8]
Key = tuple[int, int, int]  # level, row towards south, column towards east


def tile_span_m(level: int) -> float:
    """Side of a tile on the ground."""
    return TILE_PX * LEVELS_M_PER_PX[level]


class DrawnGround(Protocol):
    """Ground that can be drawn: what is asked of a `vwnav.sim.site.Site`."""

    def render(
        self,
        look: Literal["flight"],
        north0_m: float,
        east0_m: float,
        size: tuple[int, int],
        m_per_px: float,
    ) -> NDArray[np.uint8]:
        """Draw a north-up window (height, width, 3) of it."""
        ...


class TileStore:
    """The flight look as a pyramid of tiles; safe to use from several threads."""

    def __init__(self, site: DrawnGround, folder: Path | None = None) -> None:
        """`folder` keeps tiles of this ground alone; None: in memory only."""
        self._site = site
        self._folder = folder
        self._tiles: OrderedDict[Key, Tile] = OrderedDict()
        self._lock = threading.Lock()
        self._wanted: OrderedDict[Key, None] = OrderedDict()
        self._wake = threading.Condition(self._lock)
        self._worker: threading.Thread | None = None
        self._closed = False
        self._busy = False

    def __len__(self) -> int:
        """How many tiles are in memory."""
        with self._lock:
            return len(self._tiles)

    def get(self, key: Key) -> Tile | None:
        """A tile (256, 256, 3) that is in memory."""
        with self._lock:
            tile = self._tiles.get(key)
            if tile is not None:
                self._tiles.move_to_end(key)
            return tile

    def make(self, key: Key) -> Tile:
        """A tile from memory, disk, or drawn now (tens of milliseconds)."""
        tile = self.get(key)
        if tile is None:
            tile = self._load(key)
            if tile is None:
                tile = self._draw(key)
                self._save(key, tile)
            with self._lock:
                self._tiles[key] = tile
                while len(self._tiles) > _MEMORY_TILES:
                    self._tiles.popitem(last=False)
        return tile

    def request(self, keys: Iterable[Key]) -> None:
        """Have tiles drawn in the background; what was asked for last comes first."""
        with self._wake:
            for key in keys:
                if key not in self._tiles:
                    self._wanted[key] = None
                    self._wanted.move_to_end(key)
            if self._wanted and self._worker is None and not self._closed:
                self._worker = threading.Thread(target=self._work, name="tiles", daemon=True)
                self._worker.start()
            self._wake.notify_all()

    def wait_until_idle(self, timeout_s: float) -> bool:
        """Wait until every requested tile is in memory; False when the time is up first."""
        with self._wake:
            return self._wake.wait_for(lambda: not self._wanted and not self._busy, timeout_s)

    def close(self) -> None:
        """Stop the background thread and wait for it."""
        with self._wake:
            self._closed = True
            self._wake.notify_all()
            worker = self._worker
        if worker is not None:
            worker.join()

    def _work(self) -> None:
        while True:
            with self._wake:
                while not self._wanted and not self._closed:
                    self._wake.wait()
                if self._closed:
                    return
                key, _ = self._wanted.popitem(last=True)
                self._busy = True
            self.make(key)
            with self._wake:
                self._busy = False
                self._wake.notify_all()

    def _draw(self, key: Key) -> Tile:
        level, row, col = key
        span_m = tile_span_m(level)
        size = (TILE_PX, TILE_PX)
        m_per_px = LEVELS_M_PER_PX[level]
        return self._site.render("flight", -row * span_m, col * span_m, size, m_per_px)

    def _path(self, key: Key) -> Path | None:
        level, row, col = key
        return self._folder / f"{level}" / f"{row}_{col}.png" if self._folder else None

    def _load(self, key: Key) -> Tile | None:
        path = self._path(key)
        if path is None or not path.exists():
            return None
        tile = cv2.imread(str(path), cv2.IMREAD_COLOR)
        if tile is None or tile.shape != (TILE_PX, TILE_PX, 3):
            _log.warning("ignoring the damaged tile %s", path)
            return None
        return np.asarray(tile, np.uint8)

    def _save(self, key: Key, tile: Tile) -> None:
        """Write under another name and rename, so that a reader never sees half a tile."""
        path = self._path(key)
        if path is None:
            return
        code = cv2.imencode(".png", tile, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1]
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as part:
                part.write(code.tobytes())
            os.replace(part.name, path)
        except OSError as error:
            _log.warning("not keeping tiles on disk: %s", error)
            self._folder = None
