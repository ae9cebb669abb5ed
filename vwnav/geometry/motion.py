"""Motion of the camera over a plane, out of the homography between two of its pictures."""

import math
from dataclasses import dataclass

import numpy as np

from vwnav.geometry.rotations import vector_from_rotation
from vwnav.types import Array

_STILL = 1e-9  # relative change of length below which a homography is a pure rotation


@dataclass(frozen=True, slots=True, eq=False)
class GroundMotion:
    """Motion between two pictures: `X_1 = R_1_0 @ X_0 + t_1_0 * distance to the plane`.

    Attributes:
        R_1_0: (3, 3) camera axes 0 to camera axes 1.
        t_1_0: (3,) in units of the distance of camera 0 to the ground, along its normal.
        normal_0: (3,) unit normal of the ground in camera axes 0, pointing into the ground.
    """

    R_1_0: Array
    t_1_0: Array
    normal_0: Array


def ground_translation(H_1_0: Array, K: Array, R_1_0: Array, normal_0: Array) -> Array:
    """t_1_0 (3,) of `GroundMotion` when rotation and ground normal are known from the attitude.

    `K^-1 H K = s (R + t n^T)`: s comes from the directions along the ground, on which t has no say.
    """
    H = np.linalg.inv(K) @ H_1_0 @ K
    along = np.linalg.svd(normal_0[None])[2][1:].T
    turned = R_1_0 @ along
    scale = float(np.sum(turned * (H @ along)) / np.sum(turned * turned))
    return np.asarray((H / scale - R_1_0) @ normal_0)


def decompose_ground_homography(
    H_1_0: Array,
    K: Array,
    uv0: Array,
    down_0: Array,
    previous: GroundMotion | None = None,
    sigma_normal_rad: float = 0.1,
) -> GroundMotion | None:
    """The physically right one of the up to four decompositions (Malis and Vargas 2007).

    All pixels see the ground in front of both cameras; of what then remains, the one whose normal
    is nearest to `down_0` and whose motion is nearest to the last one.

    Args:
        H_1_0: (3, 3) between undistorted pictures of the same camera.
        K: (3, 3) of that camera.
        uv0: (n, 2) pixels of picture 0 that lie on the ground.
        down_0: (3,) where down is thought to be in camera axes 0 (the optical axis if unknown).
        previous: the motion before, when there was one.
        sigma_normal_rad: how well `down_0` is known.

    Returns:
        None when no decomposition is possible physically.
    """
    H = _normalised(H_1_0, K)
    rays = np.column_stack([uv0, np.ones(len(uv0))]) @ np.linalg.inv(K).T
    if H is None or len(rays) == 0 or not np.all(np.isfinite(rays)):
        return None
    down = np.asarray(down_0, dtype=np.float64) / np.linalg.norm(down_0)
    if np.ptp(np.linalg.svd(H, compute_uv=False)) < _STILL:
        U, _, Vt = np.linalg.svd(H)
        return GroundMotion(U @ Vt, np.zeros(3), down)
    possible = [motion for motion in _decompositions(H) if _in_front(motion, rays)]
    return min(
        possible,
        key=lambda motion: _unlikeliness(motion, down, previous, sigma_normal_rad),
        default=None,
    )


def _normalised(H_1_0: Array, K: Array) -> Array | None:
    """K^-1 H K with middle singular value 1 and positive determinant, None when singular."""
    H = np.linalg.inv(K) @ H_1_0 @ K
    if not np.all(np.isfinite(H)):
        return None
    singular = np.linalg.svd(H, compute_uv=False)
    if singular[2] <= 1e-9 * singular[0]:
        return None
    return np.asarray(H / math.copysign(singular[1], np.linalg.det(H)))


def _decompositions(H: Array) -> list[GroundMotion]:
    """All four (R, t, n) with `H = R + t n^T` (Ma, Soatto, Kosecka, Sastry 2004, table 5.1).

    Not by OpenCV, which takes motion below 1e-3 of the height for none: 1 m/s at 30 frames/s.
    """
    eigenvalues, V = np.linalg.eigh(H.T @ H)
    v3, v2, v1 = V.T
    shrink = math.sqrt(max(1.0 - eigenvalues[0], 0.0))
    stretch = math.sqrt(max(eigenvalues[2] - 1.0, 0.0))
    found = []
    for side in (1.0, -1.0):
        u = (shrink * v1 + side * stretch * v3) / math.hypot(shrink, stretch)
        normal = np.cross(v2, u)
        turned = np.column_stack([H @ v2, H @ u, np.cross(H @ v2, H @ u)])
        R = turned @ np.column_stack([v2, u, normal]).T
        t = (H - R) @ normal
        found += [GroundMotion(R, t, normal), GroundMotion(R, -t, -normal)]
    return found


def _in_front(motion: GroundMotion, rays: Array) -> bool:
    """Every ray meets the plane in front of camera 0, and the point lies in front of camera 1."""
    towards_plane = rays @ motion.normal_0
    if np.any(towards_plane <= 0.0):
        return False
    depth_1 = (rays @ motion.R_1_0.T)[:, 2] / towards_plane + motion.t_1_0[2]
    return bool(np.all(depth_1 > 0.0))


def _unlikeliness(
    motion: GroundMotion, down: Array, previous: GroundMotion | None, sigma_normal_rad: float
) -> float:
    angle_rad = math.acos(float(np.clip(motion.normal_0 @ down, -1.0, 1.0)))
    cost = (angle_rad / sigma_normal_rad) ** 2
    if previous is None:
        return cost
    # A multirotor changes its velocity and rates by a part between two pictures, not at once.
    step = float(np.linalg.norm(motion.t_1_0 - previous.t_1_0))
    turn_rad = float(np.linalg.norm(vector_from_rotation(motion.R_1_0 @ previous.R_1_0.T)))
    sigma_step = 0.02 + 0.5 * float(np.linalg.norm(previous.t_1_0))
    return cost + (step / sigma_step) ** 2 + (turn_rad / 0.1) ** 2
