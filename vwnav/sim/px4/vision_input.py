"""VISION_POSITION_ESTIMATE and ODOMETRY as the estimator wants them; what PX4 ignores is None."""

import math
from typing import Any

from vwnav.sim.px4.estimator import VisionSample
from vwnav.sim.px4.parameters import Px4Parameters

_LOCAL_NED, _LOCAL_FRD = 1, 20  # MAV_FRAME
_BODY_FRD = (8, 12)
_FARTHEST_M, _FASTEST_M_S, _LARGEST_VARIANCE = 1e7, 1e3, 1e6


def from_vision_position(
    message: Any, t_s: float, parameters: Px4Parameters
) -> VisionSample | None:
    """VISION_POSITION_ESTIMATE, NED about the estimator's origin, measured at `t_s`."""
    if not _plausible(_FARTHEST_M, message.x, message.y, message.z):
        return None
    return VisionSample(
        t_s=t_s,
        position_ned_m=(message.x, message.y, message.z),
        variance_m2=_variance(message.covariance, parameters["EKF2_EVP_NOISE"]),
        yaw_rad=message.yaw if math.isfinite(message.yaw) else None,
        velocity_ned_m_s=None,
        velocity_variance=1.0,
        reset_counter=message.reset_counter,
        turned_frame=False,
    )


def from_odometry(message: Any, t_s: float, parameters: Px4Parameters) -> VisionSample | None:
    """ODOMETRY in LOCAL_NED or LOCAL_FRD; other frames are dropped in silence, as PX4 does."""
    position = (message.x, message.y, message.z)
    is_known = _plausible(_FARTHEST_M, *position)
    velocity = _velocity(message)
    too_poor = 0 < message.quality < parameters["EKF2_EV_QMIN"] or message.quality < 0
    is_empty = not is_known and velocity is None
    if message.frame_id not in (_LOCAL_NED, _LOCAL_FRD) or is_empty or too_poor:
        return None
    return VisionSample(
        t_s=t_s,
        position_ned_m=position if is_known else None,
        variance_m2=_variance(message.pose_covariance, parameters["EKF2_EVP_NOISE"]),
        yaw_rad=_yaw(message.q),
        velocity_ned_m_s=velocity,
        velocity_variance=_variance(message.velocity_covariance, parameters["EKF2_EVV_NOISE"]),
        reset_counter=message.reset_counter,
        turned_frame=message.frame_id == _LOCAL_FRD,
    )


def _plausible(limit: float, *values: float) -> bool:
    """Finite, and not so large that sums of them could overflow a float32."""
    return all(abs(value) <= limit for value in values)  # False for NaN too


def _variance(covariance: list[float], noise: float) -> float:
    """The larger horizontal variance, not below the parameter's (EKF2_EV_NOISE_MD 0)."""
    given = [value for value in (covariance[0], covariance[6]) if math.isfinite(value)]
    return min(max([noise**2, *given]), _LARGEST_VARIANCE)


def _yaw(q: list[float]) -> float | None:
    w, x, y, z = q
    norm = w * w + x * x + y * y + z * z
    if not math.isfinite(norm) or abs(norm - 1.0) > 0.1:
        return None
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def _velocity(message: Any) -> tuple[float, float, float] | None:
    """Velocity turned to the pose's frame."""
    vx, vy, vz = message.vx, message.vy, message.vz
    w, x, y, z = message.q
    if not _plausible(_FASTEST_M_S, vx, vy, vz) or not _plausible(1.1, w, x, y, z):
        return None
    if message.child_frame_id not in _BODY_FRD:
        return vx, vy, vz
    # v' = v + 2 u x (u x v + w v), u the quaternion's vector
    tx = y * vz - z * vy + w * vx
    ty = z * vx - x * vz + w * vy
    tz = x * vy - y * vx + w * vz
    return (
        vx + 2.0 * (y * tz - z * ty),
        vy + 2.0 * (z * tx - x * tz),
        vz + 2.0 * (x * ty - y * tx),
    )
