"""What an IMU felt, integrated once: any span is a difference of two sums."""

from dataclasses import dataclass

import numpy as np

from vwnav.geometry.rotations import quat_conjugate, quat_multiply
from vwnav.types import Array


@dataclass(frozen=True, slots=True, eq=False)
class ImuIntegrals:
    """Integrals since the first sample, in NED as the autopilot's attitude has it.

    In an hour they grow to some 4e4 m/s: differences of them keep ten digits for days.

    Attributes:
        series: samples between silences share it, of attitudes too: forces that nobody can turn
            into NED are not counted.
        lasted_s: by the sensor's own clock.
        pushed: (3, 5) integrals of R_ned_body, of R_ned_body f and of f, side by side.
        turned: (4,) quaternion, the product of all turns of the body.
        shaken: (2,) variances per axis of the integrals of force and of rates by what happened
            between samples: rotors shake the sensors faster than they are heard.
    """

    series: int
    lasted_s: float
    pushed: Array
    turned: Array
    shaken: Array


@dataclass(frozen=True, slots=True, eq=False)
class PreintegratedImu:
    """What the IMU felt over a span, in NED as the autopilot's attitude has it.

    Attributes:
        lasted_s: its length by the sensor's own clock.
        velocity_m_s: (3,) integral of R_ned_body f, gravity still in it.
        body_m_s: (3,) integral of f itself, which no attitude has turned.
        rotation_s: (3, 3) integral of R_ned_body: what a bias of the accelerometer or of the gyro
            adds up to.
        turn_wxyz: (4,) the rotation that the gyro counted, R_body0_body1.
        shaken_m2_s2, shaken_rad2: variance per axis of velocity and of turn.
    """

    lasted_s: float
    velocity_m_s: Array
    body_m_s: Array
    rotation_s: Array
    turn_wxyz: Array
    shaken_m2_s2: float
    shaken_rad2: float


def preintegrated(zero: ImuIntegrals | None, one: ImuIntegrals | None) -> PreintegratedImu | None:
    """What was felt from one moment to another; None where a silence lies between."""
    if zero is None or one is None or zero.series != one.series:
        return None
    pushed = one.pushed - zero.pushed
    # What was felt beyond the newest sample was guessed from it: where less came after that, the
    # difference is negative, which is no variance, and made the covariance none either.
    shaken = np.maximum(one.shaken - zero.shaken, 0.0)
    turn = quat_multiply(quat_conjugate(zero.turned), one.turned)
    return PreintegratedImu(
        one.lasted_s - zero.lasted_s,
        pushed[:, 3],
        pushed[:, 4],
        pushed[:, :3],
        turn,
        float(shaken[0]),
        float(shaken[1]),
    )
