"""SET_POSITION_TARGET_LOCAL_NED: its type mask and frames, as PX4 reads them."""

import math
from typing import Any

from vwnav.sim.multirotor.setpoint import Setpoint

_LOCAL_NED, _BODY_NED = 1, 8  # MAV_FRAME; PX4 takes velocity and acceleration in BODY_NED
_IGNORE_YAW, _IGNORE_YAW_RATE, _FORCE = 1024, 2048, 512


def setpoint_of(message: Any, yaw_rad: float) -> Setpoint | None:
    """The setpoint in NED about the estimator's origin; None where PX4 takes no notice.

    `yaw_rad` is the heading that BODY_NED vectors are turned by.
    """
    frame, mask = message.coordinate_frame, message.type_mask
    if frame not in (_LOCAL_NED, _BODY_NED) or mask & _FORCE:
        return None
    position = _group(mask, 0, (message.x, message.y, message.z))
    velocity = _group(mask, 3, (message.vx, message.vy, message.vz))
    push = _group(mask, 6, (message.afx, message.afy, message.afz))
    if frame == _BODY_NED:
        if any(value is not None for value in position):
            return None
        velocity, push = _turned(velocity, yaw_rad), _turned(push, yaw_rad)
    if all(value is None for value in (*position, *velocity, *push)):
        return None
    return Setpoint(
        north_m=position[0],
        east_m=position[1],
        down_m=position[2],
        vn_m_s=velocity[0],
        ve_m_s=velocity[1],
        vd_m_s=velocity[2],
        an_m_s2=push[0],
        ae_m_s2=push[1],
        yaw_rad=None if mask & _IGNORE_YAW else _finite(message.yaw),
        yaw_rate_rad_s=None if mask & _IGNORE_YAW_RATE else _finite(message.yaw_rate),
    )


def _group(
    mask: int, first_bit: int, values: tuple[float, float, float]
) -> tuple[float | None, ...]:
    return tuple(
        None if mask >> (first_bit + i) & 1 else _finite(value) for i, value in enumerate(values)
    )


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _turned(values: tuple[float | None, ...], yaw_rad: float) -> tuple[float | None, ...]:
    x, y, z = values
    if x is None or y is None:
        return values
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    return cos * x - sin * y, sin * x + cos * y, z
