"""How the body moves while an image is exposed."""

from collections.abc import Callable
from dataclasses import replace

from vwnav.geometry.rotations import rotation_from_quat, vector_from_rotation
from vwnav.types import Attitude, Estimate, Frame

_OVER_S = 0.01  # either way of the exposure, to see how the body turns


def with_motion(
    frame: Frame, attitude_at: Callable[[float], Attitude | None], now: Estimate | None
) -> Frame:
    """The frame with the body's motion, where attitudes around it and an estimate tell it."""
    before, after = (attitude_at(frame.t_s + s) for s in (-_OVER_S, _OVER_S))
    if before is None or after is None or now is None:
        return frame
    R0, R1 = rotation_from_quat(before.quat_wxyz), rotation_from_quat(after.quat_wxyz)
    return replace(
        frame,
        rates_rad_s=vector_from_rotation(R0.T @ R1) / (2.0 * _OVER_S),
        velocity_body_m_s=rotation_from_quat(now.quat_wxyz).T @ now.velocity_ned_m_s,
    )
