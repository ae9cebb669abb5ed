"""The lever arm: a camera sits beside the autopilot, which asks where its own body is."""

from dataclasses import replace

import numpy as np

from vwnav.geometry.geodesy import LocalFrame
from vwnav.geometry.rotations import rotation_from_euler
from vwnav.types import Array, MapFix, Prior


class LeverArm:
    """Between the body and its camera; without an arm priors and fixes stay as they are.

    Args:
        t_body_camera_m: (3,) of the camera, about the body's axes.
    """

    def __init__(self, t_body_camera_m: Array) -> None:
        self._arm_m = t_body_camera_m if np.any(t_body_camera_m) else None

    def prior_of_camera(self, prior: Prior) -> Prior:
        """What is known of the camera, by what is known of the body.

        With no heading nobody knows to which side the camera sits: the place stays as it is then,
        less wrong than its sigma.
        """
        if self._arm_m is None:
            return prior
        north_m, east_m, down_m = _arm_ned_m(prior, prior.yaw_rad or 0.0, self._arm_m)
        if prior.agl_m is not None:
            prior = replace(prior, agl_m=prior.agl_m - down_m)
        if prior.lat_deg is None or prior.lon_deg is None or prior.yaw_rad is None:
            return prior
        lat_deg, lon_deg = _moved(prior.lat_deg, prior.lon_deg, north_m, east_m)
        return replace(prior, lat_deg=lat_deg, lon_deg=lon_deg)

    def fix_of_body(self, fix: MapFix, prior: Prior) -> MapFix:
        """Where the body is, by where its camera was found.

        By the heading that was found, not the one that was assumed: a compass 15 degrees off would
        put a camera on an arm of half a metre 13 cm aside. A place without heading takes the
        prior's.

        Args:
            fix: of the camera.
            prior: roll and pitch of the body at the exposure, and the heading.
        """
        yaw_rad = prior.yaw_rad if fix.yaw_rad is None else fix.yaw_rad
        if self._arm_m is None or yaw_rad is None:
            return fix
        north_m, east_m, down_m = _arm_ned_m(prior, yaw_rad, self._arm_m)
        lat_deg, lon_deg = _moved(fix.lat_deg, fix.lon_deg, -north_m, -east_m)
        agl_m = None if fix.agl_m is None else fix.agl_m + down_m
        return replace(fix, lat_deg=lat_deg, lon_deg=lon_deg, agl_m=agl_m)


def _arm_ned_m(prior: Prior, yaw_rad: float, t_body_camera_m: Array) -> tuple[float, float, float]:
    """(north, east, down) of the camera from the body; unknown tilt is taken as level."""
    R_ned_body = rotation_from_euler(prior.roll_rad or 0.0, prior.pitch_rad or 0.0, yaw_rad)
    north_m, east_m, down_m = (R_ned_body @ t_body_camera_m).tolist()
    return north_m, east_m, down_m


def _moved(lat_deg: float, lon_deg: float, north_m: float, east_m: float) -> tuple[float, float]:
    there = LocalFrame(lat_deg, lon_deg, 0.0).to_geodetic([north_m, east_m, 0.0])
    return float(there[0]), float(there[1])
