"""What the autopilot tells of a moment; what its IMU felt until then are sums to subtract."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class ImuIntegrals(NamedTuple):
    """Integrals since the first sample, in NED as the autopilot's attitude has it.

    In an hour they grow to some 4e4 m/s: differences of them keep ten digits for days.

    Attributes:
        series: samples between silences share it, of attitudes too: forces that nobody can turn
            into NED are not counted.
        span_s: by the sensor's own clock.
        integrals: (3, 5) integrals of R_ned_body, of R_ned_body f and of f, side by side.
        turned: (4,) quaternion, the product of all turns of the body.
        variances: (2,) variances per axis of the integrals of force and of rates by what happened
            between samples: rotors shake the sensors faster than they are heard.
    """

    series: int
    span_s: float
    integrals: Array
    turned: Array
    variances: Array


class Measured(NamedTuple):
    """What the autopilot tells of a moment.

    Attributes:
        quat_wxyz: (4,) its attitude.
        known: whether that is known; else it was held, and is none of the autopilot's.
        felt: what its IMU had felt until then.
    """

    quat_wxyz: Array
    known: bool
    felt: ImuIntegrals | None


class Exposure(NamedTuple):
    """How an image was held, as the autopilot has it.

    Attributes:
        t_s: when.
        yaw_rad: its heading.
        lean: (2,) where the body's down axis meets the ground, level forward and right, in heights.
        tilts_rad_s: how fast its own down axis turned, as the gyro says; where none, as attitudes.
        turns_rad_s: (3,) how fast it turned about the level forward and right, and about down.
        told: telemetry reaches there; else it is a guess.
        velocity_m_s: (3,) NED, as the filter had it.
    """

    t_s: float
    yaw_rad: float
    lean: Array
    tilts_rad_s: float
    turns_rad_s: Array
    told: bool
    velocity_m_s: Array = np.zeros(3)


def white_acceleration(level: float, vertical: float, dt_s: float) -> Array:
    """(6, 6) what it adds to position and velocity in a time, (m/s^2)^2 per hertz."""
    apart, both, gained = dt_s**3 / 3.0, dt_s**2 / 2.0, dt_s
    h, v = level, vertical
    return np.array(
        [
            [h * apart, 0.0, 0.0, h * both, 0.0, 0.0],
            [0.0, h * apart, 0.0, 0.0, h * both, 0.0],
            [0.0, 0.0, v * apart, 0.0, 0.0, v * both],
            [h * both, 0.0, 0.0, h * gained, 0.0, 0.0],
            [0.0, h * both, 0.0, 0.0, h * gained, 0.0],
            [0.0, 0.0, v * both, 0.0, 0.0, v * gained],
        ]
    )
