"""Cascaded multicopter control: position, velocity, attitude, body rates, mixer; as PX4 has it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from vwnav.sim.multirotor.airframe import GRAVITY_M_S2
from vwnav.sim.multirotor.inertial_filter import InertialFilter
from vwnav.sim.multirotor.setpoint import Setpoint

_RATE_I_PER_S = 0.2
_YAW_RATE_P = 0.2
_RATE_LIMIT_RAD_S = 3.8  # MC_ROLLRATE_MAX 220 deg/s
_YAW_RATE_LIMIT_RAD_S = 1.05  # MPC_YAWRAUTO_MAX 60 deg/s
_INTEGRAL_LIMIT = 0.3


@dataclass(frozen=True, slots=True, kw_only=True)
class Gains:
    """Gains and limits of the loops.

    Attributes:
        xy_p, z_p: of position (1/s).
        vxy_p, vxy_i, vz_p, vz_i: of velocity, to acceleration (1/s, 1/s^2).
        v_max_m_s, up_max_m_s, down_max_m_s: limits of the velocity asked for.
        hover, thrust_min, thrust_max: shares of full thrust.
        tilt_max_rad: in the air.
        roll_p, pitch_p, yaw_p: of attitude (1/s); `rate_p` of body rates.
    """

    xy_p: float
    z_p: float
    vxy_p: float
    vxy_i: float
    vz_p: float
    vz_i: float
    v_max_m_s: float
    up_max_m_s: float
    down_max_m_s: float
    hover: float
    thrust_min: float
    thrust_max: float
    tilt_max_rad: float
    roll_p: float
    pitch_p: float
    yaw_p: float
    rate_p: float


class Controller:
    """Turns a Setpoint and the estimate into four rotor commands.

    Attributes:
        gains: may be changed at any time.
        setpoint: what to follow; with `thrust` (0..1) and `attitude_wxyz` what telemetry shows.
    """

    def __init__(self, gains: Gains, heading_rad: float) -> None:
        self.gains = gains
        self.setpoint = Setpoint(idle=True)
        self.thrust = 0.0
        self.velocity_sp = (0.0, 0.0, 0.0)
        self.attitude_wxyz = (math.cos(heading_rad / 2), 0.0, 0.0, math.sin(heading_rad / 2))
        self.rates_sp = (0.0, 0.0, 0.0)
        self.reset()

    def reset(self) -> None:
        """Forget the integrals, for a stand on the ground."""
        self._in = self._ie = self._id = 0.0
        self._ip = self._iq = self._ir = 0.0
        self._yaw_hold_rad: float | None = None

    def step_position(self, estimate: InertialFilter, dt_s: float, landed: bool) -> None:
        """Outer loops: from the setpoint to thrust and attitude (at 125 Hz)."""
        sp = self.setpoint
        if sp.idle:
            self.reset()
            self.thrust = 0.0
            half = 0.5 * estimate.attitude.yaw_rad
            self.attitude_wxyz = (math.cos(half), 0.0, 0.0, math.sin(half))
            return
        if landed:
            self.reset()
        an, ae = self._horizontal(sp, estimate, dt_s)
        lift_m_s2 = self._lift(sp, estimate, dt_s)
        limit = math.tan(self.gains.tilt_max_rad) * lift_m_s2
        if landed:
            limit = min(limit, math.tan(math.radians(12.0)) * lift_m_s2)  # MPC_TILTMAX_LND
        norm = math.hypot(an, ae)
        if norm > limit:
            an, ae = an * limit / norm, ae * limit / norm
        self._point(an, ae, lift_m_s2, self._yaw_of(sp, estimate))

    def _horizontal(
        self, sp: Setpoint, estimate: InertialFilter, dt_s: float
    ) -> tuple[float, float]:
        """Accelerations north and east (m/s^2), PX4's PositionControl without its corner cases."""
        north, east = estimate.north, estimate.east
        vn, ve = sp.vn_m_s, sp.ve_m_s
        if sp.north_m is not None and sp.east_m is not None:
            vn = self.gains.xy_p * (sp.north_m - north.x) + (vn or 0.0)
            ve = self.gains.xy_p * (sp.east_m - east.x) + (ve or 0.0)
        if vn is None or ve is None:
            self._in = self._ie = 0.0
            return sp.an_m_s2 or 0.0, sp.ae_m_s2 or 0.0
        speed = math.hypot(vn, ve)
        if speed > self.gains.v_max_m_s:
            vn, ve = vn * self.gains.v_max_m_s / speed, ve * self.gains.v_max_m_s / speed
        self.velocity_sp = (vn, ve, self.velocity_sp[2])
        dn, de = vn - north.v, ve - east.v
        an = self.gains.vxy_p * dn + self._in + (sp.an_m_s2 or 0.0)
        ae = self.gains.vxy_p * de + self._ie + (sp.ae_m_s2 or 0.0)
        if math.hypot(an, ae) < 5.0:  # anti-windup while the tilt is near its limit
            self._in += self.gains.vxy_i * dn * dt_s
            self._ie += self.gains.vxy_i * de * dt_s
        return an, ae

    def _lift(self, sp: Setpoint, estimate: InertialFilter, dt_s: float) -> float:
        """Upward specific force to produce (m/s^2), between the thrust limits."""
        scale = GRAVITY_M_S2 / self.gains.hover
        if sp.thrust is not None:
            return max(0.0, sp.thrust) * scale
        down = estimate.down
        vd = sp.vd_m_s
        if sp.down_m is not None:
            vd = self.gains.z_p * (sp.down_m - down.x) + (vd or 0.0)
        vd = min(max(vd or 0.0, -self.gains.up_max_m_s), self.gains.down_max_m_s)
        self.velocity_sp = (self.velocity_sp[0], self.velocity_sp[1], vd)
        error = vd - down.v
        lift = GRAVITY_M_S2 - self.gains.vz_p * error - self._id
        low, high = self.gains.thrust_min * scale, self.gains.thrust_max * scale
        if (low < lift or error < 0.0) and (lift < high or error > 0.0):
            self._id += self.gains.vz_i * error * dt_s
            self._id = min(max(self._id, -GRAVITY_M_S2), GRAVITY_M_S2)
        return min(max(lift, low), high)

    def _yaw_of(self, sp: Setpoint, estimate: InertialFilter) -> float:
        yaw_rad = estimate.attitude.yaw_rad
        if sp.yaw_rad is not None:
            self._yaw_hold_rad = None
            return sp.yaw_rad
        if sp.yaw_rate_rad_s:
            self._yaw_hold_rad = None
            return yaw_rad + sp.yaw_rate_rad_s / self.gains.yaw_p
        if self._yaw_hold_rad is None:
            self._yaw_hold_rad = yaw_rad
        return self._yaw_hold_rad

    def _point(self, an: float, ae: float, lift: float, yaw_rad: float) -> None:
        """Attitude whose body z pushes along the wanted force, and the thrust along it."""
        force = math.sqrt(an * an + ae * ae + lift * lift)
        self.attitude_wxyz = attitude_of_force(an, ae, -lift, yaw_rad)
        self.thrust = min(self.gains.thrust_max, self.gains.hover * force / GRAVITY_M_S2)

    def step_attitude(
        self, estimate: InertialFilter, dt_s: float
    ) -> tuple[float, float, float, float]:
        """Inner loops: from attitude to rotor commands 0..1 (at 250 Hz)."""
        attitude = estimate.attitude
        if self.thrust <= 0.0:
            return 0.02, 0.02, 0.02, 0.02
        ep, eq, er = _attitude_error(attitude.quat_wxyz, self.attitude_wxyz)
        p_sp = _limit(self.gains.roll_p * ep, _RATE_LIMIT_RAD_S)
        q_sp = _limit(self.gains.pitch_p * eq, _RATE_LIMIT_RAD_S)
        r_sp = _limit(self.gains.yaw_p * er, _YAW_RATE_LIMIT_RAD_S)
        self.rates_sp = (p_sp, q_sp, r_sp)
        p, q, r = attitude.rates
        ep, eq, er = p_sp - p, q_sp - q, r_sp - r
        gain = _RATE_I_PER_S * dt_s
        self._ip = _limit(self._ip + gain * ep, _INTEGRAL_LIMIT)
        self._iq = _limit(self._iq + gain * eq, _INTEGRAL_LIMIT)
        self._ir = _limit(self._ir + 0.5 * gain * er, _INTEGRAL_LIMIT)
        return _mix(
            self.thrust,
            self.gains.rate_p * ep + self._ip,
            self.gains.rate_p * eq + self._iq,
            _limit(_YAW_RATE_P * er + self._ir, 0.15),
        )


def _attitude_error(
    is_wxyz: Sequence[float], wanted_wxyz: Sequence[float]
) -> tuple[float, float, float]:
    """Rotation from one attitude to another, in the body (rad): 2 * vec(conj(q) q_sp)."""
    w, x, y, z = is_wxyz
    a, b, c, d = wanted_wxyz
    scalar = w * a + x * b + y * c + z * d
    sign = 2.0 if scalar >= 0.0 else -2.0
    return (
        sign * (w * b - x * a - y * d + z * c),
        sign * (w * c + x * d - y * a - z * b),
        sign * (w * d - x * c + y * b - z * a),
    )


def _mix(thrust: float, roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Rotor commands of PX4's quad x, without airmode: thrust is lowered for torque, not raised."""
    f0, f1 = -roll + pitch + yaw, roll - pitch + yaw
    f2, f3 = roll + pitch - yaw, -roll - pitch - yaw
    low = -min(f0, f1, f2, f3)
    if low > thrust:
        share = thrust / low
        f0, f1, f2, f3 = share * f0, share * f1, share * f2, share * f3
    thrust = min(thrust, 1.0 - max(f0, f1, f2, f3))
    return (
        min(1.0, max(0.0, thrust + f0)),
        min(1.0, max(0.0, thrust + f1)),
        min(1.0, max(0.0, thrust + f2)),
        min(1.0, max(0.0, thrust + f3)),
    )


def attitude_of_force(
    fn: float, fe: float, fd: float, yaw_rad: float
) -> tuple[float, float, float, float]:
    """Quaternion wxyz of a body whose rotors push along a force in NED, with a heading.

    Level where there is no force.
    """
    force = math.sqrt(fn * fn + fe * fe + fd * fd) or 1.0
    zn, ze, zd = -fn / force, -fe / force, -fd / force  # body down axis in NED
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    # roll and pitch of Z-Y-X angles from body z, seen from the wanted heading
    forward, right = cos * zn + sin * ze, -sin * zn + cos * ze
    pitch = math.atan2(forward, zd)
    roll = -math.asin(min(1.0, max(-1.0, right)))
    return quat_of_euler(roll, pitch, yaw_rad)


def quat_of_euler(
    roll_rad: float, pitch_rad: float, yaw_rad: float
) -> tuple[float, float, float, float]:
    """Quaternion wxyz of R_ned_body from Z-Y-X angles."""
    cr, sr = math.cos(0.5 * roll_rad), math.sin(0.5 * roll_rad)
    cp, sp = math.cos(0.5 * pitch_rad), math.sin(0.5 * pitch_rad)
    cy, sy = math.cos(0.5 * yaw_rad), math.sin(0.5 * yaw_rad)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def _limit(value: float, bound: float) -> float:
    return min(max(value, -bound), bound)
