"""A camera above level ground with a map of it: the geometry of images, without images."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from vwnav.geometry.camera import Camera
from vwnav.geometry.geodesy import mercator_px, mercator_px_per_m
from vwnav.geometry.rotations import rotation_from_euler
from vwnav.types import Array

LAT_DEG, LON_DEG, ZOOM = 33.6, 73.1, 19


@dataclass(frozen=True, eq=False)
class Shot:
    """What one image sees: pixels of ground points, and the same points on the map."""

    camera: Camera
    R_ned_camera: Array
    agl_m: float
    nadir_px: Array
    px_per_m: tuple[float, float]
    uv: Array
    map_px: Array


def shoot(
    rng: np.random.Generator,
    *,
    agl_m: float = 50.0,
    tilt_rad: float = 0.15,
    yaw_rad: float | None = None,
    points: int = 80,
) -> Shot:
    """Pixels spread over the image of a camera with random attitude, followed to the map."""
    camera = Camera.from_hfov(640, 480, 70.0)
    yaw_rad = rng.uniform(-np.pi, np.pi) if yaw_rad is None else yaw_rad
    roll_rad, pitch_rad = rng.uniform(-tilt_rad, tilt_rad, 2)
    R_ned_camera = rotation_from_euler(roll_rad, pitch_rad, yaw_rad) @ camera.R_body_camera
    uv = rng.uniform((0.0, 0.0), (639.0, 479.0), (points, 2))
    rays_ned = camera.bearings(uv) @ R_ned_camera.T
    ground_ne_m = rays_ned[:, :2] / rays_ned[:, 2:] * agl_m
    px_per_m = mercator_px_per_m(LAT_DEG, ZOOM)
    nadir_px = np.array(mercator_px(LAT_DEG, LON_DEG, ZOOM))
    map_px = nadir_px + ground_ne_m[:, ::-1] * [px_per_m[0], -px_per_m[1]]
    return Shot(camera, R_ned_camera, agl_m, nadir_px, px_per_m, uv, map_px)


@pytest.fixture(scope="session")
def shot_of() -> Callable[..., Shot]:
    """The function that makes a `Shot`."""
    return shoot
