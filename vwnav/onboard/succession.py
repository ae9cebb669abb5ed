"""Where an aircraft must be by now whose navigator has ended: what its successor begins with."""

import math

import numpy as np

from vwnav.estimation.beginning.starts import Start
from vwnav.geometry.geodesy import LocalFrame
from vwnav.types import Array
from vwnav.vehicle import Learned
from vwnav.watchdog.successor import Resume

_HELD_S = 4.6  # for so long PX4 holds its place without estimates (measured)
_HELD_DRIFT_M_S, _BLIND_DRIFT_M_S = 1.0, 6.0  # one sigma while it does, and with the wind after
_LEAST_SIGMA_M = 3.0
_SPEED_SIGMA_M_S = 3.0
_HEIGHT_SIGMA_M = 3.0
# It is braked within a second, and then comes as far as 0.7 s at its speed would take it (5 m/s^2,
# from 7 m/s): so many seconds at that speed together, and one sigma of them.
_BRAKED_AFTER_S, _BRAKED_SIGMA_S = 1.2, 0.4


def start_after(
    position_ned_m: Array,
    velocity_ne_m_s: Array,
    told_s: float,
    t_s: float,
    learned: Learned | None = None,
) -> Start:
    """The start of a filter that goes on at `t_s`, as unsure as an aircraft may have moved since.

    Args:
        position_ned_m: (3,) the last good estimate that the autopilot was given.
        velocity_ne_m_s: (2,) how it moved then.
        told_s: when that was.
        t_s: now.
        learned: by the filter that ended.
    """
    since_s = max(t_s - told_s, 0.0)
    held_s = min(since_s, _HELD_S)
    drift_m = _HELD_DRIFT_M_S * held_s + _BLIND_DRIFT_M_S * (since_s - held_s)
    flown = min(since_s / _BRAKED_AFTER_S, 1.0)
    braked_m = _BRAKED_SIGMA_S * flown * float(np.hypot(*velocity_ne_m_s))
    place_ned_m = np.array(position_ned_m)
    place_ned_m[:2] += _BRAKED_AFTER_S * flown * velocity_ne_m_s
    height_m = -float(position_ned_m[2])
    return Start(
        t_s=t_s,
        position_ned_m=place_ned_m,
        sigma_m=math.hypot(_LEAST_SIGMA_M + drift_m, braked_m),
        agl_m=max(height_m, 1.0),
        sigma_agl_m=max(_HEIGHT_SIGMA_M, 0.15 * height_m),
        sigma_velocity_m_s=_SPEED_SIGMA_M_S,
        sigma_baro_m=max(height_m, 10.0),
        learned=learned,
    )


def last_place(resume: Resume, local_frame: LocalFrame) -> Array | None:
    """(3,) of the last good estimate, about the origin of the run; None when it is not known."""
    if resume.position is None or resume.origin is None:
        return None
    origin, told_ned_m = resume.origin, np.array(resume.position.position_ned_m)
    frame = LocalFrame(origin.lat_deg, origin.lon_deg, origin.alt_amsl_m)
    lat_deg, lon_deg, _ = frame.to_geodetic(told_ned_m)
    place_ned_m = local_frame.to_ned(float(lat_deg), float(lon_deg), local_frame.alt_amsl_m)
    place_ned_m[2] = told_ned_m[2]
    return np.asarray(place_ned_m)
