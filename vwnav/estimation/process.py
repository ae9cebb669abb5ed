"""How the state moves between measurements."""

import math
from dataclasses import replace

import numpy as np

from vwnav.estimation.attitudes import AttitudeHistory, thrust_acceleration
from vwnav.estimation.states import EkfConfig, FilterState, States
from vwnav.types import Array

_STEP_S = 0.1
_MOST_STEPS = 20  # a long silence is crossed in longer steps; only the thrust is then coarser
_N, _E, _D = 0, 1, 2
_VN, _VE, _VD = 3, 4, 5
_AN, _AE = 6, 7
_YAW = States.HEADING_BIAS.start


def predict(
    state: FilterState, t_s: float, attitudes: AttitudeHistory, config: EkfConfig
) -> FilterState:
    """The state at a later time `t_s`; the same state when the time is not later."""
    span_s = t_s - state.t_s
    if span_s <= 0.0:
        return state
    count = min(max(math.ceil(span_s / _STEP_S), 1), _MOST_STEPS)
    dt_s = span_s / count
    x, P = state.x, state.P
    for i in range(count):
        acceleration = _thrust(x, state.t_s + (i + 0.5) * dt_s, attitudes, config)
        x, P = _step(x, P, dt_s, acceleration, config)
    return replace(state, t_s=t_s, x=x, P=P)


def _thrust(
    x: Array, t_s: float, attitudes: AttitudeHistory, config: EkfConfig
) -> tuple[float, float]:
    """(north, east) acceleration from the attitude, turned from the autopilot's heading to true."""
    if not config.thrust_aided:
        return 0.0, 0.0
    north, east = thrust_acceleration(attitudes.quat_at(t_s))
    cos_b, sin_b = math.cos(x[_YAW]), math.sin(x[_YAW])
    return cos_b * north + sin_b * east, -sin_b * north + cos_b * east


def _step(
    x: Array, P: Array, dt_s: float, acceleration: tuple[float, float], config: EkfConfig
) -> tuple[Array, Array]:
    """One step of at most some tenths of a second: x' = f(x), P' = F P F^T + Q."""
    keep = math.exp(-dt_s / config.acceleration_time_s)
    keep_tilt = math.exp(-dt_s / config.tilt_time_s)
    north, east = acceleration[0] + x[_AN], acceleration[1] + x[_AE]
    moved = x.copy()
    moved[States.POSITION] += dt_s * x[States.VELOCITY]
    moved[_N] += 0.5 * dt_s**2 * north
    moved[_E] += 0.5 * dt_s**2 * east
    moved[_VN] += dt_s * north
    moved[_VE] += dt_s * east
    moved[States.ACCELERATION] *= keep
    moved[States.TILT] *= keep_tilt

    F = np.eye(States.SIZE)
    F[_N, _VN] = F[_E, _VE] = F[_D, _VD] = dt_s
    F[_N, _AN] = F[_E, _AE] = 0.5 * dt_s**2
    F[_VN, _AN] = F[_VE, _AE] = dt_s
    F[_AN, _AN] = F[_AE, _AE] = keep
    # A wrong heading turns the thrust's acceleration.
    F[_VN, _YAW], F[_VE, _YAW] = dt_s * acceleration[1], -dt_s * acceleration[0]
    F[States.TILT, States.TILT] *= keep_tilt
    predicted = F @ P @ F.T + _process_noise(x, dt_s, config)
    return moved, 0.5 * (predicted + predicted.T)


def _process_noise(x: Array, dt_s: float, config: EkfConfig) -> Array:
    """Q of one step: white acceleration, random walks, and what feeds the Gauss-Markov states."""
    Q = np.zeros((States.SIZE, States.SIZE))
    for p, v, noise in (
        (_N, _VN, config.acceleration_noise_m_s2),
        (_E, _VE, config.acceleration_noise_m_s2),
        (_D, _VD, config.vertical_noise_m_s2),
    ):
        q = noise**2
        Q[p, p] = q * dt_s**3 / 3.0
        Q[p, v] = Q[v, p] = q * dt_s**2 / 2.0
        Q[v, v] = q * dt_s
    fed = 1.0 - math.exp(-2.0 * dt_s / config.acceleration_time_s)
    Q[_AN, _AN] = Q[_AE, _AE] = config.acceleration_sigma_m_s2**2 * fed
    fed_tilt = 1.0 - math.exp(-2.0 * dt_s / config.tilt_time_s)
    for i in range(States.TILT.start, States.TILT.stop):
        Q[i, i] = config.tilt_sigma_rad**2 * fed_tilt
    Q[_YAW, _YAW] = config.heading_walk_rad**2 * dt_s
    baro, terrain = States.BARO.start, States.TERRAIN.start
    Q[baro, baro] = config.baro_walk_m**2 * dt_s
    speed_m_s = math.hypot(x[_VN], x[_VE])
    Q[terrain, terrain] = config.terrain_walk_m**2 * speed_m_s * dt_s
    return Q
