"""Attitude from gyroscope, gravity and compass: the complementary half of the estimator."""

import math
from collections.abc import Sequence

from vwnav.sim.multirotor.airframe import GRAVITY_M_S2, euler_of, rotation_of, turned
from vwnav.sim.multirotor.sensors import Imu

_LEVEL_GAIN_PER_S = 0.4  # on the ground: gravity is all there is
_FLIGHT_GAIN_PER_S = 0.02  # in the air the accelerometer feels thrust, not gravity
_BIAS_GAIN_PER_S = 0.5  # on the ground: what turns is bias
_COMPASS_GAIN_PER_S = 0.3
_VISION_YAW_GAIN_PER_S = 1.0


class AttitudeFilter:
    """Quaternion of R_ned_body with gyroscope biases (after Mahony et al. 2008, eq. 32)."""

    def __init__(self, heading_rad: float) -> None:
        half = 0.5 * heading_rad
        self.quat_wxyz = (math.cos(half), 0.0, 0.0, math.sin(half))
        self.rotation = rotation_of(*self.quat_wxyz)
        self.rates = (0.0, 0.0, 0.0)
        self._bias = [0.0, 0.0, 0.0]

    def align(
        self,
        quat_wxyz: tuple[float, float, float, float],
        gyro_bias_rad_s: Sequence[float],
    ) -> None:
        """Know the attitude, and the biases, as after a while on the ground."""
        self.quat_wxyz = quat_wxyz
        self.rotation = rotation_of(*quat_wxyz)
        self._bias = list(gyro_bias_rad_s)

    def step(self, imu: Imu, on_ground: bool, aided: bool, dt_s: float) -> None:
        """Advance by one inertial sample.

        Gravity corrects the tilt on the ground, and in the air only while nothing better does
        (`aided`: the position filter finds the tilt).
        """
        bias = self._bias
        p, q, r = imu.p - bias[0], imu.q - bias[1], imu.r - bias[2]
        self.rates = (p, q, r)
        if on_ground:
            pull = _BIAS_GAIN_PER_S * dt_s
            bias[0], bias[1], bias[2] = bias[0] + pull * p, bias[1] + pull * q, bias[2] + pull * r
        if on_ground or not aided:
            gain = _LEVEL_GAIN_PER_S if on_ground else _FLIGHT_GAIN_PER_S
            ex, ey, ez = self._tilt_error(imu)
            p, q, r = p + gain * ex, q + gain * ey, r + gain * ez
        self.quat_wxyz = turned(self.quat_wxyz, p, q, r, dt_s)
        self.rotation = rotation_of(*self.quat_wxyz)

    def _tilt_error(self, imu: Imu) -> tuple[float, float, float]:
        """From the estimated to the measured down, in the body (rad); 0 while accelerating."""
        norm = math.sqrt(imu.ax**2 + imu.ay**2 + imu.az**2)
        if abs(norm - GRAVITY_M_S2) > 1.0:
            return 0.0, 0.0, 0.0
        r20, r21, r22 = self.rotation[6:]
        ux, uy, uz = -imu.ax / norm, -imu.ay / norm, -imu.az / norm
        return uy * r22 - uz * r21, uz * r20 - ux * r22, ux * r21 - uy * r20

    def correct_heading(self, heading_rad: float, from_vision: bool, dt_s: float) -> None:
        """Pull the yaw towards a compass or vision heading, `dt_s` since the last one."""
        gain = _VISION_YAW_GAIN_PER_S if from_vision else _COMPASS_GAIN_PER_S
        error = math.remainder(heading_rad - self.yaw_rad, math.tau)
        self._turn_world(0.0, 0.0, min(1.0, gain * dt_s) * error)

    def turn_heading(self, turn_rad: float) -> None:
        """Turn about down at once, as a realignment does."""
        self._turn_world(0.0, 0.0, turn_rad)

    def tilt(self, x_rad: float, y_rad: float) -> None:
        """Turn by small angles about north and east."""
        self._turn_world(x_rad, y_rad, 0.0)

    def _turn_world(self, x_rad: float, y_rad: float, z_rad: float) -> None:
        r00, r01, r02, r10, r11, r12, r20, r21, r22 = self.rotation
        p = r00 * x_rad + r10 * y_rad + r20 * z_rad
        q = r01 * x_rad + r11 * y_rad + r21 * z_rad
        r = r02 * x_rad + r12 * y_rad + r22 * z_rad
        self.quat_wxyz = turned(self.quat_wxyz, p, q, r, 1.0)
        self.rotation = rotation_of(*self.quat_wxyz)

    def specific_force_ned(self, imu: Imu) -> tuple[float, float, float]:
        """The accelerometer's reading turned into NED (m/s^2)."""
        r00, r01, r02, r10, r11, r12, r20, r21, r22 = self.rotation
        ax, ay, az = imu.ax, imu.ay, imu.az
        return (
            r00 * ax + r01 * ay + r02 * az,
            r10 * ax + r11 * ay + r12 * az,
            r20 * ax + r21 * ay + r22 * az,
        )

    @property
    def yaw_rad(self) -> float:
        """Heading, 0 = north, clockwise positive."""
        return math.atan2(self.rotation[3], self.rotation[0])

    @property
    def euler_rad(self) -> tuple[float, float, float]:
        """Roll, pitch, yaw (Z-Y-X)."""
        return euler_of(self.rotation)
