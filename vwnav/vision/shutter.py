"""A rolling shutter whose read-out is known: where its rows saw what is looked for in an image.

By the continuous homography A of `vwnav.geometry.homography`.
"""

import numpy as np

from vwnav.geometry.camera import Camera
from vwnav.geometry.homography import skew_per_s
from vwnav.types import Array

LEAST_SHIFT_PX = 0.25  # of the first and the last row; less is left as it is
_ROUNDS = 2  # until the row that a point is seen in stands


def is_visible(flow: Array, camera: Camera) -> bool:
    """Whether rows that show what moves by A are seen to be shifted."""
    edges = camera.bearings(_first_and_last_row(camera))
    edges = edges / edges[:, 2:]
    moving = edges @ flow.T
    slopes = moving[:, :2] - edges[:, :2] * moving[:, 2:]  # of x / z and y / z, per second
    shift_px = 0.5 * (camera.readout_s or 0.0) * camera.K[0, 0] * np.abs(slopes)
    return bool(shift_px.max() > LEAST_SHIFT_PX)


def seen_by_rows(rays: Array, camera: Camera, flow: Array) -> Array:
    """Pixels (n, 2) at which rows show what a global shutter would see in directions (n, 3).

    Args:
        rays: of any length, in camera axes at the middle row's moment.
        camera: as it takes images, with its read-out.
        flow: A.
    """
    assert camera.readout_s is not None
    seen = camera.project(rays)
    for _ in range(_ROUNDS):
        skew = skew_per_s(rays, seen[:, 1], camera.height_px, flow)
        seen = camera.project(rays - camera.readout_s * skew)
    return seen


def _first_and_last_row(camera: Camera) -> Array:
    """Pixels (6, 2): their ends and middles, which a rolling shutter shifts most."""
    u = np.linspace(0.0, camera.width_px - 1.0, 3)
    v = np.array([0.0, camera.height_px - 1.0])
    return np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
