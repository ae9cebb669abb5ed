"""The nadir view: one warp that removes tilt, heading and height from a picture."""

import math
from dataclasses import dataclass

import numpy as np

from vwnav.types import Array

MAX_OFF_NADIR_RAD = math.radians(60.0)
_MIN_SHARE = 0.4  # of the picture that must lie within that
_GRID = 33


@dataclass(frozen=True, slots=True, eq=False)
class Rectification:
    """A north-up view straight down onto level ground.

    Attributes:
        H_rect_frame: (3, 3) from undistorted picture pixels to view pixels (u east, v south).
        size_wh: (width, height) of the view in pixels.
        m_per_px: ground resolution of the view.
        nadir_uv: (2,) view pixel of the ground point below the camera, maybe outside the view.
        agl_m: height above ground it was made for.
    """

    H_rect_frame: Array
    size_wh: tuple[int, int]
    m_per_px: float
    nadir_uv: Array
    agl_m: float


def rectification(
    K: Array,
    frame_size_wh: tuple[int, int],
    R_ned_camera: Array,
    agl_m: float,
    m_per_px: float,
    max_size_px: int = 1024,
) -> Rectification | None:
    """The nadir view of an undistorted picture.

    What lies more than 60 degrees off the nadir is cut off. A view larger than `max_size_px` is
    cut about the ground that fills the middle of the picture.

    Args:
        K: (3, 3) of the undistorted camera.
        frame_size_wh: (width, height) of the picture.
        R_ned_camera: (3, 3) attitude of the camera.
        agl_m: height of the camera above the ground.
        m_per_px: wanted ground resolution.
        max_size_px: largest width and height of the view.

    Returns:
        None when the camera does not look down enough, or the numbers make no view.
    """
    if not (_positive(agl_m) and _positive(m_per_px) and np.all(np.isfinite(R_ned_camera))):
        return None
    ground_en = _ground_east_north(K, frame_size_wh, R_ned_camera)
    if len(ground_en) < _MIN_SHARE * _GRID**2:
        return None
    scale = agl_m / m_per_px
    size_wh, corner_px = _window(ground_en * scale, max_size_px)
    # Pixel centres at integers: the corner of the view is at -0.5, -0.5.
    nadir_uv = np.array([-corner_px[0] - 0.5, corner_px[1] - 0.5])
    H_rect_ned = np.array([[0.0, scale, nadir_uv[0]], [-scale, 0.0, nadir_uv[1]], [0.0, 0.0, 1.0]])
    H_rect_frame = H_rect_ned @ R_ned_camera @ np.linalg.inv(K)
    return Rectification(H_rect_frame, size_wh, m_per_px, nadir_uv, agl_m)


def _positive(value: float) -> bool:
    return math.isfinite(value) and value > 0.0


def _ground_east_north(K: Array, size_wh: tuple[int, int], R_ned_camera: Array) -> Array:
    """Ground points (k, 2) of a grid over the picture, in units of AGL, those near enough."""
    u = np.linspace(-0.5, size_wh[0] - 0.5, _GRID)
    v = np.linspace(-0.5, size_wh[1] - 0.5, _GRID)
    uv1 = np.stack([*np.meshgrid(u, v), np.ones((_GRID, _GRID))], axis=-1).reshape(-1, 3)
    rays_ned = uv1 @ np.linalg.inv(K).T @ R_ned_camera.T
    off_nadir = np.arctan2(np.hypot(rays_ned[:, 0], rays_ned[:, 1]), rays_ned[:, 2])
    seen = rays_ned[off_nadir <= MAX_OFF_NADIR_RAD]
    return np.asarray(seen[:, 1::-1] / seen[:, 2:])


def _window(ground_en_px: Array, max_size_px: int) -> tuple[tuple[int, int], Array]:
    """Size (w, h) of the view and its north-west corner (east, north), in pixels from the nadir."""
    low, high = ground_en_px.min(axis=0), ground_en_px.max(axis=0)
    size = np.clip(np.ceil(high - low), 1, max_size_px)
    # The median leans to where the picture has most pixels per metre of ground.
    middle = np.median(ground_en_px, axis=0)
    half = size / 2.0
    middle = np.clip(
        middle, np.minimum(low + half, high - half), np.maximum(low + half, high - half)
    )
    corner = np.array([middle[0] - half[0], middle[1] + half[1]])
    return (int(size[0]), int(size[1])), corner
