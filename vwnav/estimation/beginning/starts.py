"""Where a filter begins: at first, in another one's place, and anew when its state is none."""

import math
from dataclasses import dataclass

import numpy as np

from vwnav.estimation.beginning.map_error import LearnedMapError
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.states import (
    KNOWN_SHARE,
    FilterState,
    States,
    TrustedPosition,
    tells_heading,
)
from vwnav.types import Array
from vwnav.vehicle import FoundCamera, Learned

_HEIGHT_SIGMA_M = 30.0  # the barometer tells it again
_TERRAIN_SIGMA_M = 30.0
_LEVEL_SLOPE = 1e-3  # of ground of which nothing is told
_BARO_SIGMA_M = 2.0
# What one filter leaves to the next. An accelerometer feels its bias, the wind and gusts together:
# each is unsure, their sum is not, so their covariance is handed on whole.
_HANDED_ON = np.r_[
    States.HEADING_BIAS, States.TILT, States.ACCELEROMETER_BIAS, States.WIND_FORCE, States.DRAG,
    States.GUST_FORCE, States.CAMERA_TILT, States.CAMERA_TURN, States.FOCAL, States.TIME_OFFSET,
]  # fmt: skip
_TRIANGLE = np.triu_indices(len(_HANDED_ON))
_HEADING_SIGMA_RAD = math.radians(3.0)  # by which the autopilot may have set its heading since
_STALE_S = 60.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Start:
    """What is known at first. On the ground nothing moves; in the air nothing is sure.

    Attributes:
        position_ned_m: (3,), None when unknown; its sigma is per horizontal axis.
        by_person: that place is somebody's word: a click on a map, tens of metres off perhaps.
        sigma_baro_m: of the barometer's zero; None takes the configured one, of a barometer that
            was zeroed where the height is counted from.
        learned: by a filter before this one.
    """

    t_s: float
    position_ned_m: Array | None = None
    sigma_m: float = 5.0
    agl_m: float = 0.15
    sigma_agl_m: float = 0.15
    sigma_velocity_m_s: float = 0.1
    sigma_baro_m: float | None = None
    learned: Learned | None = None
    by_person: bool = False


def first_state(start: Start, config: EkfConfig) -> FilterState:
    """The state before any measurement.

    Raises:
        ValueError: a number that is not finite, or a sigma that is not positive.
    """
    known = start.position_ned_m is not None
    position = np.zeros(3) if start.position_ned_m is None else np.array(start.position_ned_m)
    sigmas = np.array([start.sigma_m, start.sigma_agl_m, start.sigma_velocity_m_s])
    if position.shape != (3,) or not np.all(np.isfinite([*position, start.t_s, start.agl_m])):
        raise ValueError(f"expected a finite position (3,), time and height, got {start}")
    if not (np.all(np.isfinite(sigmas)) and np.all(sigmas > 0.0)):
        raise ValueError(f"expected positive sigmas, got {sigmas}")
    x = np.zeros(States.SIZE)
    x[States.POSITION] = position
    x[States.TERRAIN] = -position[2] - start.agl_m
    x[States.DRAG] = config.drag_per_s
    variance = first_variance(config)
    variance[States.POSITION] = (start.sigma_m if known else config.unknown_sigma_m) ** 2
    variance[States.DOWN] = 0.1**2  # the height is counted from here
    variance[States.VELOCITY] = start.sigma_velocity_m_s**2
    variance[States.TERRAIN] = start.sigma_agl_m**2
    variance[States.BARO] = (start.sigma_baro_m or config.baro_sigma_m) ** 2
    place = TrustedPosition(start.t_s, position[:2], start.sigma_m, start.by_person)
    P, t_s = np.diag(variance), start.t_s
    if start.learned is not None:
        _take_on(x, P, start.learned, t_s, config)
    return FilterState(
        t_s,
        x,
        P,
        position_known=known,
        heading_known=tells_heading(P),
        tracked_s=t_s,
        exposed_s=t_s,
        trusted=place if known else None,
        baro_zeroed=start.sigma_baro_m is None,
        map_error=LearnedMapError.stated(config.map_first_sigma_m),
    )


def first_variance(config: EkfConfig) -> Array:
    """(n,) of what the settings know of at first; of the rest, which the start tells, ones."""
    variance = np.ones(States.SIZE)
    variance[States.ACCELERATION] = config.acceleration_sigma_m_s2**2
    variance[States.HEADING_BIAS] = config.heading_sigma_rad**2
    variance[States.TILT] = config.tilt_sigma_rad**2
    variance[States.CAMERA_TILT] = config.mount_sigma_rad**2
    variance[States.CAMERA_TURN] = config.mount_turn_sigma_rad**2
    variance[States.FIX_LEAN] = config.fix_lean_rad**2
    variance[States.SLOPE] = _LEVEL_SLOPE**2
    variance[States.FOCAL] = config.focal_sigma_ratio**2
    variance[States.TIME_OFFSET] = config.time_offset_sigma_s**2
    variance[States.BARO] = config.baro_sigma_m**2
    variance[States.ACCELEROMETER_BIAS] = config.accelerometer_sigma_m_s2**2
    variance[States.GYRO_BIAS] = config.gyro_sigma_rad_s**2
    variance[States.WIND_FORCE] = config.wind_force_sigma_m_s2**2
    variance[States.GUST_FORCE] = (config.drag_per_s * config.gust_sigma_m_s) ** 2
    variance[States.DRAG] = config.drag_sigma_per_s**2
    variance[States.MAP] = config.map_first_sigma_m**2
    variance[States.MAP_TURN] = config.map_turn_rad**2
    variance[States.MAP_SCALE] = config.map_scale**2
    return variance


def begun_anew(state: FilterState, config: EkfConfig) -> FilterState:
    """At the last trusted fix, as unsure as an aircraft can have flown since.

    Heights keep their values where they are numbers: they have witnesses of their own, and are open
    to them. Of the attitude's error nothing is believed but that it is as at first.
    """
    x, variance = np.zeros(States.SIZE), first_variance(config)
    x[States.DRAG] = config.drag_per_s
    heights = [States.DOWN, States.BARO, States.TERRAIN]
    if np.all(np.isfinite(state.x[heights])):
        x[heights] = state.x[heights]
        if state.baro_zeroed:  # it cannot be further off than weather brings it in an hour
            x[States.BARO] = np.clip(x[States.BARO], -_BARO_SIGMA_M, _BARO_SIGMA_M)
    variance[States.DOWN], variance[States.TERRAIN] = _HEIGHT_SIGMA_M**2, _TERRAIN_SIGMA_M**2
    variance[States.BARO] = _BARO_SIGMA_M**2
    variance[States.VELOCITY] = config.restart_velocity_m_s**2
    variance[States.MAP] = state.map_error.sigma_m**2
    known = state.trusted is not None
    sigma_m = config.unknown_sigma_m
    if state.trusted is not None:
        x[States.POSITION_NE] = state.trusted.position_ne_m
        flown_m = 0.5 * config.most_speed_m_s * max(state.t_s - state.trusted.t_s, 0.0)
        sigma_m = min(math.hypot(config.restart_sigma_m, state.trusted.sigma_m) + flown_m, sigma_m)
    variance[States.POSITION_NE] = sigma_m**2
    P = np.diag(variance)
    if not state.baro_zeroed:  # wrong together, if they are: the barometer told their sum
        P[States.DOWN, States.BARO] = P[States.BARO, States.DOWN] = _HEIGHT_SIGMA_M**2
        P[States.BARO, States.BARO] += _HEIGHT_SIGMA_M**2
    return FilterState(
        state.t_s,
        x,
        P,
        position_known=known,
        heading_known=tells_heading(P),
        tracked_s=state.tracked_s,
        exposed_s=state.exposed_s,
        t_last_fix_s=state.t_last_fix_s,
        trusted=state.trusted,
        baro_zeroed=state.baro_zeroed,
        reset_counter=state.reset_counter + 1,
        map_error=state.map_error,
    )


def left_by(state: FilterState | None, camera: FoundCamera | None) -> Learned | None:
    """What a state may leave to a filter that goes on in its place, with the camera it was told of.

    A navigator that ends in flight takes with it what tells the velocity where no image does: one
    that began without would come down with the wind. And how its camera hangs: one that had to find
    out that it is upside down did not know its place for 38 s, and blamed the compass. Of the
    states nothing is left while heading or drag are hardly known.
    """
    if state is None:
        return None
    x, P, known = state.x, state.P, state.heading_known
    if not known or P[States.DRAG, States.DRAG] > (KNOWN_SHARE * x[States.DRAG]) ** 2:
        return None if camera is None else Learned(state.t_s, (), (), camera)
    C = P[np.ix_(_HANDED_ON, _HANDED_ON)]
    mean, covariance = x[_HANDED_ON].tolist(), C[_TRIANGLE].tolist()
    return Learned(state.t_s, tuple(mean), tuple(covariance), camera)


def _take_on(x: Array, P: Array, left: Learned, t_s: float, config: EkfConfig) -> None:
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
    drag_per_s = max(float(x[States.DRAG]), config.drag_range_per_s[0])
    force_m_s2 = float(np.hypot(*x[wind]))
    keep = math.exp(-since_s * force_m_s2 / drag_per_s / config.gust_length_m)
    x[gust] *= keep
    P[gust] *= keep
    P[:, gust] *= keep
    P[gust, gust] += (config.gust_share * force_m_s2) ** 2 * (1.0 - keep**2) * np.eye(2)
    P[wind, wind] += (config.wind_walk_m_s * drag_per_s) ** 2 * since_s * np.eye(2)
    P[yaw, yaw] += _HEADING_SIGMA_RAD**2
