"""Estimates and setpoints as the MAVLink messages by which an autopilot takes them in."""

import math
from typing import Any

import numpy as np

from vwnav.geometry.rotations import euler_from_rotation, rotation_from_quat
from vwnav.types import Array, Estimate
from vwnav.vehicle import VelocitySetpoint

# Attitude is the autopilot's own: sent back with the variance of no knowledge at all, so that it
# can never be fused as if it were independent.
_NO_ATTITUDE_VARIANCE_RAD2 = math.pi**2
_FRAME_LOCAL_NED = 1
_VELOCITY_AND_YAW = 0b100111000111  # POSITION_TARGET_TYPEMASK: ignore all the rest


def vision_position(estimate: Estimate, offset_ned_m: Array) -> dict[str, Any]:
    """Fields of VISION_POSITION_ESTIMATE: NED about the autopilot's origin.

    Args:
        estimate: about the run's origin; `t_s` on the clock that answers the autopilot's TIMESYNC.
        offset_ned_m: (3,) where the run's origin lies about the autopilot's.
    """
    x, y, z = (float(v) for v in estimate.position_ned_m + offset_ned_m)
    roll, pitch, yaw = euler_from_rotation(rotation_from_quat(estimate.quat_wxyz))
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = estimate.covariance[:3, :3]
    covariance[3:, 3:] = np.eye(3) * _NO_ATTITUDE_VARIANCE_RAD2
    return {
        "usec": int(estimate.t_s * 1e6),
        "x": x,
        "y": y,
        "z": z,
        "roll": roll,
        "pitch": pitch,
        "yaw": yaw,
        # Row-major upper triangle of (x, y, z, roll, pitch, yaw): 21 numbers.
        "covariance": [float(v) for v in covariance[np.triu_indices(6)]],
        "reset_counter": estimate.reset_counter & 0xFF,
    }


def vision_speed(estimate: Estimate) -> dict[str, Any]:
    """Fields of VISION_SPEED_ESTIMATE: NED velocity with its (3, 3) covariance, row-major."""
    x, y, z = (float(v) for v in estimate.velocity_ned_m_s)
    return {
        "usec": int(estimate.t_s * 1e6),
        "x": x,
        "y": y,
        "z": z,
        "covariance": [float(v) for v in estimate.covariance[3:, 3:].ravel()],
        "reset_counter": estimate.reset_counter & 0xFF,
    }


def velocity_target(
    setpoint: VelocitySetpoint, yaw_rad: float, t_s: float, system_id: int
) -> dict[str, Any]:
    """Fields of SET_POSITION_TARGET_LOCAL_NED: a velocity, and a heading by the compass."""
    return {
        "time_boot_ms": int(t_s * 1e3) & 0xFFFFFFFF,
        "target_system": system_id,
        "target_component": 1,
        "coordinate_frame": _FRAME_LOCAL_NED,
        "type_mask": _VELOCITY_AND_YAW,
        **dict.fromkeys(("x", "y", "z", "afx", "afy", "afz", "yaw_rate"), 0.0),
        "vx": setpoint.north_m_s,
        "vy": setpoint.east_m_s,
        "vz": setpoint.down_m_s,
        "yaw": yaw_rad,
    }
