"""Of a video alone, whose camera is taken as level: the way of the ground point in its centre."""

from dataclasses import replace

import numpy as np

from vwnav.geometry.camera import Camera
from vwnav.geometry.rotations import (
    euler_from_rotation,
    rotation_from_euler,
    rotation_from_vector,
)
from vwnav.types import Array
from vwnav.vision.odometry.ground_motion import Motion
from vwnav.vision.odometry.views import ReducedView


def centre_way(motion: Motion, axis0: Array, axis1: Array) -> tuple[Array, Array]:
    """Way (3,) of the ground point in the image's centre, with its covariance (3, 3).

    Tilting moves it as flying does. It stays on the ground, which is turned to be level; the third
    component is how much shorter the way from the camera to that point became.

    Args:
        motion: since the keyframe.
        axis0: (3,) optical axis in NED of the keyframe.
        axis1: (3,) the same of the image, both as their attitudes have it.
    """
    parameters = np.concatenate([motion.way, motion.turn_rad, motion.slope])
    way = _centre(parameters, axis0, axis1)
    J = np.empty((3, 8))
    for i, step in enumerate(1e-6 * np.eye(8)):
        J[:, i] = (_centre(parameters + step, axis0, axis1) - way) / 1e-6
    return way, J @ motion.covariance[:8, :8] @ J.T


def turned_level(view: ReducedView, heading_rad: float, camera: Camera) -> ReducedView:
    """A level view, whose body has the heading that its image has shown."""
    R_ned_body = rotation_from_euler(0.0, 0.0, heading_rad)
    told_rad = euler_from_rotation(R_ned_body)[2]
    return replace(view, R_ned_camera=R_ned_body @ camera.R_body_camera, heading_rad=told_rad)


def _centre(parameters: Array, axis0: Array, axis1: Array) -> Array:
    t, normal = parameters[:3], np.array([parameters[6], parameters[7], 1.0])
    axis = rotation_from_vector(parameters[3:6]) @ axis1
    range0 = 1.0 / (normal @ axis0)
    range1 = (1.0 - normal @ t) / (normal @ axis)
    along = t + range1 * axis - range0 * axis0
    level = rotation_from_vector(np.cross(normal / np.linalg.norm(normal), [0.0, 0.0, 1.0]))
    return np.array([*(level @ along)[:2], range0 - range1])
