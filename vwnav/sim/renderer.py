"""What the camera under the aircraft sees of a generated site."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.geometry.camera import Camera
from vwnav.geometry.rotations import rotation_from_vector
from vwnav.sim.lens import RenderConfig, Sensor
from vwnav.sim.rays import (
    MIN_DOWN,
    Region,
    around,
    between_nodes,
    ground_map,
    intersections,
    move_to_map,
    raise_to,
    ray_nodes,
)
from vwnav.sim.tiles import (
    LEVELS_M_PER_PX,
    TILE_PX,
    DrawnGround,
    Key,
    Tile,
    TileStore,
    tile_span_m,
)
from vwnav.types import Array

_MIN_HEIGHT_M = 0.15
_MAX_TILES = 48
_AHEAD_S = (1.5, 3.0)
_HOME_DISCS = ((0, 22.0), (1, 42.0), (2, 80.0), (4, 150.0))  # level, radius in metres
_ROW_STEP_S = 0.005  # either way, to see how the image moves while it is read
_MOST_SIGMAS = 4.0  # of a map's error
_HAZE = (205.0, 200.0, 190.0)


def default_camera() -> Camera:
    """640 x 480, 80 degrees across, with the mild barrel distortion of a small lens."""
    return replace(
        Camera.from_hfov(640, 480, 80.0), distortion=(-0.11, 0.025, 0.0004, -0.0003, 0.0),
        sigma_mount_rad=math.radians(0.2), sigma_focal_ratio=0.001,
    )  # fmt: skip


class CameraRenderer:
    """Renders images of a site's flight look, one per exposure.

    Ground through the site's origin. The same seed and the same calls give the same images as long
    as tiles do not come from the background thread (`config.background`).
    """

    def __init__(
        self,
        site: DrawnGround,
        camera: Camera,
        config: RenderConfig,
        rng: np.random.Generator,
        tiles_folder: Path | None = None,
    ) -> None:
        """`tiles_folder` keeps drawn tiles. The camera's read-out, where it has one."""
        if camera.readout_s is not None:
            config = replace(config, readout_s=camera.readout_s)
        self._camera, self._config, self._rng = camera, config, rng
        self._tiles = TileStore(site, tiles_folder)
        self._sensor = Sensor(camera, config, rng)
        nodes = ray_nodes(camera.width_px, camera.height_px)
        rays = camera.bearings(nodes.reshape(-1, 2))
        self._rays = (rays[:, :2] / rays[:, 2:]).astype(np.float32).reshape(nodes.shape)
        self._rows_s = self._sensor.row_times_s(nodes[:, 0, 1])
        edge = np.ones(nodes.shape[:2], bool)
        edge[1:-1, 1:-1] = False
        rim = self._rays[edge][::4]
        self._rim = np.column_stack([rim, np.ones(len(rim))])
        self._mosaic: tuple[Region, Tile] | None = None
        self._canvas = np.empty(0, np.uint8)  # what mosaics are laid out in, one after the other

    def prepare(
        self,
        route_ned_m: Sequence[Array] | Array,
        progress: Callable[[float], None] | None = None,
        half_width_m: float = 70.0,
        home: bool = True,
    ) -> None:
        """Draw now what a flight along a route (n, 3) will see, home first.

        Args:
            route_ned_m: corners of the route, at their heights.
            progress: told the fraction that is done.
            half_width_m: of the corridor on each side of the route.
            home: also draw home as it is seen from low down, for take-off and landing.
        """
        route = np.asarray(route_ned_m, np.float64).reshape(-1, 3)
        keys: dict[Key, None] = {}
        for level, radius_m in _HOME_DISCS if home else ():
            keys |= dict.fromkeys(_disc(level, np.zeros(2), radius_m))
        level = self._level(float(np.median(-route[:, 2])))
        for point in _walk(route[:, :2], half_width_m / 2.0):
            keys |= dict.fromkeys(_disc(level, point, half_width_m))
            keys |= dict.fromkeys(_disc(4, point, 2.0 * half_width_m))
        for done, key in enumerate(keys):
            self._tiles.make(key)
            if progress is not None:
                progress((done + 1) / len(keys))

    def render(
        self,
        position_ned_m: Array,
        R_ned_body: Array,
        t_s: float,
        velocity_ned_m_s: Array,
        rate_body_rad_s: Array,
    ) -> NDArray[np.uint8]:
        """The image exposed at `t_s`, middle row: (h, w, 3) BGR, or (h, w) of a grey camera.

        Args:
            position_ned_m: (3,) of the body in the site's frame.
            R_ned_body: (3, 3).
            t_s: time of exposure; light and exposure change with it.
            velocity_ned_m_s: (3,), for motion blur and the rolling shutter.
            rate_body_rad_s: (3,) turn rate about the body's axes, likewise.
        """
        camera = self._camera
        shake = rotation_from_vector(self._rng.normal(0.0, self._config.vibration_rad, 3))
        R_ned_camera = R_ned_body @ shake @ camera.R_body_camera
        velocity_ned_m_s = velocity_ned_m_s + R_ned_body @ np.cross(
            rate_body_rad_s, camera.t_body_camera_m
        )
        sheared = np.eye(3)  # along down, so that a slope is level
        sheared[2, :2] = self._config.relief.slope_ne
        centre = sheared @ (position_ned_m + R_ned_body @ camera.t_body_camera_m)
        height_m = max(-float(centre[2]), _MIN_HEIGHT_M)
        flow = self._flow_px_s(R_ned_camera, height_m, velocity_ned_m_s, rate_body_rad_s)
        R_ned_camera, velocity_ned_m_s = sheared @ R_ned_camera, sheared @ velocity_ned_m_s
        rays = self._sensor.shaken(self._rays, t_s + self._rows_s)
        region = self._region(R_ned_camera, centre, height_m)
        mosaic = self._assemble(region)
        if self._config.background:
            self._look_ahead(centre, velocity_ned_m_s)
        on_block = ground_map(R_ned_camera, centre, height_m, region)
        turned = camera.R_body_camera.T @ rate_body_rad_s
        a_second = self._block_map_a_second(R_ned_camera, centre, velocity_ned_m_s, turned, region)
        rows_s = self._rows_s if self._config.readout_s > 0.0 else None
        where = intersections(rays, on_block, a_second, rows_s)
        if not self._config.relief.plane:
            raise_to(self._config.relief, where, centre, height_m, region)
        if self._config.map_warp.sigma_m:
            move_to_map(self._config.map_warp, where, region)
        plain = _sampled(mosaic, between_nodes(where, camera.width_px, camera.height_px))
        return self._sensor.expose(plain, flow, t_s)

    @property
    def tiles_in_memory(self) -> int:
        """How many tiles are ready."""
        return len(self._tiles)

    def wait_until_drawn(self, timeout_s: float) -> bool:
        """Wait for the background thread to have drawn what was asked of it."""
        return self._tiles.wait_until_idle(timeout_s)

    def close(self) -> None:
        """Stop drawing in the background."""
        self._tiles.close()

    def _level(self, height_m: float) -> int:
        footprint = max(height_m, _MIN_HEIGHT_M) / float(self._camera.K[0, 0])
        return int(np.argmin(np.abs(np.log(np.array(LEVELS_M_PER_PX) / footprint))))

    def _flow_px_s(
        self, R_ned_camera: Array, height_m: float, velocity_ned: Array, rate_body: Array
    ) -> Array:
        """Speed (2,) at which the ground moves through the image's centre."""
        depth_m = height_m / max(float(R_ned_camera[2, 2]), MIN_DOWN)
        v = R_ned_camera.T @ velocity_ned
        w = self._camera.R_body_camera.T @ rate_body
        # A point X at rest moves by dX/dt = -v - w x X in the camera; here X = (0, 0, depth).
        direction = np.array([-v[0] / depth_m - w[1], -v[1] / depth_m + w[0]])
        return np.asarray(direction * self._camera.K[[0, 1], [0, 1]])

    def _block_map_a_second(
        self, R_ned_camera: Array, centre: Array, velocity_ned: Array, turned: Array, region: Region
    ) -> Array:
        """How the homography (3, 3) of `ground_map` changes from row to row, per second.

        Linear in time: within a read-out of 20 ms at 60 degrees a second that is 0.02 px off.
        """
        maps = []
        for t_s in (-_ROW_STEP_S, _ROW_STEP_S):
            R = R_ned_camera @ rotation_from_vector(t_s * turned)
            at = centre + t_s * velocity_ned
            maps.append(ground_map(R, at, max(-float(at[2]), _MIN_HEIGHT_M), region))
        return np.asarray((maps[1] - maps[0]) / (2.0 * _ROW_STEP_S))

    def _region(self, R_ned_camera: Array, centre: Array, height_m: float) -> Region:
        """The tiles under the image, at the level whose pixels are like the image's own."""
        rays_ned = self._rim @ R_ned_camera.T
        down = np.maximum(rays_ned[:, 2:], MIN_DOWN)
        deep_m = 2.5 * self._config.relief.hills_m
        ground = centre[:2] + (height_m + deep_m) * rays_ned[:, :2] / down
        beside_m = _MOST_SIGMAS * self._config.map_warp.sigma_m
        ground = np.vstack([ground - beside_m, ground + beside_m])
        slant_m = height_m / max(float(R_ned_camera[2, 2]), 0.3)
        last = len(LEVELS_M_PER_PX) - 1
        for level in range(self._level(slant_m), last):
            region = around(level, ground)
            if region.count <= _MAX_TILES:
                return region
        return around(last, ground)

    def _assemble(self, region: Region) -> Tile:
        """The block as one image; kept while it serves and all of it was really drawn."""
        if self._mosaic is not None and self._mosaic[0] == region:
            return self._mosaic[1]
        self._mosaic, whole = None, True
        mosaic = self._blank(region)
        for key in region.tiles():
            tile = self._tiles.get(key)
            if tile is None:
                tile = self._stand_in(key) if self._config.background else self._tiles.make(key)
                whole = whole and not self._config.background
            v, u = (key[1] - region.row0) * TILE_PX, (key[2] - region.col0) * TILE_PX
            mosaic[v : v + TILE_PX, u : u + TILE_PX] = tile
        self._mosaic = (region, mosaic) if whole else None
        return mosaic

    def _blank(self, region: Region) -> Tile:
        """Memory for a block, where the last one was: new ones of ever other sizes leave holes."""
        rows, cols = region.row1 - region.row0, region.col1 - region.col0
        shape = (rows * TILE_PX, cols * TILE_PX, 3)
        if self._canvas.size < math.prod(shape):
            self._canvas = np.empty(math.prod(shape), np.uint8)
        return self._canvas[: math.prod(shape)].reshape(shape)

    def _stand_in(self, key: Key) -> Tile:
        """A coarser drawing of a tile that is still being made in the background."""
        self._tiles.request([key])
        level, row, col = key
        above = [
            (level + up, row // 2**up, col // 2**up)
            for up in range(1, len(LEVELS_M_PER_PX) - level)
        ]
        if not above:
            return self._tiles.make(key)
        ready = [k for k in above if self._tiles.get(k) is not None]
        coarse_key = ready[0] if ready else above[min(1, len(above) - 1)]
        coarse, n = self._tiles.make(coarse_key), 2 ** (coarse_key[0] - level)
        v, u = (row % n) * TILE_PX // n, (col % n) * TILE_PX // n
        part = coarse[v : v + TILE_PX // n, u : u + TILE_PX // n]
        size = (TILE_PX, TILE_PX)
        return np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_CUBIC), np.uint8)

    def _look_ahead(self, centre: Array, velocity_ned: Array) -> None:
        """Ask for the tiles that will be under the image in a few seconds; nearest come first."""
        for ahead_s in reversed(_AHEAD_S):
            there = centre + ahead_s * velocity_ned
            height_m = max(-float(there[2]), _MIN_HEIGHT_M)
            radius_m = height_m * float(np.linalg.norm(self._rim[:, :2], axis=1).max())
            self._tiles.request(_disc(self._level(height_m), there[:2], radius_m))


def _sampled(mosaic: Tile, where: NDArray[np.float32]) -> NDArray[np.uint8]:
    """The image (h, w, 3) of pixels (h, w, 2) of the block."""
    return np.asarray(
        cv2.remap(  # type: ignore[call-overload]  # its stubs do not know of a single map
            mosaic,
            where,
            None,
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=_HAZE,
        ),
        np.uint8,
    )


def _disc(level: int, centre_ne: Array, radius_m: float) -> list[Key]:
    """Tiles of a level that touch a disc."""
    span_m = tile_span_m(level)
    rows = range(
        int(np.floor((-centre_ne[0] - radius_m) / span_m)),
        int(np.floor((-centre_ne[0] + radius_m) / span_m)) + 1,
    )
    cols = range(
        int(np.floor((centre_ne[1] - radius_m) / span_m)),
        int(np.floor((centre_ne[1] + radius_m) / span_m)) + 1,
    )
    return [
        (level, row, col)
        for row in rows
        for col in cols
        if np.hypot(
            max(abs(-(row + 0.5) * span_m - centre_ne[0]) - span_m / 2.0, 0.0),
            max(abs((col + 0.5) * span_m - centre_ne[1]) - span_m / 2.0, 0.0),
        )
        <= radius_m
    ]


def _walk(points: Array, step_m: float) -> Array:
    """Points (m, 2) along a line (n, 2), at most `step_m` apart."""
    legs = [
        np.linspace(a, b, max(2, int(np.hypot(*(b - a)) / step_m) + 2)) for a, b in pairwise(points)
    ]
    return np.concatenate(legs) if legs else points
