"""VISION_POSITION_ESTIMATE and VISION_SPEED_ESTIMATE as the estimator wants them."""

import math
from typing import Any

from vwnav.sim.copter.estimator import CopterEstimator, Vector

_FARTHEST_M, _FASTEST_M_S, _LARGEST_VARIANCE = 1e7, 1e3, 1e6


def feed_position(message: Any, estimator: CopterEstimator) -> None:
    """NED about the estimator's origin; what is no place is dropped."""
    if all(abs(value) <= _FARTHEST_M for value in (message.x, message.y, message.z)):
        variance_m2 = _variance((message.covariance[0], message.covariance[6]))
        estimator.handle_position(message.x, message.y, variance_m2, message.reset_counter)


def feed_velocity(message: Any, estimator: CopterEstimator) -> None:
    """NED; what is no velocity is dropped."""
    velocity: Vector = (message.x, message.y, message.z)
    if all(abs(value) <= _FASTEST_M_S for value in velocity):
        variance = _variance((message.covariance[0], message.covariance[4]))
        estimator.handle_velocity(velocity, variance)


def _variance(given: tuple[float, float]) -> float:
    """The larger one that is known; 0 leaves it to the parameters."""
    known = [value for value in given if math.isfinite(value)]
    return min(max([0.0, *known]), _LARGEST_VARIANCE)
