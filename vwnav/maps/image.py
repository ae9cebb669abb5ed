"""Pieces of a map: images with a mask, features, and what the localizer reads of it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.geometry.geodesy import Tile, Window
from vwnav.types import FeatureExtractor, Features, Gray

Mask = NDArray[np.bool_]
MIN_VIEW_PX = 112  # of the longer side: a smaller view of a map holds too little to be told apart


@dataclass(frozen=True, slots=True, eq=False)
class MapImage:
    """A piece of map.

    Attributes:
        bgr: (h, w, 3) uint8, zero where there is no data.
        mask: (h, w) bool, true where there is data.
    """

    bgr: NDArray[np.uint8]
    mask: Mask

    def __post_init__(self) -> None:
        if self.bgr.shape != (*self.mask.shape, 3) or self.mask.ndim != 2:
            raise ValueError(
                f"expected bgr (h, w, 3) and mask (h, w), got {self.bgr.shape}, {self.mask.shape}"
            )

    @classmethod
    def empty(cls, shape: tuple[int, int]) -> "MapImage":
        """An image (height, width) without data."""
        return cls(np.zeros((*shape, 3), np.uint8), np.zeros(shape, np.bool_))

    @property
    def gray(self) -> Gray:
        """(h, w) uint8."""
        return np.asarray(cv2.cvtColor(self.bgr, cv2.COLOR_BGR2GRAY), np.uint8)

    def crop(self, window: Window) -> "MapImage":
        """The part in a window of the image's own pixels."""
        part = window_slices(window, 0, 0)
        return MapImage(self.bgr[part], self.mask[part])

    def halved(self) -> "MapImage":
        """Half the size: the mean of each 2 x 2 pixels that have data, where two or more do."""
        h, w = self.mask.shape
        weight = self.mask.reshape(h // 2, 2, w // 2, 2).sum(axis=(1, 3))
        masked = np.where(self.mask[..., None], self.bgr, 0)
        total = masked.reshape(h // 2, 2, w // 2, 2, 3).sum(axis=(1, 3), dtype=np.uint16)
        mask = weight >= 2
        mean = (total + weight[..., None] // 2) // np.maximum(weight, 1)[..., None]
        return MapImage(np.where(mask[..., None], mean, 0).astype(np.uint8), mask)


@dataclass(frozen=True, slots=True, eq=False)
class JoinedFeatures:
    """The features of some tiles, strongest first.

    Attributes:
        features: uv from the corner of the first tile.
        owner: (n,) number of the tile of each.
        corner_px: (2,) of the first tile, global pixels.
    """

    features: Features
    owner: NDArray[np.int64]
    corner_px: NDArray[np.int64]


def join(tiles: dict[Tile, Features]) -> JoinedFeatures | None:
    """All features of some tiles; None where they have none."""
    if not tiles:
        return None
    found = list(tiles.values())
    corner_px = np.array(next(iter(tiles)).window[:2], np.int64)
    sizes = [len(features) for features in found]
    shift_px = np.array([tile.window[:2] for tile in tiles]) - corner_px
    uv = np.concatenate([features.uv for features in found])
    uv = uv + np.repeat(shift_px.astype(np.float32), sizes, axis=0)
    scores = np.concatenate([features.scores for features in found])
    descriptors = np.concatenate([features.descriptors for features in found])
    order = np.argsort(-scores, kind="stable")
    owner = np.repeat(np.arange(len(sizes)), sizes)
    return JoinedFeatures(
        Features(uv[order], descriptors[order], scores[order]), owner[order], corner_px
    )


def assemble(zoom: int, window: Window, fetch: Callable[[Tile], MapImage | None]) -> MapImage:
    """Put the tiles under a window together; a tile that is None has no data."""
    out = MapImage.empty(window.shape)
    for tile in window.tiles(zoom):
        image = fetch(tile)
        if image is None:
            continue
        part = tile.window.clipped(window)
        into = window_slices(part, window.x0, window.y0)
        out_of = window_slices(part, tile.window.x0, tile.window.y0)
        out.bgr[into] = image.bgr[out_of]
        out.mask[into] = image.mask[out_of]
    return out


def window_slices(window: Window, x0: int, y0: int) -> tuple[slice, slice]:
    """(rows, columns) of a window in an array whose first pixel is (x0, y0)."""
    return slice(window.y0 - y0, window.y1 - y0), slice(window.x0 - x0, window.x1 - x0)


@dataclass(frozen=True, slots=True)
class Level:
    """A zoom level, and its metres per pixel at the middle of the map."""

    zoom: int
    m_per_px: float


@dataclass(frozen=True, slots=True, eq=False)
class MapFeatures:
    """Features of a window of the map.

    Attributes:
        zoom: their level.
        origin_px: (2,) int64, global pixel (corner convention) that `features.uv` counts from:
            the global position of a keypoint is `origin_px + uv + 0.5`.
        features: centre convention as everywhere.
    """

    zoom: int
    origin_px: NDArray[np.int64]
    features: Features


class MapReader(Protocol):
    """What the localizer needs of `vwnav.maps.pack.MapPack`, whose docstrings say more."""

    name: str
    levels: tuple[Level, ...]
    georeference_sigma_m: float

    def window(self, zoom: int) -> Window:
        """The rectangle of a level's tiles in its global pixels."""
        ...

    def image(self, zoom: int, x0: int, y0: int, x1: int, y1: int) -> tuple[Gray, Mask]:
        """The gray image (h, w) of a window of global pixels, and where it has data."""
        ...

    def features_in(
        self, zoom: int, x0: int, y0: int, x1: int, y1: int, extractor: FeatureExtractor
    ) -> MapFeatures:
        """Map features inside a window of global pixels."""
        ...
