"""Where the rays of an image meet the ground, which lies in blocks of tiles."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.sim.map_warp import MapWarp
from vwnav.sim.relief import Relief
from vwnav.sim.tiles import LEVELS_M_PER_PX, Key, tile_span_m
from vwnav.types import Array

MIN_DOWN = 0.12  # rays flatter than this (7 degrees below the horizon) see only haze
_HAZE_PX = -1e4
_RELIEF_STEPS = 5
# Rays meet the ground so far apart. A tilted image of level ground is 2 grey levels off at most,
# one of woods, with their steep edges, 0.9 on average.
_NODE_PX = 4


@dataclass(frozen=True, slots=True)
class Region:
    """A block of tiles of one level: rows and columns, half open."""

    level: int
    row0: int
    row1: int
    col0: int
    col1: int

    @property
    def count(self) -> int:
        """How many tiles the block has."""
        return (self.row1 - self.row0) * (self.col1 - self.col0)

    def tiles(self) -> list[Key]:
        """The tiles of the block, row by row."""
        return [
            (self.level, row, col)
            for row in range(self.row0, self.row1)
            for col in range(self.col0, self.col1)
        ]


def around(level: int, ground_ne: Array) -> Region:
    """The block of tiles that covers points (n, 2)."""
    span_m = tile_span_m(level)
    south, west = ground_ne.min(axis=0) / span_m
    north, east = ground_ne.max(axis=0) / span_m
    row0, row1, col0, col1 = (math.floor(x) for x in (-north, -south, west, east))
    return Region(level, row0, row1 + 1, col0, col1 + 1)


def ground_map(R_ned_camera: Array, centre: Array, height_m: float, region: Region) -> Array:
    """Homography (3, 3) from normalised camera rays (x, y, 1) to pixels of the block."""
    r, span_m = LEVELS_M_PER_PX[region.level], tile_span_m(region.level)
    u0 = (float(centre[1]) - region.col0 * span_m) / r - 0.5
    v0 = (-region.row0 * span_m - float(centre[0])) / r - 0.5
    north, east, down = R_ned_camera
    scale = height_m / r
    return np.array([scale * east + u0 * down, -scale * north + v0 * down, down])


def ray_nodes(width_px: int, height_px: int) -> Array:
    """Places (n, m, 2) in the image at which rays are met with the ground, rims beyond its own."""
    u, v = (
        _NODE_PX * (np.arange(-(-px // _NODE_PX) + 2) - 0.5) - 0.5 for px in (width_px, height_px)
    )
    return np.stack(np.meshgrid(u, v), axis=-1)


def between_nodes(where: NDArray[np.float32], width_px: int, height_px: int) -> NDArray[np.float32]:
    """What stands at the nodes (n, m, 2), at every pixel (h, w, 2): linear between them."""
    rows, cols = where.shape[:2]
    every = cv2.resize(where, (_NODE_PX * cols, _NODE_PX * rows), interpolation=cv2.INTER_LINEAR)
    part = every[_NODE_PX : _NODE_PX + height_px, _NODE_PX : _NODE_PX + width_px]
    return np.ascontiguousarray(part, np.float32)


def intersections(
    rays: NDArray[np.float32], H_block_ray: Array, a_second: Array, rows_s: Array | None
) -> NDArray[np.float32]:
    """Pixels of the block (h, w, 2) that the rays meet, far away where they meet only haze.

    With `rows_s` each row at its own time (rolling shutter).
    """
    seen = np.asarray(cv2.transform(rays, H_block_ray), np.float32)
    if rows_s is not None:
        late = np.asarray(cv2.transform(rays, a_second), np.float32)
        seen += late * rows_s[:, None, None].astype(np.float32)
    down = seen[..., 2]
    where = seen[..., :2] / np.maximum(down, 1e-6)[..., None]
    if float(down.min()) < MIN_DOWN:
        where[down < MIN_DOWN] = _HAZE_PX
    return np.asarray(where, np.float32)


def raise_to(
    relief: Relief, where: NDArray[np.float32], centre: Array, height_m: float, region: Region
) -> None:
    """Move the pixels (h, w, 2) of the block that rays meet on the slope to those on the relief.

    A ray that meets the slope at p0 meets height h at c + (p0 - c) (H - h) / H, under a camera
    at c in height H: by fixed-point iteration, which leaves it open what is seen of faces
    that are steeper than the ray.
    """
    r = LEVELS_M_PER_PX[region.level]
    north_m, west_m = _corner_m(region)
    below = np.array([(centre[1] - west_m) / r, (north_m - centre[0]) / r], np.float32)
    seen = where[..., 0] > _HAZE_PX
    on_slope = where - below
    for _ in range(_RELIEF_STEPS):
        east, north = west_m + where[..., 0] * r, north_m - where[..., 1] * r
        share = 1.0 - relief.on_slope_m(north, east) / np.float32(height_m)
        np.copyto(where, below + share[..., None] * on_slope, where=seen[..., None])


def move_to_map(error: MapWarp, where: NDArray[np.float32], region: Region) -> None:
    """Move the pixels (h, w, 2) of the block to those that the map shows there."""
    r = np.float32(LEVELS_M_PER_PX[region.level])
    north_m, west_m = _corner_m(region)
    off_m = error.at_m(north_m - where[..., 1] * r, west_m + where[..., 0] * r)
    where += off_m[..., ::-1] * np.array([1.0, -1.0], np.float32) / r


def _corner_m(region: Region) -> tuple[np.float32, np.float32]:
    """North and east of the middle of a block's first pixel."""
    r, span_m = LEVELS_M_PER_PX[region.level], tile_span_m(region.level)
    return np.float32(-region.row0 * span_m - 0.5 * r), np.float32(region.col0 * span_m + 0.5 * r)
