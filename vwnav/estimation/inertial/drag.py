"""What the air does to a multirotor: the accelerometer feels how fast it flies through it.

Thrust acts along the body's down axis, so all that an accelerometer feels across that axis is drag
(Martin and Salaun 2010, "The true role of accelerometer feedback in quadrotor control"), and rotors
make it grow with the speed alone: f = -k (v - w) = -k v + c. On PX4's simulated quadrotor k is 1.0
per second, on ArduCopter's 0.38, both to 0.03 m/s^2 (from recordings). While pictures tell the
velocity, k and what the wind adds, c = k w, are learned; without pictures they tell the velocity
(Abeywardena et al. 2013, "Improved state estimation in quadrotor MAVs", eq. 6).
"""

import math
from dataclasses import replace

import numpy as np

from vwnav.estimation.context import Context
from vwnav.estimation.inertial.attitudes import GRAVITY_M_S2
from vwnav.estimation.inertial.preintegration import push_between
from vwnav.estimation.states import FilterState, States
from vwnav.estimation.updates import Innovation, Measurement, Verdict, fuse
from vwnav.geometry.rotations import rotation_from_quat

FELT_S = 0.2  # over which the force is averaged
_LOWEST_AGL_M = 3.0  # below it may stand, and rotors blow along the ground
_MODEL_SHARE = 0.1  # of the drag, by which it is not straight in the speed
_REFUSED_M_S2 = 0.3  # a wind that is refused may have changed by so much
_YAW = States.HEADING_BIAS.start
_DRAG = States.DRAG.start


def apply_drag(state: FilterState, context: Context) -> tuple[FilterState, Innovation]:
    """Fuse the force across the thrust that was felt until now."""
    imu, config = context.imu, context.config
    push = push_between(imu.until(state.t_s - FELT_S), imu.until(state.t_s))
    attitude = context.attitudes.at(state.t_s - 0.5 * FELT_S)
    if push is None or attitude is None or not state.heading_known:
        return state, Innovation(Verdict.NO_ATTITUDE)
    if state.agl_m < _LOWEST_AGL_M:
        return state, Innovation(Verdict.ON_GROUND)
    felt_m_s2 = push.body_m_s / push.lasted_s
    x = state.x
    c, s = math.cos(x[_YAW]), math.sin(x[_YAW])
    unturn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    R = unturn @ rotation_from_quat(attitude.quat_wxyz)
    across = R.T[:2]  # the body's forward and right axes, (2, 3)
    acceleration = R @ felt_m_s2 + [0.0, 0.0, GRAVITY_M_S2]
    midway_m_s = x[States.VELOCITY] - 0.5 * FELT_S * acceleration
    through_m_s = across @ midway_m_s
    H = np.zeros((2, States.SIZE))
    H[:, States.VELOCITY] = -x[_DRAG] * across
    H[:, States.WIND_FORCE] = across[:, :2]
    H[:, _DRAG] = -through_m_s
    H[:, States.ACCELEROMETER_BIAS] = np.eye(2, 3)
    drag = across[:, :2] @ x[States.WIND_FORCE] - x[_DRAG] * through_m_s
    sigma_yaw_rad = min(math.sqrt(state.P[_YAW, _YAW]), 1.0)
    rough = (_MODEL_SHARE + sigma_yaw_rad) * float(np.hypot(*drag))
    noise = config.drag_noise_m_s2**2 + rough**2 + push.shaken_m2_s2 / push.lasted_s**2
    residual = felt_m_s2[:2] - drag - x[States.ACCELEROMETER_BIAS][:2]
    fused, innovation = fuse(state, Measurement(residual, H, noise * np.eye(2)))
    if not innovation.accepted:
        P = state.P.copy()
        P[States.WIND_FORCE, States.WIND_FORCE] += _REFUSED_M_S2**2 * np.eye(2)
        return replace(state, P=P), innovation
    x = fused.x.copy()
    x[_DRAG] = np.clip(x[_DRAG], *config.drag_range_per_s)
    return replace(fused, x=x), innovation
