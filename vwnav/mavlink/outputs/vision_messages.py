"""Estimates and setpoints as the MAVLink messages by which an autopilot takes them in."""

import math
from typing import Any

from vwnav.geometry.rotations import euler_from_rotation, rotation_from_quat
from vwnav.types import Array, Estimate
from vwnav.vehicle import VelocitySetpoint

# Attitude is the autopilot's own: sent back with the variance of no knowledge at all, so that it
# can never be fused as if it were independent.
_NO_ATTITUDE_VARIANCE_RAD2 = math.pi**2
_FRAME_LOCAL_NED = 1  # MAV_FRAME
_OF_VISION = 2  # MAV_ESTIMATOR_TYPE
_VELOCITY_AND_YAW = 0b100111000111  # POSITION_TARGET_TYPEMASK: ignore all the rest


def vision_position(estimate: Estimate, offset_ned_m: Array) -> dict[str, Any]:
    """Fields of VISION_POSITION_ESTIMATE: NED about the autopilot's origin.

    Args:
        estimate: about the run's origin; `t_s` on the clock that answers the autopilot's TIMESYNC.
        offset_ned_m: (3,) where the run's origin lies about the autopilot's.
    """
    x, y, z = (estimate.position_ned_m + offset_ned_m).tolist()
    roll, pitch, yaw = euler_from_rotation(rotation_from_quat(estimate.quat_wxyz))
    return {
        "usec": int(estimate.t_s * 1e6),
        "x": x,
        "y": y,
        "z": z,
        "roll": roll,
        "pitch": pitch,
        "yaw": yaw,
        "covariance": _with_attitude(estimate.covariance[:3, :3]),
        "reset_counter": estimate.reset_counter & 0xFF,
    }


def odometry(estimate: Estimate, offset_ned_m: Array) -> dict[str, Any]:
    """Fields of ODOMETRY: position and velocity, both NED.

    Args:
        estimate: as for `vision_position`.
        offset_ned_m: likewise.
    """
    x, y, z = (estimate.position_ned_m + offset_ned_m).tolist()
    vx, vy, vz = estimate.velocity_ned_m_s.tolist()
    return {
        "time_usec": int(estimate.t_s * 1e6),
        "frame_id": _FRAME_LOCAL_NED,
        "child_frame_id": _FRAME_LOCAL_NED,
        "x": x,
        "y": y,
        "z": z,
        "q": estimate.quat_wxyz.tolist(),
        "vx": vx,
        "vy": vy,
        "vz": vz,
        **dict.fromkeys(("rollspeed", "pitchspeed", "yawspeed")),  # None: not told
        "pose_covariance": _with_attitude(estimate.covariance[:3, :3]),
        "velocity_covariance": _with_attitude(estimate.covariance[3:, 3:]),
        "reset_counter": estimate.reset_counter & 0xFF,
        "estimator_type": _OF_VISION,
        "quality": 0,  # not told, as in VISION_POSITION_ESTIMATE
    }


def _with_attitude(covariance: Array) -> list[float]:
    """(3, 3) and what is known of the attitude: the 21 of a row-major upper triangle (6, 6)."""
    (nn, ne, nd), (_, ee, ed), (_, _, dd) = covariance.tolist()
    with_place = [nn, ne, nd, 0.0, 0.0, 0.0, ee, ed, 0.0, 0.0, 0.0, dd, 0.0, 0.0, 0.0]
    unknown = _NO_ATTITUDE_VARIANCE_RAD2
    return [*with_place, unknown, 0.0, 0.0, unknown, 0.0, unknown]


def vision_speed(estimate: Estimate) -> dict[str, Any]:
    """Fields of VISION_SPEED_ESTIMATE: NED velocity with its (3, 3) covariance, row-major."""
    x, y, z = estimate.velocity_ned_m_s.tolist()
    return {
        "usec": int(estimate.t_s * 1e6),
        "x": x,
        "y": y,
        "z": z,
        "covariance": estimate.covariance[3:, 3:].ravel().tolist(),
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
