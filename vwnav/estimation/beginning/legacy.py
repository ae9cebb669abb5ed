"""What one filter leaves to the next: air, accelerometer and compass, as they were learned.

A navigator that ends in flight takes with it what tells the velocity where no image does: the wind,
and by how much it is felt. A second one that began without would come down with the wind. What the
accelerometer feels is the sum of its bias, the wind and gusts: each is unsure, their sum is not. So
the covariance is handed on whole.
"""

import math

import numpy as np

from vwnav.estimation.config import EkfConfig
from vwnav.estimation.states import KNOWN_SHARE, FilterState, States
from vwnav.types import Array
from vwnav.vehicle import Learned

_HANDED_ON = np.r_[
    States.HEADING_BIAS, States.TILT, States.ACCELEROMETER_BIAS, States.WIND_FORCE, States.DRAG,
    States.GUST_FORCE,
]  # fmt: skip
_TRIANGLE = np.triu_indices(len(_HANDED_ON))
_HEADING_SIGMA_RAD = math.radians(3.0)  # by which the autopilot may have set its heading since
_STALE_S = 60.0


def left_by(state: FilterState | None) -> Learned | None:
    """What a state may leave; None while heading and drag are not known well enough."""
    if state is None or not state.heading_known:
        return None
    x, P = state.x, state.P
    if P[States.DRAG, States.DRAG] > (KNOWN_SHARE * x[States.DRAG]) ** 2:
        return None
    C = P[np.ix_(_HANDED_ON, _HANDED_ON)]
    return Learned(state.t_s, tuple(x[_HANDED_ON].tolist()), tuple(C[_TRIANGLE].tolist()))


def take_on(x: Array, P: Array, left: Learned, t_s: float, config: EkfConfig) -> None:
    """Put what was left into a first mean (n,) and covariance (n, n), as old as it is at `t_s`.

    The mean wind walks, gusts pass in L / W seconds (see `process`). What is of another size or
    older than a minute is left out.
    """
    since_s = t_s - left.t_s
    count = len(_HANDED_ON)
    fits = len(left.mean) == count and len(left.covariance) == len(_TRIANGLE[0])
    if not fits or not 0.0 <= since_s <= _STALE_S:
        return
    C = np.zeros((count, count))
    C[_TRIANGLE] = left.covariance
    x[_HANDED_ON] = left.mean
    P[np.ix_(_HANDED_ON, _HANDED_ON)] = C + np.triu(C, 1).T
    gust, wind, yaw = States.GUST_FORCE, States.WIND_FORCE, States.HEADING_BIAS
    drag_per_s, force_m_s2 = float(x[States.DRAG]), float(np.hypot(*x[wind]))
    keep = math.exp(-since_s * force_m_s2 / drag_per_s / config.gust_length_m)
    x[gust] *= keep
    P[gust] *= keep
    P[:, gust] *= keep
    P[gust, gust] += (config.gust_share * force_m_s2) ** 2 * (1.0 - keep**2) * np.eye(2)
    P[wind, wind] += (config.wind_walk_m_s * drag_per_s) ** 2 * since_s * np.eye(2)
    P[yaw, yaw] += _HEADING_SIGMA_RAD**2
