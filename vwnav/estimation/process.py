"""How the state moves between measurements."""

import math
from dataclasses import dataclass, replace

import numpy as np

from vwnav.estimation.config import EkfConfig
from vwnav.estimation.context import Context
from vwnav.estimation.inertial.attitudes import (
    GRAVITY_M_S2,
    level_axes,
    thrust_acceleration,
    yaw_of,
)
from vwnav.estimation.inertial.preintegration import Push, push_between
from vwnav.estimation.inertial.turning import conditioned, gyro_says
from vwnav.estimation.states import FilterState, Measured, States
from vwnav.geometry.rotations import wrap_pi
from vwnav.types import Array

_STEP_S = 0.1
_MOST_STEPS = 20  # a long silence is crossed in longer steps; only the thrust is then coarser
_N, _E, _D = 0, 1, 2
_VN, _VE, _VD = 3, 4, 5
_AN, _AE = 6, 7
_YAW = States.HEADING_BIAS.start
_FORWARD, _RIGHT = States.TILT.start, States.TILT.start + 1
_MAP = np.r_[States.MAP, States.MAP_TURN, States.MAP_SCALE]
_TERRAIN = States.TERRAIN.start
_FORCE_BIAS = np.arange(States.ACCELEROMETER_BIAS.start, States.ACCELEROMETER_BIAS.stop)
_RATE_BIAS = np.arange(States.GYRO_BIAS.start, States.GYRO_BIAS.stop)
_WIND = np.arange(States.WIND_FORCE.start, States.WIND_FORCE.stop)
_DRAG = States.DRAG.start
_IDENTITY = np.eye(States.SIZE)
_LEVEL = np.eye(2)


def predict(state: FilterState, t_s: float, context: Context) -> FilterState:
    """The state at a later time `t_s`."""
    span_s = t_s - state.t_s
    count = min(max(math.ceil(span_s / _STEP_S), 1), _MOST_STEPS)
    dt_s = span_s / count
    x, P = state.x, state.P
    quat, felt, carried_rad = state.measured or _measured(state.t_s, context)
    told = context.attitudes.tell(state.t_s)
    for i in range(count):
        end_s = state.t_s + (i + 1) * dt_s
        quat0, felt0, carried0_rad = quat, felt, carried_rad
        quat, felt, carried_rad = _measured(end_s, context)
        told0, told = told, context.attitudes.tell(end_s)
        both = told0 and told
        push = push_between(felt0, felt) if both else None
        span = _Span(dt_s, quat0, quat, push, both, carried_rad - carried0_rad)
        x, P = _step(x, P, span, context)
    return replace(state, t_s=t_s, x=x, P=P, measured=Measured(quat, felt, carried_rad))


def _measured(t_s: float, context: Context) -> Measured:
    attitudes = context.attitudes
    return Measured(attitudes.quat_at(t_s), context.imu.until(t_s), attitudes.carried_rad(t_s))


@dataclass(frozen=True, slots=True, eq=False)
class _Span:
    """A step of `dt_s`: the autopilot's attitudes (4,) at its ends, and what the IMU felt in it.

    `told` is False where attitudes are missing: nobody knows where the thrust pushed then;
    `carried_rad` is by how much more the gyro alone has turned the heading on at its end.
    """

    dt_s: float
    quat0: Array
    quat1: Array
    push: Push | None
    told: bool = True
    carried_rad: float = 0.0

    @property
    def quat(self) -> Array:
        """(4,) in the middle."""
        same = self.quat0 @ self.quat1 >= 0.0
        total = self.quat0 + self.quat1 if same else self.quat0 - self.quat1
        return np.asarray(total / math.sqrt(total @ total))


@dataclass(frozen=True, slots=True, eq=False)
class _SensedAcceleration:
    """Acceleration (3,) NED of a step, and how it changes with forward and right tilt error.

    `by_bias` (3, 3): with the accelerometer's bias; None when it comes from thrust, to which the
    slow acceleration must be added (`by_slow`), or when nothing is known.
    """

    acceleration: Array
    by_forward: tuple[float, float] = (0.0, 0.0)
    by_right: tuple[float, float] = (0.0, 0.0)
    by_bias: Array | None = None
    by_slow: bool = True


def _felt(x: Array, span: _Span, config: EkfConfig) -> _SensedAcceleration:
    """From the IMU or else the thrust, with heading bias and tilt error of the attitude taken out.

    A tilt error d = (d_n, d_e) shows the thrust g (-d_e, d_n) off.
    """
    push, dt_s = span.push, span.dt_s
    if not span.told:
        return _SensedAcceleration(np.zeros(3), by_slow=False)
    if push is None and not config.thrust_aided:
        return _SensedAcceleration(np.array([float(x[_AN]), float(x[_AE]), 0.0]))
    quat = span.quat
    bias_rad = float(x[_YAW])
    cos_b, sin_b = math.cos(bias_rad), math.sin(bias_rad)
    unturn = np.array([[cos_b, sin_b, 0.0], [-sin_b, cos_b, 0.0], [0.0, 0.0, 1.0]])
    by_bias = None
    if push is None:
        felt = unturn @ [*thrust_acceleration(quat), 0.0] + [float(x[_AN]), float(x[_AE]), 0.0]
    else:
        by_bias = -unturn @ push.rotation_s / dt_s
        felt = unturn @ push.velocity_m_s / dt_s + by_bias @ x[States.ACCELEROMETER_BIAS]
        felt[_D] += GRAVITY_M_S2 * push.lasted_s / dt_s
    yaw_rad = yaw_of(quat) - bias_rad
    c, s = GRAVITY_M_S2 * math.cos(yaw_rad), GRAVITY_M_S2 * math.sin(yaw_rad)
    forward, right = x[States.TILT].tolist()
    felt[:2] += s * forward + c * right, -c * forward + s * right
    return _SensedAcceleration(felt, (s, -c), (c, s), by_bias)


def _step(x: Array, P: Array, span: _Span, context: Context) -> tuple[Array, Array]:
    """One step of at most some tenths of a second: x' = f(x), P' = F P F^T + Q."""
    config, dt_s = context.config, span.dt_s
    felt = _felt(x, span, config)
    keep = math.exp(-dt_s / config.acceleration_time_s)
    keep_tilt = math.exp(-dt_s / config.tilt_time_s)
    flown_m = math.hypot(x[_VN], x[_VE]) * dt_s
    keep_map = math.exp(-flown_m / config.map_length_m)
    moved = x.copy()
    moved[States.POSITION] += dt_s * x[States.VELOCITY] + (0.5 * dt_s**2) * felt.acceleration
    moved[States.VELOCITY] += dt_s * felt.acceleration
    moved[States.ACCELERATION] *= keep
    F_tilt = keep_tilt * _tilt_turn(span)
    moved[States.TILT] = F_tilt @ x[States.TILT]
    moved[_MAP] *= keep_map

    F = _IDENTITY.copy()
    F[_N, _VN] = F[_E, _VE] = F[_D, _VD] = dt_s
    F[_AN, _AN] = F[_AE, _AE] = keep
    if felt.by_bias is None and felt.by_slow:
        F[_N, _AN] = F[_E, _AE] = 0.5 * dt_s**2
        F[_VN, _AN] = F[_VE, _AE] = dt_s
    elif felt.by_bias is not None:
        F[States.VELOCITY, States.ACCELEROMETER_BIAS] = dt_s * felt.by_bias
    # A wrong heading turns the acceleration, a wrong tilt adds to it.
    thrust = felt.by_bias is None and felt.by_slow
    slow = (x[_AN], x[_AE]) if thrust else (0.0, 0.0)
    F[_VN, _YAW] = dt_s * (felt.acceleration[1] - slow[1])
    F[_VE, _YAW] = -dt_s * (felt.acceleration[0] - slow[0])
    F[_VN, _FORWARD], F[_VE, _FORWARD] = (dt_s * by for by in felt.by_forward)
    F[_VN, _RIGHT], F[_VE, _RIGHT] = (dt_s * by for by in felt.by_right)
    F[States.TILT, States.TILT] = F_tilt
    F[_MAP, _MAP] = keep_map
    known = _follow_ground(x, moved, F, dt_s, context)
    Q = _process_noise(span, x, flown_m, known, config)
    if span.push is None:
        predicted = F @ P @ F.T + Q
    else:
        quats = span.quat0, span.quat1
        turned = gyro_says(x, span.push, quats, dt_s, F_tilt, config)
        moved, predicted = conditioned(moved, P, F, Q, turned)
        moved[_YAW] = wrap_pi(float(moved[_YAW]))
    return moved, 0.5 * (predicted + predicted.T)


def _tilt_turn(span: _Span) -> Array:
    """(2, 2) how the tilt error turns about the body: the autopilot's goes with it, mostly.

    That of an attitude which the gyro carries on stays where it was, whichever way the body turns,
    until the autopilot tells one again.
    """
    return _LEVEL if span.carried_rad == 0.0 else level_axes(span.carried_rad).T


def _follow_ground(x: Array, moved: Array, F: Array, dt_s: float, context: Context) -> bool:
    """Let the ground below rise as the terrain table says; whether it says anything.

    The ground is table(place) + its own error: terrain' = terrain + table(p') - table(p).
    """
    if context.ground is None:
        return False
    before = context.patch(float(x[_N]), float(x[_E]))
    after = context.patch(float(moved[_N]), float(moved[_E]))
    if before is None or after is None:
        return False
    moved[_TERRAIN] += after.height_m - before.height_m
    F[_TERRAIN, _N] = after.per_north - before.per_north
    F[_TERRAIN, _E] = after.per_east - before.per_east
    F[_TERRAIN, _VN], F[_TERRAIN, _VE] = after.per_north * dt_s, after.per_east * dt_s
    return True


def _process_noise(
    span: _Span, x: Array, flown_m: float, ground_known: bool, config: EkfConfig
) -> Array:
    """Q of one step: white acceleration, random walks, and what feeds the Gauss-Markov states."""
    dt_s, push = span.dt_s, span.push
    Q = np.zeros((States.SIZE, States.SIZE))
    level, vertical = config.acceleration_noise_m_s2**2, config.vertical_noise_m_s2**2
    heading = config.heading_walk_rad**2
    if not span.told:
        level, vertical = config.lost_noise_m_s2**2, config.lost_climb_noise_m_s2**2
    if push is not None:
        level = vertical = config.imu_noise_m_s2**2 + push.shaken_m2_s2 / dt_s
        heading = config.heading_slew_rad**2
        Q[_FORCE_BIAS, _FORCE_BIAS] = config.accelerometer_walk_m_s2**2 * dt_s
        Q[_RATE_BIAS, _RATE_BIAS] = config.gyro_walk_rad_s**2 * dt_s
        Q[_WIND, _WIND] = (config.wind_walk_m_s * float(x[_DRAG])) ** 2 * dt_s
        Q[_DRAG, _DRAG] = config.drag_walk_per_s**2 * dt_s
    if -x[_D] - x[_TERRAIN] < config.blow_agl_m:
        level = max(level, config.blow_noise_m_s2**2)
    for p, v, q in ((_N, _VN, level), (_E, _VE, level), (_D, _VD, vertical)):
        Q[p, p] = q * dt_s**3 / 3.0
        Q[p, v] = Q[v, p] = q * dt_s**2 / 2.0
        Q[v, v] = q * dt_s
    fed = 1.0 - math.exp(-2.0 * dt_s / config.acceleration_time_s)
    Q[_AN, _AN] = Q[_AE, _AE] = config.acceleration_sigma_m_s2**2 * fed
    fed_tilt = 1.0 - math.exp(-2.0 * dt_s / config.tilt_time_s)
    Q[_FORWARD, _FORWARD] = Q[_RIGHT, _RIGHT] = config.tilt_sigma_rad**2 * fed_tilt
    fed_map = 1.0 - math.exp(-2.0 * flown_m / config.map_length_m)
    sigmas = config.map_sigma_m, config.map_sigma_m, config.map_turn_rad, config.map_scale
    Q[_MAP, _MAP] = np.square(sigmas) * fed_map
    Q[_YAW, _YAW] = heading * dt_s
    baro = States.BARO.start
    Q[baro, baro] = (
        config.baro_walk_m**2 * dt_s + config.baro_climb_walk_m**2 * abs(float(x[_VD])) * dt_s
    )
    walk_m = config.terrain_walk_known_m if ground_known else config.terrain_walk_m
    Q[_TERRAIN, _TERRAIN] = walk_m**2 * flown_m
    return Q
