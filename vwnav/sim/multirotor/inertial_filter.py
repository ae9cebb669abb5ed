"""What every autopilot's estimator does alike: dead reckoning by IMU, barometer and compass."""

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Sequence

from vwnav.geometry.geodesy import LocalFrame
from vwnav.sim.multirotor.airframe import GRAVITY_M_S2, euler_of, rotation_of, turned
from vwnav.sim.multirotor.sensors import Imu

_SLOW_STEP_S = 0.02  # of covariances and of the history
_HISTORY = 40
_ALIGNED_M, _ALIGNED_M_S = 0.3, 0.2  # what a filter on vision knows of its place and velocity
_SIGMA_M = (14.0, 14.0, 2.6)  # north, east, down at boot
_LEVEL_GAIN_PER_S = 0.4  # on the ground: gravity is all there is
_FLIGHT_GAIN_PER_S = 0.02  # in the air the accelerometer feels thrust, not gravity
_BIAS_GAIN_PER_S = 0.5  # on the ground: what turns is bias
_COMPASS_GAIN_PER_S = 0.3
_VISION_YAW_GAIN_PER_S = 1.0
_VELOCITY_NOISE = 0.15  # m/s per sqrt(s): accelerometer noise and vibration
_ERROR_NOISE = 0.03  # m/s^2 per sqrt(s): how fast tilt and bias errors wander
_ERROR_LIMIT_M_S2 = 1.5


class InertialFilter(ABC):
    """Position, velocity and attitude as the vehicle believes them, NED about its origin.

    An autopilot's own estimator adds `_maintain` and what aids it.

    Attributes:
        north, east, down: position (m), velocity (m/s) and error of the acceleration.
        alt_amsl_m: of the local frame's zero; `start_alt_amsl_m` of the start place.
        fusing: a position is fused now.
        reset_counter: of jumps of the position.
    """

    def __init__(self, heading_rad: float, alt_amsl_m: float) -> None:
        self.attitude = AttitudeFilter(heading_rad)
        self.north, self.east, self.down = (AxisFilter(sigma_m) for sigma_m in _SIGMA_M)
        self.alt_amsl_m = self.start_alt_amsl_m = alt_amsl_m
        self.origin: LocalFrame | None = None
        self.origin_t_s = -math.inf
        self.fusing = False
        self.reset_counter = 0
        self.t_s = 0.0
        self._history: deque[tuple[float, float, float, float]] = deque(maxlen=_HISTORY)
        self._slow_s = 0.0

    @property
    def sigma_horizontal_m(self) -> float:
        """One sigma of the horizontal position (eph)."""
        return math.hypot(self.north.sigma_m, self.east.sigma_m)

    def align(
        self,
        place_ned_m: tuple[float, float, float],
        velocity_ned_m_s: tuple[float, float, float],
        quat_wxyz: tuple[float, float, float, float],
        gyro_bias_rad_s: Sequence[float],
    ) -> None:
        """Know where it is, as after a flight on vision that came until now."""
        axes = (AxisFilter(_ALIGNED_M), AxisFilter(_ALIGNED_M), AxisFilter(_ALIGNED_M))
        for axis, place_m, speed_m_s in zip(axes, place_ned_m, velocity_ned_m_s, strict=True):
            axis.x, axis.v, axis.p11 = place_m, speed_m_s, _ALIGNED_M_S**2
        self.north, self.east, self.down = axes
        self.attitude.align(quat_wxyz, gyro_bias_rad_s)
        self.fusing = True
        self._history.clear()

    def propagate(self, imu: Imu, t_s: float, dt_s: float, on_ground: bool) -> None:
        """Advance by one inertial sample that ends at `t_s`."""
        self.t_s = t_s
        self.attitude.step(imu, on_ground, self.fusing, dt_s)
        fn, fe, fd = self.attitude.specific_force_ned(imu)
        self.north.predict(fn, dt_s)
        self.east.predict(fe, dt_s)
        self.down.predict(fd + GRAVITY_M_S2, dt_s)
        self._slow_s += dt_s
        if self._slow_s >= _SLOW_STEP_S:
            for axis in (self.north, self.east, self.down):
                axis.grow(self._slow_s)
            self._history.append((t_s, self.north.x, self.east.x, self.down.x))
            self._maintain(self._slow_s, on_ground)
            self._slow_s = 0.0

    @abstractmethod
    def handle_baro(self, height_m: float) -> None:
        """Fuse a barometric height over the start place."""

    def handle_compass(self, heading_rad: float, dt_s: float) -> None:
        """Fuse a compass heading."""
        self.attitude.correct_heading(heading_rad, False, dt_s)

    @abstractmethod
    def _maintain(self, dt_s: float, on_ground: bool) -> None:
        """What is known without a measurement, every 20 ms."""

    def _stand(self) -> None:
        """On the ground it does not move: zero velocity update."""
        for axis in (self.north, self.east, self.down):
            axis.fuse_velocity(-axis.v, 0.1**2)

    def _level(self, dt_s: float, time_s: float) -> None:
        """Move the steady error of horizontal acceleration into the tilt it comes from."""
        share = dt_s / time_s
        self.attitude.tilt(share * self.east.b / GRAVITY_M_S2, -share * self.north.b / GRAVITY_M_S2)
        self.north.b -= share * self.north.b
        self.east.b -= share * self.east.b

    def _moved_since(self, t_s: float) -> tuple[float, float, float]:
        """How far the state went from `t_s` until now."""
        for past_s, north, east, down in reversed(self._history):
            if past_s <= t_s:
                return self.north.x - north, self.east.x - east, self.down.x - down
        return 0.0, 0.0, 0.0

    def _reset_to(self, north_m: float, east_m: float, variance_m2: float) -> None:
        """Jump."""
        self.north.reset_position(north_m, variance_m2)
        self.east.reset_position(east_m, variance_m2)
        self.reset_counter += 1
        self._history.clear()

    def geodetic(self) -> tuple[float, float, float] | None:
        """Latitude, longitude (deg) and altitude (m AMSL), None without an origin."""
        if self.origin is None:
            return None
        lat, lon, alt = self.origin.to_geodetic([self.north.x, self.east.x, self.down.x])
        return float(lat), float(lon), float(alt)


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
        """Turn about down at once, by any angle, as a realignment does."""
        w, x, y, z = self.quat_wxyz
        c, s = math.cos(0.5 * turn_rad), math.sin(0.5 * turn_rad)
        self.quat_wxyz = (c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w)
        self.rotation = rotation_of(*self.quat_wxyz)

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


class AxisFilter:
    """State `x` (m), `v` (m/s), `b` (m/s^2, added to the measured acceleration).

    The covariance is the upper triangle p00 p01 p02 p11 p12 p22. Kept as plain floats: it runs at
    250 Hz for three axes.
    """

    __slots__ = ("b", "p00", "p01", "p02", "p11", "p12", "p22", "v", "x")

    def __init__(self, sigma_m: float) -> None:
        self.x = self.v = self.b = 0.0
        self.p00, self.p11, self.p22 = sigma_m**2, 0.5**2, 0.3**2
        self.p01 = self.p02 = self.p12 = 0.0

    def predict(self, acceleration_m_s2: float, dt_s: float) -> None:
        """Carry the state `dt_s` forward."""
        step = (acceleration_m_s2 + self.b) * dt_s
        self.x += (self.v + 0.5 * step) * dt_s
        self.v += step

    def grow(self, dt_s: float) -> None:
        """Carry the covariance `dt_s` forward: P = F P F' + Q."""
        h = 0.5 * dt_s * dt_s
        p01 = self.p01 + dt_s * self.p11 + h * self.p12
        p02 = self.p02 + dt_s * self.p12 + h * self.p22
        p12 = self.p12 + dt_s * self.p22
        self.p00 += dt_s * (self.p01 + p01) + h * (self.p02 + p02)
        self.p11 += dt_s * (self.p12 + p12) + _VELOCITY_NOISE**2 * dt_s
        self.p22 += _ERROR_NOISE**2 * dt_s
        self.p01 = p01 + dt_s * p02
        self.p02, self.p12 = p02, p12

    def fuse_position(self, innovation_m: float, variance_m2: float) -> None:
        """Correct with a position that lies `innovation_m` past the state."""
        self._fuse(innovation_m, variance_m2, 0)

    def fuse_velocity(self, innovation_m_s: float, variance_m2_s2: float) -> None:
        """Correct with a velocity that lies `innovation_m_s` past the state."""
        self._fuse(innovation_m_s, variance_m2_s2, 1)

    def _fuse(self, innovation: float, variance: float, column: int) -> None:
        """Kalman update by the state number `column`: x += K y, P -= K P[column]."""
        column_0 = (self.p00, self.p01, self.p02)
        c0, c1, c2 = column_0 if column == 0 else (self.p01, self.p11, self.p12)
        scale = 1.0 / ((c0 if column == 0 else c1) + variance)
        self.x += c0 * scale * innovation
        self.v += c1 * scale * innovation
        self.b += c2 * scale * innovation
        self.b = min(max(self.b, -_ERROR_LIMIT_M_S2), _ERROR_LIMIT_M_S2)
        self.p00 -= c0 * c0 * scale
        self.p01 -= c0 * c1 * scale
        self.p02 -= c0 * c2 * scale
        self.p11 -= c1 * c1 * scale
        self.p12 -= c1 * c2 * scale
        self.p22 -= c2 * c2 * scale

    def reset_position(self, position_m: float, variance_m2: float) -> None:
        """Jump to a position; what was known of it is forgotten, the velocity is doubted."""
        self.x, self.p00 = position_m, variance_m2
        self.p01 = self.p02 = 0.0
        self.p11 = max(self.p11, 0.3**2)

    def reset_velocity(self, velocity_m_s: float, variance_m2_s2: float) -> None:
        """Jump to a velocity; what was known of it is forgotten."""
        self.v, self.p11 = velocity_m_s, variance_m2_s2
        self.p01 = self.p12 = 0.0

    def velocity_ratio(self, innovation_m_s: float, variance_m2_s2: float, gate: float) -> float:
        """As `test_ratio`, of a velocity."""
        return innovation_m_s**2 / (gate**2 * (self.p11 + variance_m2_s2))

    def test_ratio(self, innovation_m: float, variance_m2: float, gate: float) -> float:
        """Squared innovation over its gate; more than 1 is refused (EKF2's test ratio)."""
        return innovation_m**2 / (max(gate, 0.1) ** 2 * (self.p00 + variance_m2))

    @property
    def sigma_m(self) -> float:
        """One sigma of the position."""
        return math.sqrt(max(self.p00, 0.0))
