"""The envelope of the state: what no aircraft does, and how the filter begins anew beyond it."""

import math

import numpy as np

from vwnav.estimation.config import EkfConfig
from vwnav.estimation.states import FilterState, States, first_variance

_HEIGHT_SIGMA_M = 30.0  # the barometer tells it again
_TERRAIN_SIGMA_M = 30.0
_BARO_SIGMA_M = 2.0


def outside(state: FilterState, config: EkfConfig) -> str | None:
    """Why a state cannot be that of an aircraft; None while it can."""
    x, variances = state.x, np.diag(state.P)
    if not (np.all(np.isfinite(x)) and np.all(np.isfinite(state.P)) and np.all(variances >= 0.0)):
        return "it is not finite"
    north, east, down = x[States.VELOCITY].tolist()
    if math.hypot(north, east) > config.most_speed_m_s:
        return f"{math.hypot(north, east):.0f} m/s"
    if abs(down) > config.most_climb_m_s:
        return f"{-down:.0f} m/s of climb"
    tilt_rad = float(np.linalg.norm(x[States.TILT]))
    if tilt_rad > config.most_tilt_rad:
        return f"the attitude off by {math.degrees(tilt_rad):.0f} degrees of tilt"
    return None


def begun_anew(state: FilterState, config: EkfConfig) -> FilterState:
    """At the last trusted fix, as unsure as an aircraft can have flown since.

    Heights keep their values where they are numbers: they have witnesses of their own, and are open
    to them. Of the attitude's error nothing is believed but that it is as at first.
    """
    x, variance = np.zeros(States.SIZE), first_variance(config)
    x[States.DRAG] = config.drag_per_s
    heights = [2, States.BARO.start, States.TERRAIN.start]
    if np.all(np.isfinite(state.x[heights])):
        x[heights] = state.x[heights]
        # Nor may what it took the barometer's bias for be far from what weather does in an hour.
        x[States.BARO] = np.clip(x[States.BARO], -_BARO_SIGMA_M, _BARO_SIGMA_M)
    variance[2], variance[States.TERRAIN] = _HEIGHT_SIGMA_M**2, _TERRAIN_SIGMA_M**2
    variance[States.BARO] = _BARO_SIGMA_M**2
    variance[States.VELOCITY] = config.restart_velocity_m_s**2
    known = state.trusted is not None
    sigma_m = config.unknown_sigma_m
    if state.trusted is not None:
        x[:2] = state.trusted.position_ne_m
        flown_m = 0.5 * config.most_speed_m_s * max(state.t_s - state.trusted.t_s, 0.0)
        sigma_m = min(math.hypot(config.restart_sigma_m, state.trusted.sigma_m) + flown_m, sigma_m)
    variance[:2] = sigma_m**2
    return FilterState(
        state.t_s,
        x,
        np.diag(variance),
        position_known=known,
        heading_known=state.heading_known,
        t_last_fix_s=state.t_last_fix_s,
        trusted=state.trusted,
        reset_counter=state.reset_counter + 1,
    )
