"""How the state moves between measurements: two process models, each -> (x, F, Q).

The thrust model holds where no IMU is streamed, the IMU model where one is. `predict` propagates by
the one or the other: x' = f(x), P' = F P F^T + Q, in steps of at most some tenths of a second.
"""

import math
from typing import NamedTuple

import numpy as np

from vwnav.estimation.config import EkfConfig
from vwnav.estimation.context import Context
from vwnav.estimation.inertial.attitudes import (
    GRAVITY_M_S2,
    Held,
    level_axes,
    thrust_acceleration,
    true_from_autopilot,
    yaw_of,
)
from vwnav.estimation.inertial.gyro_aiding import correlated_noise_update, gyro_measurement
from vwnav.estimation.inertial.integrals import Measured, white_acceleration
from vwnav.estimation.inertial.preintegration import PreintegratedImu, preintegrated
from vwnav.estimation.states import FilterState, States
from vwnav.geometry.rotations import quat_multiply, wrap_pi
from vwnav.types import Array

_STEP_S = 0.1
_MOST_STEPS = 20  # a long silence is crossed in longer steps; only the thrust is then coarser
_MAP_TURN_AND_SCALE = slice(States.MAP_TURN, States.MAP_SCALE + 1)
_OPEN_RAD = 1.0  # a turn by so much in a silence opens the tilt whole, in however many steps
_STORM_M_S = 20.0  # no wind that is flown in is stronger
_CALM_BELOW_M = 1.0  # height above ground: nothing is told of the air below
_LEVEL, _SPACE, _IDENTITY = np.eye(2), np.eye(3), np.eye(States.SIZE)
_GRAVITY = np.array([0.0, 0.0, GRAVITY_M_S2])


class Transition(NamedTuple):
    """One step: the state after it (n,), F = dx'/dx (n, n) and the process noise Q (n, n)."""

    x: Array
    F: Array
    Q: Array


class TimeStep(NamedTuple):
    """The time between `state` and a later one, and what the autopilot tells of it.

    Attributes:
        dt_s: how long it takes.
        quat0_wxyz, quat1_wxyz: (4,) the autopilot's attitudes at its ends.
        attitude_known: False where attitudes are missing: nobody knows where the thrust pushed.
        turned_rad: by how much the heading has turned in it, where an IMU was ever heard: by the
            gyro, and in a silence by the attitudes.
        imu: what was felt; None in a silence, and where attitudes are missing.
        place_known: False where the place only stands for one that nobody knows.
        relief_m: one sigma of the heights of what stands on the ground.
        stands: nothing pushes: a moment ago the aircraft stood disarmed.
        map_sigma_m: of the map from place to place, per axis.
    """

    dt_s: float
    quat0_wxyz: Array
    quat1_wxyz: Array
    attitude_known: bool
    turned_rad: float
    imu: PreintegratedImu | None
    place_known: bool = True
    relief_m: float = 0.0
    stands: bool = False
    map_sigma_m: float = 0.0

    @property
    def quat_wxyz(self) -> Array:
        """(4,) in the middle."""
        quat0, quat1 = self.quat0_wxyz, self.quat1_wxyz
        total = quat0 + quat1 if quat0 @ quat1 >= 0.0 else quat0 - quat1
        return np.asarray(total / math.sqrt(total @ total))


def predict(state: FilterState, t_s: float, context: Context) -> FilterState:
    """The state at a later time `t_s`."""
    span_s = t_s - state.t_s
    count = min(max(math.ceil(span_s / _STEP_S), 1), _MOST_STEPS)
    dt_s = span_s / count
    x, P, attitudes = state.x, state.P, context.attitudes
    stands_until_s = state.stood_s + context.config.stationary_s
    one = state.measured
    if one is None or not one.known:  # by now it may be: another attitude, not another error of it
        one = _measured(attitudes.held(state.t_s), state.t_s, context)
    known = attitudes.knows(state.t_s)
    for i in range(count):
        end_s = state.t_s + (i + 1) * dt_s
        held = attitudes.held(end_s)
        zero, one = one, _measured(held, end_s, context)
        known0, known = known, held.known
        imu = preintegrated(zero.felt, one.felt) if known0 and known else None
        end_wxyz = one.quat_wxyz if imu is None else quat_multiply(zero.quat_wxyz, imu.turn_wxyz)
        turned_rad = wrap_pi(yaw_of(end_wxyz) - yaw_of(zero.quat_wxyz))
        step = TimeStep(
            dt_s,
            zero.quat_wxyz,
            one.quat_wxyz,
            known0 and known,
            turned_rad if context.imu.heard else 0.0,
            imu,
            state.position_known,
            state.relief_m,
            stands=end_s < stands_until_s,
            map_sigma_m=state.map_error.sigma_m,
        )
        x, P = _propagate(x, P, step, context)
    return state._replace(t_s=t_s, x=x, P=P, measured=one)


def _measured(held: Held, t_s: float, context: Context) -> Measured:
    """What the autopilot tells of a time, by what has come of it until now."""
    return Measured(held.quat_wxyz, held.known, context.imu.until(t_s))


def _propagate(x: Array, P: Array, step: TimeStep, context: Context) -> tuple[Array, Array]:
    """One step; with an IMU its gyro is heard in the same breath (`gyro_aiding.py`)."""
    if step.imu is None:
        x, F, Q = thrust_model(x, step, context)
        P = F @ P @ F.T + Q
        return x, 0.5 * (P + P.T)
    predicted, F, Q = imu_model(x, step, step.imu, context)
    quats, F_tilt = (step.quat0_wxyz, step.quat1_wxyz), F[States.TILT, States.TILT]
    change = gyro_measurement(x, step.imu, quats, step.dt_s, F_tilt, context.config)
    x, P = correlated_noise_update(predicted, P, F, Q, change)
    x[States.HEADING_BIAS] = wrap_pi(float(x[States.HEADING_BIAS]))
    return x, 0.5 * (P + P.T)


def thrust_model(x: Array, step: TimeStep, context: Context) -> Transition:
    """Without an IMU: thrust as the attitude has it, and the slow acceleration of drag and wind.

    Where attitudes are missing nothing is known of the acceleration but its white noise, and the
    autopilot may realign its heading unseen.
    """
    config, dt_s = context.config, step.dt_s
    if not step.attitude_known:
        moved, F, Q = _transition(x, np.zeros(3), np.zeros(2), dt_s, step, context)
        level, vertical = config.lost_noise_m_s2**2, config.lost_climb_noise_m_s2**2
        if step.stands:
            level, vertical = config.acceleration_noise_m_s2**2, config.vertical_noise_m_s2**2
        Q[States.MOTION, States.MOTION] = _white_acceleration(x, level, vertical, dt_s, config)
        Q[States.HEADING_BIAS, States.HEADING_BIAS] = config.heading_slew_rad**2 * dt_s
        return Transition(moved, F, Q)
    slow = np.array([*x[States.ACCELERATION], 0.0])
    acceleration, by_tilt = slow, np.zeros((2, 2))
    if config.thrust_aided:
        thrust = np.array([*thrust_acceleration(step.quat_wxyz), 0.0])
        tilted, by_tilt = _gravity_by_tilt(x, step.quat_wxyz)
        R_true_autopilot = true_from_autopilot(float(x[States.HEADING_BIAS]))
        acceleration = R_true_autopilot @ thrust + slow + tilted
    moved, F, Q = _transition(
        x, dt_s * acceleration, dt_s * (acceleration - slow)[:2], dt_s, step, context
    )
    F[States.POSITION_NE, States.ACCELERATION] = 0.5 * dt_s**2 * _LEVEL
    F[States.VELOCITY_NE, States.ACCELERATION] = dt_s * _LEVEL
    F[States.VELOCITY_NE, States.TILT] = dt_s * by_tilt
    level, vertical = config.acceleration_noise_m_s2**2, config.vertical_noise_m_s2**2
    Q[States.MOTION, States.MOTION] = _white_acceleration(x, level, vertical, dt_s, config)
    Q[States.HEADING_BIAS, States.HEADING_BIAS] = config.heading_walk_rad**2 * dt_s
    return Transition(moved, F, Q)


def imu_model(x: Array, step: TimeStep, imu: PreintegratedImu, context: Context) -> Transition:
    """With an IMU: its accelerometer, less its bias, stands in for thrust and drag.

    The aircraft moves for as long as the sensor's own clock says. That of a simulator which gets no
    processor stands for a while: the filter flew on, 4.5 m in 0.6 s, and was 9 sigmas wrong.

    The autopilot's attitude is made of the same gyro: what that scatters by, it wanders by as well.
    PX4's simulated IMU of the 1.16 era is noisy in the air (0.12 rad/s about the nose): its roll
    wanders by 0.5 to 0.7 degrees per root second, its heading by 1.6.
    """
    config, dt_s, flown_s = context.config, step.dt_s, imu.span_s
    R_true_autopilot = true_from_autopilot(float(x[States.HEADING_BIAS]))
    by_bias_s = -R_true_autopilot @ imu.rotation_s
    tilted, by_tilt = _gravity_by_tilt(x, step.quat_wxyz)
    felt_m_s = R_true_autopilot @ imu.velocity_m_s + by_bias_s @ x[States.ACCELEROMETER_BIAS]
    gained_m_s = felt_m_s + flown_s * (tilted + _GRAVITY)
    moved, F, Q = _transition(x, gained_m_s, gained_m_s[:2], flown_s, step, context)
    F[States.VELOCITY, States.ACCELEROMETER_BIAS] = by_bias_s
    F[States.VELOCITY_NE, States.TILT] = flown_s * by_tilt
    white = config.imu_noise_m_s2**2 + imu.velocity_variance_m2_s2 / dt_s
    air = _air(x, dt_s, config)
    moved[States.WIND_FORCE] *= air.keep_wind
    moved[States.GUST_FORCE] *= air.keep_gust
    keeps, walks = _diagonal(F), _diagonal(Q)
    keeps[States.WIND_FORCE] = air.keep_wind
    keeps[States.GUST_FORCE] = air.keep_gust
    Q[States.MOTION, States.MOTION] = _white_acceleration(x, white, white, dt_s, config)
    wanders = imu.turn_variance_rad2
    walks[States.HEADING_BIAS] = config.heading_slew_rad**2 * dt_s + wanders
    walks[States.TILT] += config.tilt_slew_rad**2 * dt_s + wanders
    walks[States.ACCELEROMETER_BIAS] = config.accelerometer_walk_m_s2**2 * dt_s
    walks[States.GYRO_BIAS] = config.gyro_walk_rad_s**2 * dt_s
    walks[States.DRAG] = config.drag_walk_per_s**2 * dt_s
    walks[States.WIND_FORCE] = air.wind_m2_s4
    walks[States.GUST_FORCE] = air.gust_m2_s4
    return Transition(moved, F, Q)


def _diagonal(square: Array) -> Array:
    """(n,) the diagonal of (n, n), to be written to."""
    return square.reshape(-1)[:: len(square) + 1]


class _Air(NamedTuple):
    """Over a step: the shares of mean wind and gusts that stay, and what is fed to their forces."""

    keep_wind: float
    keep_gust: float
    wind_m2_s4: float
    gust_m2_s4: float


def _air(x: Array, dt_s: float, config: EkfConfig) -> _Air:
    """How the air changes. What it is worth the drag says.

    The mean wind W goes by height as ln(1 + h / z0) does (the surface layer's logarithmic profile,
    MIL-F-8785C eq. 3.7.3): a descent h -> h (1 + d) keeps 1 + a d of it, with the local exponent
    a = r / ((1 + r) ln(1 + r)), r = h / z0. Turbulence is a Gauss-Markov process, whose sigma is a
    share of W and which passes in L / W seconds (Dryden's model at low altitude).
    """
    drag_per_s = float(x[States.DRAG])
    force_m_s2 = min(math.hypot(*x[States.WIND_FORCE].tolist()), drag_per_s * _STORM_M_S)
    agl_m = max(-float(x[States.DOWN] + x[States.TERRAIN]), _CALM_BELOW_M)
    climbed = max(min(-dt_s * float(x[States.VELOCITY_DOWN]) / agl_m, 0.5), -0.5)
    ratio = agl_m / config.roughness_m
    exponent = ratio / ((1.0 + ratio) * math.log1p(ratio))
    sheared_m_s2 = config.shear_share * exponent * force_m_s2
    keep_gust = math.exp(-dt_s * force_m_s2 / drag_per_s / config.gust_length_m)
    return _Air(
        1.0 + exponent * climbed,
        keep_gust,
        (config.wind_walk_m_s * drag_per_s) ** 2 * dt_s + sheared_m_s2**2 * abs(climbed),
        (config.gust_share * force_m_s2) ** 2 * (1.0 - keep_gust**2),
    )


def _gravity_by_tilt(x: Array, quat_wxyz: Array) -> tuple[Array, Array]:
    """What the tilt error hides of the acceleration (3,), and how that goes by it (2, 2).

    A tilt error d = (d_n, d_e) shows the thrust g (-d_e, d_n) off.
    """
    yaw_rad = yaw_of(quat_wxyz) - float(x[States.HEADING_BIAS])
    c, s = GRAVITY_M_S2 * math.cos(yaw_rad), GRAVITY_M_S2 * math.sin(yaw_rad)
    forward, right = x[States.TILT].tolist()
    hidden = np.array([s * forward + c * right, -c * forward + s * right, 0.0])
    return hidden, np.array([[s, c], [-c, s]])


def _white_acceleration(
    x: Array, level: float, vertical: float, dt_s: float, config: EkfConfig
) -> Array:
    """(6, 6) of Q; near the ground it may be struck, and far from it what a camera shows swings."""
    agl_m, blow = -float(x[States.DOWN] + x[States.TERRAIN]), config.blow_noise_m_s2**2
    level += (config.swing_noise_rad_s2 * max(agl_m, 0.0)) ** 2
    if agl_m < config.blow_agl_m:
        level = max(level, blow)
    if agl_m < config.touching_agl_m:
        vertical = max(vertical, blow)
    return white_acceleration(level, vertical, dt_s)


def _transition(
    x: Array, gained: Array, turned: Array, flown_s: float, step: TimeStep, context: Context
) -> Transition:
    """What both models share: motion in `flown_s` seconds, Gauss-Markov states, the ground.

    `gained` (3,) is the velocity gained in them, m/s, and `turned` (2,) what of it, north and east,
    turns with a wrong heading.
    """
    config, dt_s = context.config, step.dt_s
    # Of what was guessed beyond the newest sample some is taken back: nothing walks backwards.
    flown_m = math.hypot(*x[States.VELOCITY_NE].tolist()) * max(flown_s, 0.0)
    # Where an IMU was heard a tilt error stays in NED but for what that says; else it turns with
    # the body. Against such a model the gyro could not hold it: 2.5 degrees were 1.1 after a turn.
    F_tilt = math.exp(-dt_s / config.tilt_time_s) * level_axes(step.turned_rad).T
    F = _IDENTITY.copy()
    keeps = _diagonal(F)
    keeps[States.ACCELERATION] = math.exp(-dt_s / config.acceleration_time_s)
    keeps[States.MAP] = keeps[_MAP_TURN_AND_SCALE] = math.exp(-flown_m / config.map_length_m)
    keeps[States.SLOPE] = math.exp(-flown_m / config.slope_length_m)
    moved = keeps * x
    moved[States.POSITION] += flown_s * x[States.VELOCITY] + (0.5 * flown_s) * gained
    moved[States.VELOCITY] += gained
    moved[States.TILT] = F_tilt @ x[States.TILT]
    way_m = moved[States.POSITION_NE] - x[States.POSITION_NE]
    moved[States.TERRAIN] += x[States.SLOPE] @ way_m

    F[States.POSITION, States.VELOCITY] = flown_s * _SPACE
    F[States.VELOCITY_NE, States.HEADING_BIAS] = turned[1], -turned[0]
    F[States.TILT, States.TILT] = F_tilt
    F[States.TERRAIN, States.SLOPE] = way_m
    F[States.TERRAIN, States.VELOCITY_NE] = flown_s * x[States.SLOPE]
    known = step.place_known and _follow_ground(x, moved, F, flown_s, context)
    return Transition(moved, F, _walks(x, step, flown_m, known, config))


def _follow_ground(x: Array, moved: Array, F: Array, flown_s: float, context: Context) -> bool:
    """Let the ground below rise as the terrain table says; whether it says anything.

    The ground is table(place) + its own error: terrain' = terrain + table(p') - table(p).
    """
    if context.ground is None:
        return False
    before = context.patch(*x[States.POSITION_NE].tolist())
    after = context.patch(*moved[States.POSITION_NE].tolist())
    if before is None or after is None:
        return False
    moved[States.TERRAIN] += after.height_m - before.height_m
    slope0 = np.array([before.per_north, before.per_east])
    slope1 = np.array([after.per_north, after.per_east])
    F[States.TERRAIN, States.POSITION_NE] = slope1 - slope0
    F[States.TERRAIN, States.VELOCITY_NE] += slope1 * flown_s
    return True


def _walks(
    x: Array, step: TimeStep, flown_m: float, ground_known: bool, config: EkfConfig
) -> Array:
    """(n, n) of Q: random walks that both models share, and what feeds the Gauss-Markov states."""
    dt_s = step.dt_s
    Q = np.zeros((States.SIZE, States.SIZE))
    walks = _diagonal(Q)
    fed = 1.0 - math.exp(-2.0 * dt_s / config.acceleration_time_s)
    walks[States.ACCELERATION] = config.acceleration_sigma_m_s2**2 * fed
    turned_rad = abs(step.turned_rad)
    open_rad = _OPEN_RAD if step.imu is None else turned_rad  # by the gyro it is told step by step
    fed_tilt = 1.0 - math.exp(-2.0 * dt_s / config.tilt_time_s) + open_rad * turned_rad
    walks[States.TILT] = config.tilt_sigma_rad**2 * fed_tilt
    fed_map = 1.0 - math.exp(-2.0 * flown_m / config.map_length_m)
    walks[States.MAP] = step.map_sigma_m**2 * fed_map
    walks[States.MAP_TURN] = config.map_turn_rad**2 * fed_map
    walks[States.MAP_SCALE] = config.map_scale**2 * fed_map
    walks[States.TIME_OFFSET] = config.time_offset_walk_s**2 * dt_s
    climb_m_s = abs(float(x[States.VELOCITY_DOWN]))
    baro_m2 = config.baro_walk_m**2 + config.baro_climb_walk_m**2 * climb_m_s
    walks[States.BARO] = baro_m2 * dt_s
    walk_m = config.terrain_walk_known_m if ground_known else config.terrain_walk_m
    bent_m = config.terrain_bend_m * math.hypot(*x[States.SLOPE].tolist())
    stands_m2 = step.relief_m**2 / config.relief_length_m
    walks[States.TERRAIN] = (walk_m**2 + bent_m**2 + stands_m2) * flown_m
    return Q
