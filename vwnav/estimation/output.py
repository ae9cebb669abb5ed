"""The estimate that a state of the filter is, as everybody else uses it."""

import math

import numpy as np

from vwnav.estimation.inertial.drag import wind_ne_m_s
from vwnav.estimation.states import FilterState, States
from vwnav.geometry.rotations import (
    quat_from_rotation,
    rotation_from_quat,
    rotation_from_vector,
)
from vwnav.types import Array, Estimate


def estimate_of(state: FilterState, quat_measured_wxyz: Array, turned_rad: float) -> Estimate:
    """What a state says of the aircraft.

    Args:
        state: the filter's.
        quat_measured_wxyz: (4,) the attitude that it knows of that moment.
        turned_rad: how far the aircraft may have turned since that was known.
    """
    x, P = state.x, state.P
    kept = np.r_[0:6]
    down, terrain = 2, States.TERRAIN.start
    variance_agl = P[down, down] + P[terrain, terrain] + 2.0 * P[down, terrain]
    return Estimate(
        t_s=state.t_s,
        position_ned_m=x[States.POSITION].copy(),
        velocity_ned_m_s=x[States.VELOCITY].copy(),
        covariance=P[np.ix_(kept, kept)],
        quat_wxyz=_true_attitude(x, quat_measured_wxyz),
        sigma_yaw_rad=min(math.sqrt(_yaw_variance(P, quat_measured_wxyz) + turned_rad**2), math.pi),
        agl_m=max(state.agl_m, 0.0),
        sigma_agl_m=math.sqrt(variance_agl),
        t_last_fix_s=state.t_last_fix_s,
        reset_counter=state.reset_counter,
        wind_ne_m_s=wind_ne_m_s(state),
    )


def _yaw_variance(P: Array, quat_measured_wxyz: Array) -> float:
    """A tilt error turns the heading of a nose that points up or down: by tan(pitch)."""
    w, x, y, z = quat_measured_wxyz.tolist()
    sin_pitch = min(max(2.0 * (w * y - x * z), -0.9), 0.9)
    tangent = sin_pitch / math.sqrt(1.0 - sin_pitch**2)
    yaw, forward = States.HEADING_BIAS.start, States.TILT.start
    return float(P[yaw, yaw] + 2.0 * tangent * P[yaw, forward] + tangent**2 * P[forward, forward])


def _true_attitude(x: Array, quat_measured_wxyz: Array) -> Array:
    """quat_wxyz (4,) with heading bias and tilt removed: R = Rz(-b) exp(-tilt) R_measured."""
    R_measured = rotation_from_quat(quat_measured_wxyz)
    yaw_rad = math.atan2(R_measured[1, 0], R_measured[0, 0])
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    forward, right = x[States.TILT]
    untilt = rotation_from_vector([-c * forward + s * right, -s * forward - c * right, 0.0])
    unturn = rotation_from_vector([0.0, 0.0, -float(x[States.HEADING_BIAS.start])])
    return quat_from_rotation(unturn @ untilt @ R_measured)
