"""What the air does to a multirotor: the accelerometer feels how fast it flies through it.

Thrust acts along the body's down axis, so all that an accelerometer feels across that axis is drag
(Martin and Salaun 2010, "The true role of accelerometer feedback in quadrotor control"), and rotors
make it grow with the speed alone: f = -k (v - w) = -k v + c. On PX4's simulated quadrotor k is 1.0
per second, on ArduCopter's 0.38, both to 0.03 m/s^2 (from recordings). While images tell the
velocity, k and what the wind adds, c = k w, are learned; without images they tell the velocity
(Abeywardena et al. 2013, "Improved state estimation in quadrotor MAVs", eq. 6).
"""

import math
from dataclasses import replace

import numpy as np

from vwnav.estimation.context import Context
from vwnav.estimation.inertial.attitudes import GRAVITY_M_S2, true_from_autopilot
from vwnav.estimation.inertial.preintegration import preintegrated
from vwnav.estimation.states import FilterState, Innovation, Measurement, States, Verdict, fuse
from vwnav.geometry.rotations import rotation_from_quat
from vwnav.types import Array

FELT_S = 0.2  # over which the force is averaged
_LOWEST_AGL_M = 3.0  # below it may stand, and rotors blow along the ground
_MODEL_SHARE = 0.1  # of the drag, by which it is not straight in the speed
_MOST_SHARE = 0.9  # of a jump, by which one reading moves the place
_REFUSED_M_S2 = 0.3  # a wind that is refused may have changed by so much


def apply_drag(state: FilterState, context: Context) -> tuple[FilterState, Innovation]:
    """Fuse the force across the thrust that was felt until now.

    A reading that would move the place so far that it counts as another one is weighed less, until
    it does not: a bounded influence (Huber 1964, "Robust estimation of a location parameter").
    """
    imu, config = context.imu, context.config
    felt = preintegrated(imu.until(state.t_s - FELT_S), imu.until(state.t_s))
    attitude = context.attitudes.at(state.t_s - 0.5 * FELT_S)
    if felt is None or attitude is None or not state.heading_known:
        return state, Innovation(Verdict.NO_ATTITUDE)
    if state.agl_m < _LOWEST_AGL_M:
        return state, Innovation(Verdict.ON_GROUND)
    felt_m_s2 = felt.body_m_s / felt.span_s
    x = state.x
    R_ned_body = _body_axes(x, attitude.quat_wxyz)
    across = R_ned_body.T[:2]  # the body's forward and right axes, (2, 3)
    acceleration = R_ned_body @ felt_m_s2 + [0.0, 0.0, GRAVITY_M_S2]
    midway_m_s = x[States.VELOCITY] - 0.5 * FELT_S * acceleration
    through_m_s = across @ midway_m_s
    H = np.zeros((2, States.SIZE))
    H[:, States.VELOCITY] = -x[States.DRAG] * across
    H[:, States.WIND_FORCE] = H[:, States.GUST_FORCE] = across[:, :2]
    H[:, States.DRAG] = -through_m_s
    H[:, States.ACCELEROMETER_BIAS] = np.eye(2, 3)
    drag = _drag_m_s2(x, across, through_m_s)
    sigma_yaw_rad = min(math.sqrt(state.P[States.HEADING_BIAS, States.HEADING_BIAS]), 1.0)
    rough = (_MODEL_SHARE + sigma_yaw_rad) * float(np.hypot(*drag))
    noise = config.drag_noise_m_s2**2 + rough**2 + felt.velocity_variance_m2_s2 / felt.span_s**2
    residual = felt_m_s2[:2] - drag - x[States.ACCELEROMETER_BIAS][:2]
    told = Measurement(residual, H, noise * np.eye(2))
    fused, innovation = fuse(state, told)
    moved_m = math.dist(fused.x[States.POSITION_NE], state.x[States.POSITION_NE])
    if moved_m > (most_m := _MOST_SHARE * config.jump_m):
        # After long blindness a noisy IMU does so with each of its words, to and fro.
        known = H @ state.P @ H.T
        doubted = replace(told, R=moved_m / most_m * (known + told.R) - known)
        fused, innovation = fuse(state, doubted)
    if innovation.verdict is Verdict.GATED:
        P = state.P.copy()
        P[States.WIND_FORCE, States.WIND_FORCE] += _REFUSED_M_S2**2 * np.eye(2)
        return state._replace(P=P), innovation
    x = fused.x.copy()
    x[States.DRAG] = np.clip(x[States.DRAG], *config.drag_range_per_s)
    return fused._replace(x=x), innovation


def explained_m_s2(state: FilterState, quat_wxyz: Array) -> tuple[Array, float]:
    """What an accelerometer without an error feels across the thrust, (2,), in that attitude.

    And how unsure that is, because the drag is not known better.
    """
    across = _body_axes(state.x, quat_wxyz).T[:2]
    through_m_s = across @ state.x[States.VELOCITY]
    sigma_per_s = math.sqrt(float(state.P[States.DRAG, States.DRAG]))
    return _drag_m_s2(state.x, across, through_m_s), sigma_per_s * float(np.hypot(*through_m_s))


def _body_axes(x: Array, quat_wxyz: Array) -> Array:
    return true_from_autopilot(float(x[States.HEADING_BIAS])) @ rotation_from_quat(quat_wxyz)


def _drag_m_s2(x: Array, across: Array, through_m_s: Array) -> Array:
    air_m_s2 = x[States.WIND_FORCE] + x[States.GUST_FORCE]
    drag: Array = across[:, :2] @ air_m_s2 - x[States.DRAG] * through_m_s
    return drag
