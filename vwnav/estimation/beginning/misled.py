"""Ways that images did not tell, or told wrongly: how unsure a state is then."""

import numpy as np

from vwnav.estimation.beginning.starts import first_variance
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.disputes import motion_opened
from vwnav.estimation.events import Misled
from vwnav.estimation.inertial.attitudes import TURNING_RAD_S
from vwnav.estimation.states import FilterState, States, tells_heading

_MISLED_M_S = 2.0  # by which wrong ways that were believed may have turned the velocity
# What of sensors and air the ways teach; that of the vertical is the barometer's.
_TAUGHT = np.r_[
    States.ACCELERATION, States.TILT, States.CAMERA_TILT, States.FIX_LEAN,
    States.ACCELEROMETER_BIAS_LEVEL, States.WIND_FORCE, States.GUST_FORCE, States.DRAG,
    States.FOCAL, States.SLOPE, States.TIME_OFFSET,
]  # fmt: skip


def apply_untracked(state: FilterState, config: EkfConfig) -> FilterState:
    """Be as unsure as an aircraft may have turned, and changed its velocity, since it was tracked.

    Of a video alone: its heading is counted from image to image, and what lies between two that
    do not join is not counted. Turns last: the sigma of the heading grows with the time since the
    last image that was tracked, t, by d(w t)^2. One that may be anything is not known.
    """
    before_s, now_s = state.exposed_s - state.tracked_s, state.t_s - state.tracked_s
    state = motion_opened(state, now_s - before_s, config)
    P = state.P.copy()
    P[States.HEADING_BIAS, States.HEADING_BIAS] += TURNING_RAD_S**2 * (now_s**2 - before_s**2)
    known = state.heading_known and tells_heading(P)
    return state._replace(P=P, heading_known=known, exposed_s=state.t_s)


def apply_misled(state: FilterState, event: Misled, config: EkfConfig) -> FilterState:
    """Forget what wrong ways have taught of errors, air and velocity.

    They had been believed where they happened to agree. What of the sensors and of the wind was
    learned from them is as at first; the velocity may have gone wrong evenly all the while, and
    the place with it.
    """
    x, P = state.x.copy(), state.P.copy()
    x[_TAUGHT] = 0.0
    x[States.DRAG] = config.drag_per_s
    P[_TAUGHT], P[:, _TAUGHT] = 0.0, 0.0
    P[_TAUGHT, _TAUGHT] = first_variance(config)[_TAUGHT]
    span_s = state.t_s - event.since_s
    G = np.zeros((States.SIZE, 2))
    G[States.VELOCITY_NE] = _MISLED_M_S * np.eye(2)
    G[States.POSITION_NE] = 0.5 * span_s * _MISLED_M_S * np.eye(2)
    return state._replace(x=x, P=P + G @ G.T)
