"""Inertial sensors, barometer, compass and rangefinder: the airframe's state with their errors."""

import math
import random
from dataclasses import dataclass

from vwnav.sim.multirotor.airframe import Airframe

_WILD_M = 60.0  # what sunlight or dust makes a rangefinder say, at most
_RANGE_STEPS = 4  # to where the rangefinder's ray meets a ground that is not level
_GYRO_BIAS_RAD_S = 0.003
_ACCEL_BIAS_M_S2 = 0.04
_BARO_NOISE_M = 0.12
_COMPASS_NOISE_RAD = 0.015
_TEN_MINUTES_S = 600.0
FIELD_GAUSS = (0.25, 0.42)  # horizontal and down part of the magnetic field


@dataclass(slots=True)
class Imu:
    """One inertial sample: body rates (rad/s) and specific force (m/s^2), forward-right-down."""

    p: float
    q: float
    r: float
    ax: float
    ay: float
    az: float


@dataclass(frozen=True, slots=True)
class ImuScatter:
    """One sigma of a sample's noise about and along forward, right and down."""

    gyro_rad_s: tuple[float, float, float]
    accel_m_s2: tuple[float, float, float]


QUIET = ImuScatter((0.004, 0.004, 0.004), (0.06, 0.06, 0.06))
# PX4's own simulator (SIH) of the 1.16 era once it flies, as its HIGHRES_IMU is recorded.
OF_SIH_1_16 = ImuScatter((0.12, 0.057, 0.025), (0.36, 1.29, 0.98))


class Sensors:
    """Draws measurements from the airframe; one object per vehicle, seeded.

    Args:
        in_flight: the IMU's noise in the air; on the ground it is quiet.
        noise: scale of inertial, barometer and compass noise and of the inertial biases.
        baro_drift_m: one sigma of the barometer's random walk after ten minutes.
        heading_bias_rad: constant error of the compass.

    Attributes:
        gyro_bias_rad_s: of the three axes.
        baro_error_m, baro_drift_m_s: what a fault adds to the barometer's height, and how fast
            that grows.
        baro_scale: what it says, as a share of the true height: below 1 in air warmer than
            standard.
        heading_bias_rad: constant error of the compass.
        range_scale: what the rangefinder says, as a share of the true distance.
        range_stuck_m: what that says again and again; None while it works.
        range_ends_m: what it says of all that is farther.
        range_wild: share of what it says that is anything within its reach.
    """

    def __init__(
        self,
        rng: random.Random,
        in_flight: ImuScatter,
        noise: float,
        baro_drift_m: float,
        heading_bias_rad: float,
    ) -> None:
        self._gauss, self._random = rng.gauss, rng.random
        self._in_flight = in_flight
        self._noise = noise
        self._walk_m = baro_drift_m / math.sqrt(_TEN_MINUTES_S)
        self.heading_bias_rad = heading_bias_rad
        self.gyro_bias_rad_s = [rng.gauss(0.0, _GYRO_BIAS_RAD_S * noise) for _ in range(3)]
        self._accel_bias = [rng.gauss(0.0, _ACCEL_BIAS_M_S2 * noise) for _ in range(3)]
        self._baro_drift_m = 0.0
        self.baro_error_m = 0.0
        self.baro_drift_m_s = 0.0
        self.baro_scale = 1.0
        self.range_scale = 1.0
        self.range_stuck_m: float | None = None
        self.range_ends_m = math.inf
        self.range_wild = 0.0

    def imu(self, body: Airframe) -> Imu:
        """Gyroscope and accelerometer now."""
        gauss, gyro, accel = self._gauss, self.gyro_bias_rad_s, self._accel_bias
        scatter = QUIET if body.on_ground else self._in_flight
        p, q, r = (self._noise * sigma for sigma in scatter.gyro_rad_s)
        x, y, z = (self._noise * sigma for sigma in scatter.accel_m_s2)
        return Imu(
            body.p + gyro[0] + gauss(0.0, p),
            body.q + gyro[1] + gauss(0.0, q),
            body.r + gyro[2] + gauss(0.0, r),
            body.axb + accel[0] + gauss(0.0, x),
            body.ayb + accel[1] + gauss(0.0, y),
            body.azb + accel[2] + gauss(0.0, z),
        )

    def baro_height_m(self, body: Airframe, dt_s: float) -> float:
        """Height over the start place as the barometer shows it; `dt_s` since the last call."""
        self._baro_drift_m += self._gauss(0.0, self._walk_m * math.sqrt(dt_s))
        self.baro_error_m += self.baro_drift_m_s * dt_s
        error_m = self._baro_drift_m + self.baro_error_m
        noise_m = self._gauss(0.0, _BARO_NOISE_M * self._noise)
        return -body.d * self.baro_scale + error_m + noise_m

    def compass_rad(self, body: Airframe) -> float:
        """True heading as the compass shows it."""
        r00, r10 = body.rotation[0], body.rotation[3]
        noise = self._gauss(0.0, _COMPASS_NOISE_RAD * self._noise)
        return math.atan2(r10, r00) + self.heading_bias_rad + noise

    def range_m(self, body: Airframe) -> float | None:
        """Distance to the ground along body down; None beyond 60 degrees of tilt."""
        if self.range_stuck_m is not None:
            return self.range_stuck_m
        _, _, north, _, _, east, _, _, down = body.rotation
        if down < 0.5:
            return None
        distance_m = body.agl_m / down
        for _ in range(_RANGE_STEPS):
            there = body.n + distance_m * north, body.e + distance_m * east
            distance_m = (-body.d - body.ground_m(*there)) / down
        said_m = self.range_scale * distance_m + self._gauss(0.0, 0.02 * self._noise)
        if self.range_wild > 0.0 and self._random() < self.range_wild:
            said_m = _WILD_M * self._random()
        return min(max(0.0, said_m), self.range_ends_m)


def pressure_hpa(alt_amsl_m: float) -> float:
    """Standard atmosphere (ISO 2533): pressure at an altitude."""
    return float(1013.25 * (1.0 - 2.25577e-5 * alt_amsl_m) ** 5.25588)
