"""Features of the tiles of a map: none doubled or lost at a border, none near missing data."""

from collections.abc import Callable, Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.geometry.geodesy import TILE_PX, Tile, Window
from vwnav.maps.image import MapImage, Mask
from vwnav.types import FeatureExtractor, Features, Gray

KEYPOINTS_PER_TILE = 400  # some 700 under a view of 450 x 250 px, against its own 1000
BLOCK_TILES = 2  # tiles are extracted in blocks of 2 x 2, aligned to even tile numbers
MARGIN_PX = 64  # extracted around a block, so that its borders see their surroundings
NODATA_RADIUS_PX = 16  # a descriptor's radius
_CELLS = 4  # keypoints are spread over 4 x 4 cells of a tile
_OVERSAMPLING = 3  # candidates per keypoint kept

ImageReader = Callable[[Window], MapImage]


def block_of(tile: Tile) -> Tile:
    """The first tile of the block that a tile belongs to."""
    return Tile(tile.zoom, tile.x - tile.x % BLOCK_TILES, tile.y - tile.y % BLOCK_TILES)


def block_tiles(block: Tile) -> Iterator[Tile]:
    """The tiles of a block."""
    for dy in range(BLOCK_TILES):
        for dx in range(BLOCK_TILES):
            yield Tile(block.zoom, block.x + dx, block.y + dy)


def extract_block(
    read: ImageReader, block: Tile, extractor: FeatureExtractor
) -> dict[Tile, Features]:
    """Extract the features of a block's tiles.

    Args:
        read: gives the image of a window of global pixels of the block's level.
        block: its first tile.
        extractor: is given one gray image, the block with its margin.

    Returns:
        For each tile features relative to it, strongest first, at most `KEYPOINTS_PER_TILE`, spread
        over the tile.
    """
    window = Window(*block.window[:2], *Tile(*_last(block)).window[2:]).grown(MARGIN_PX)
    image = read(window)
    usable = usable_mask(image.mask)
    if not usable[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX].any():
        return {}
    found = usable_features(image, extractor, KEYPOINTS_PER_TILE * BLOCK_TILES**2 * _OVERSAMPLING)
    return {
        tile: _in_tile(found, tile.window.x0 - window.x0, tile.window.y0 - window.y0)
        for tile in block_tiles(block)
    }


def usable_features(image: MapImage, extractor: FeatureExtractor, count: int) -> Features:
    """The features of a piece of map, at most `count`, none near missing data."""
    found = extractor.extract(filled_gray(image), count)
    return _chosen(found, _at(usable_mask(image.mask), found.uv))


def usable_mask(mask: Mask) -> Mask:
    """Where keypoints may lie: a descriptor's radius away from missing data.

    The image's own edge counts as data: its margin is cut away afterwards.
    """
    side = 2 * NODATA_RADIUS_PX + 1
    kernel = np.ones((side, side), np.uint8)
    eroded = cv2.erode(mask.astype(np.uint8), kernel)
    return np.asarray(eroded > 0)


def filled_gray(image: MapImage) -> Gray:
    """The gray image with missing data at its mean: the weakest edge that a filling can have."""
    gray = image.gray
    if image.mask.any() and not image.mask.all():
        gray[~image.mask] = round(float(gray[image.mask].mean()))
    return gray


def _last(block: Tile) -> tuple[int, int, int]:
    return block.zoom, block.x + BLOCK_TILES - 1, block.y + BLOCK_TILES - 1


def _at(usable: Mask, uv: NDArray[np.float32]) -> Mask:
    h, w = usable.shape
    columns = np.clip(np.round(uv[:, 0]).astype(np.int64), 0, w - 1)
    rows = np.clip(np.round(uv[:, 1]).astype(np.int64), 0, h - 1)
    return np.asarray(usable[rows, columns])


def _chosen(features: Features, index: NDArray[np.int64] | Mask) -> Features:
    return Features(features.uv[index], features.descriptors[index], features.scores[index])


def _in_tile(found: Features, u0: int, v0: int) -> Features:
    corner = found.uv + np.float32(0.5) - np.array([u0, v0], np.float32)
    inside = np.asarray(((corner >= 0.0) & (corner < TILE_PX)).all(axis=1))
    mine = _chosen(found, inside)
    local = Features(corner[inside] - np.float32(0.5), mine.descriptors, mine.scores)
    return _chosen(local, spread(local, KEYPOINTS_PER_TILE))


def spread(features: Features, count: int) -> NDArray[np.int64]:
    """Choose keypoints of a tile: an equal share of the strongest of each cell, then the rest.

    Returns:
        (min(n, count),) indices, strongest first.
    """
    order = np.argsort(-features.scores, kind="stable")
    cells = np.clip((features.uv[order] + 0.5) * _CELLS / TILE_PX, 0, _CELLS - 1).astype(np.int64)
    cell = cells[:, 0] + _CELLS * cells[:, 1]
    rank = np.zeros(len(order), np.int64)
    for index in range(_CELLS**2):
        here = cell == index
        rank[here] = np.arange(np.count_nonzero(here))
    share = -(-count // _CELLS**2)
    chosen = np.argsort(rank >= share, kind="stable")[:count]
    return order[np.sort(chosen)]
