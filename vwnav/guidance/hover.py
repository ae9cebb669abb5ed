"""Staying over a place, straight up, straight down."""

import math

import numpy as np

from vwnav.guidance.limits import LimitsConfig
from vwnav.types import Array, Estimate
from vwnav.vehicle import VelocitySetpoint

_HEIGHT_GAIN_PER_S = 0.8
_ABSURD_M = 1e12


def vertical_speed_m_s(error_down_m: float, feed_m_s: float, limits: LimitsConfig) -> float:
    """Downward speed for a height error, down positive, on top of a speed that is due anyway."""
    speed_m_s = feed_m_s + _HEIGHT_GAIN_PER_S * error_down_m
    return min(max(speed_m_s, -limits.climb_m_s), limits.descend_m_s)


def climb_straight(estimate: Estimate, height_m: float, limits: LimitsConfig) -> VelocitySetpoint:
    """Up or down to a height above the origin with no say on where: for before the first fix."""
    error_m = -height_m - float(estimate.position_ned_m[2])
    down_m_s = vertical_speed_m_s(error_m, 0.0, limits) if math.isfinite(error_m) else 0.0
    return VelocitySetpoint(0.0, 0.0, down_m_s)


def hold_at(estimate: Estimate, point_ned_m: Array, limits: LimitsConfig) -> VelocitySetpoint:
    """To a point (3,) and stay there; zero velocity when the estimate is absurd."""
    if not np.all(np.abs(estimate.position_ned_m) < _ABSURD_M):
        return VelocitySetpoint(0.0, 0.0, 0.0)
    error_m = np.asarray(point_ned_m - estimate.position_ned_m, dtype=np.float64)
    wanted = error_m[:2] * limits.position_gain_per_s
    wanted *= min(1.0, limits.cross_speed_m_s / max(float(np.hypot(*wanted)), 1e-9))
    down_m_s = vertical_speed_m_s(float(error_m[2]), 0.0, limits)
    return VelocitySetpoint(float(wanted[0]), float(wanted[1]), down_m_s)


def descend_to_land(estimate: Estimate, over_ne_m: Array, limits: LimitsConfig) -> VelocitySetpoint:
    """Down over a place (2,), slowly near the ground; never up.

    The height above ground is trusted less than two sigma: descent slows down early where that is
    poorly known.
    """
    hold = hold_at(estimate, np.array([*over_ne_m, 0.0]), limits)
    lowest_m = estimate.agl_m - 2.0 * estimate.sigma_agl_m
    high = math.isfinite(lowest_m) and lowest_m > limits.land_below_m
    down_m_s = limits.descend_m_s if high else limits.land_m_s
    return VelocitySetpoint(hold.north_m_s, hold.east_m_s, down_m_s)
