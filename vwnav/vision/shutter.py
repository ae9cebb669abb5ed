"""Rolling shutter: rows are exposed one after the other, while the camera turns and moves on.

A point of level ground that is seen in direction d while the middle row is exposed is seen a time t
later, for small angles, at

    d - t A d,  A = [w]x + v n^T / h

in camera axes, with the camera's turn rate w, its velocity v, the vertical n, and its height h
above the ground. Within a read-out of 20 ms at 60 degrees a second the squares that are left out
are 0.02 px.
"""

import numpy as np
from numpy.typing import NDArray

from vwnav.geometry.camera import Camera
from vwnav.geometry.rotations import skew
from vwnav.types import Array, Frame

Pixels = Array | NDArray[np.float32]
LEAST_SHIFT_PX = 0.25  # of the first and the last row; less is left as it is
_ROUNDS = 2  # until the row that a point is seen in stands


def ray_flow(frame: Frame, camera: Camera, down_camera: Array, height_m: float) -> Array | None:
    """A (3, 3), per second; None where it is not known, or moves nothing by a visible amount.

    Args:
        frame: with the body's motion.
        camera: with its mount and read-out.
        down_camera: (3,) the vertical n.
        height_m: of the camera above ground.
    """
    if not camera.readout_s or frame.rates_rad_s is None or frame.velocity_body_m_s is None:
        return None
    if not height_m > 0.0:
        return None
    swung_m_s = np.cross(frame.rates_rad_s, camera.t_body_camera_m)
    velocity = camera.R_body_camera.T @ (frame.velocity_body_m_s + swung_m_s)
    turning = skew(camera.R_body_camera.T @ frame.rates_rad_s)
    A = turning + np.outer(velocity, down_camera) / height_m
    edges = camera.bearings(_first_and_last_row(camera))
    edges = edges / edges[:, 2:]
    moving = edges @ A.T
    slopes = moving[:, :2] - edges[:, :2] * moving[:, 2:]  # of x / z and y / z, per second
    shift_px = 0.5 * camera.readout_s * camera.K[0, 0] * np.abs(slopes)
    return A if shift_px.max() > LEAST_SHIFT_PX else None


def as_at_once(rays: Array, uv: Pixels, camera: Camera, flow: Array) -> Array:
    """Directions (n, 3) as a global shutter would have seen what was seen at pixels uv (n, 2)."""
    return np.asarray(rays + row_times_s(uv, camera)[:, None] * (rays @ flow.T))


def row_times_s(uv: Pixels, camera: Camera) -> Array:
    """(n,) when the rows of pixels (n, 2) are exposed, after the middle of the image."""
    assert camera.readout_s is not None
    return np.asarray(((uv[:, 1] + 0.5) / camera.height_px - 0.5) * camera.readout_s)


def seen_by_rows(rays: Array, camera: Camera, flow: Array) -> Array:
    """Pixels (n, 2) at which rows show what a global shutter would see in directions (n, 3).

    Args:
        rays: of any length, in camera axes at the middle row's moment.
        camera: as it takes images.
        flow: A, from `ray_flow`.
    """
    seen = camera.project(rays)
    for _ in range(_ROUNDS):
        seen = camera.project(rays - row_times_s(seen, camera)[:, None] * (rays @ flow.T))
    return seen


def _first_and_last_row(camera: Camera) -> Array:
    """Pixels (6, 2): their ends and middles, which a rolling shutter shifts most."""
    u = np.linspace(0.0, camera.width_px - 1.0, 3)
    v = np.array([0.0, camera.height_px - 1.0])
    return np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
