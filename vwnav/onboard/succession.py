"""Where an aircraft must be by now whose navigator has ended: what its successor begins with."""

import numpy as np

from vwnav.estimation.states import Start
from vwnav.types import Array

_HELD_S = 4.6  # for so long PX4 holds its place without estimates (measured)
_HELD_DRIFT_M_S, _BLIND_DRIFT_M_S = 1.0, 6.0  # one sigma while it does, and with the wind after
_LEAST_SIGMA_M = 3.0
_SPEED_SIGMA_M_S = 3.0
_HEIGHT_SIGMA_M = 3.0


def start_after(position_ned_m: Array, told_s: float, t_s: float) -> Start:
    """The start of a filter that goes on at `t_s`, as unsure as an aircraft may have moved since.

    Args:
        position_ned_m: (3,) the last good estimate that the autopilot was given.
        told_s: when that was.
        t_s: now.
    """
    since_s = max(t_s - told_s, 0.0)
    held_s = min(since_s, _HELD_S)
    drift_m = _HELD_DRIFT_M_S * held_s + _BLIND_DRIFT_M_S * (since_s - held_s)
    height_m = -float(position_ned_m[2])
    return Start(
        t_s=t_s,
        position_ned_m=np.array(position_ned_m),
        sigma_m=_LEAST_SIGMA_M + drift_m,
        agl_m=max(height_m, 1.0),
        sigma_agl_m=max(_HEIGHT_SIGMA_M, 0.15 * height_m),
        sigma_velocity_m_s=_SPEED_SIGMA_M_S,
        sigma_baro_m=max(height_m, 10.0),
    )
