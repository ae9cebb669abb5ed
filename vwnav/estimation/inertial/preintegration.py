"""What an IMU felt, integrated once: any span is a difference of two sums."""

from typing import NamedTuple

import numpy as np

from vwnav.estimation.inertial.integrals import ImuIntegrals
from vwnav.geometry.rotations import quat_conjugate, quat_multiply
from vwnav.types import Array


class PreintegratedImu(NamedTuple):
    """What the IMU felt over a span, in NED as the autopilot's attitude has it.

    Attributes:
        span_s: its length by the sensor's own clock.
        velocity_m_s: (3,) integral of R_ned_body f, gravity still in it.
        body_m_s: (3,) integral of f itself, which no attitude has turned.
        rotation_s: (3, 3) integral of R_ned_body: what a bias of the accelerometer or of the gyro
            adds up to.
        turn_wxyz: (4,) the rotation that the gyro counted, R_body0_body1.
        velocity_variance_m2_s2, turn_variance_rad2: variance per axis of velocity and of turn.
    """

    span_s: float
    velocity_m_s: Array
    body_m_s: Array
    rotation_s: Array
    turn_wxyz: Array
    velocity_variance_m2_s2: float
    turn_variance_rad2: float


def preintegrated(zero: ImuIntegrals | None, one: ImuIntegrals | None) -> PreintegratedImu | None:
    """What was felt from one moment to another; None where a silence lies between."""
    if zero is None or one is None or zero.series != one.series:
        return None
    integrals = one.integrals - zero.integrals
    # What was felt beyond the newest sample was guessed from it: where less came after that, the
    # difference is negative, which is no variance, and made the covariance none either.
    variances = np.maximum(one.variances - zero.variances, 0.0)
    turn = quat_multiply(quat_conjugate(zero.turned), one.turned)
    return PreintegratedImu(
        one.span_s - zero.span_s,
        integrals[:, 3],
        integrals[:, 4],
        integrals[:, :3],
        turn,
        float(variances[0]),
        float(variances[1]),
    )
