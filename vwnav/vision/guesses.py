"""What a prior leaves open, as a short list of guesses to try, the likeliest first."""

import itertools
import math
from dataclasses import dataclass

import numpy as np

from vwnav.geometry.rotations import wrap_pi
from vwnav.types import Prior
from vwnav.vision.hypotheses import SimilarityBounds

YAW_REACH_RAD = math.radians(16.0)  # descriptors are upright and bear so much rotation
SCALE_REACH = 1.18  # and so much difference of scale
YAW_STEPS = 14  # of a full turn, 26 degrees each
SCALE_STEP = 1.33
SIGMAS = 2.5
LOOSE_YAW_RAD = math.radians(9.0)
LOOSE_SCALE = 1.08
MAX_YAW_BOUND_RAD = math.radians(50.0)
MAX_SCALE_BOUND = 1.6


@dataclass(frozen=True, slots=True)
class Guess:
    """One heading and height to rectify a picture with.

    Attributes:
        yaw_rad, agl_m: taken as true.
        bounds: how far from them the truth may be.
    """

    yaw_rad: float
    agl_m: float
    bounds: SimilarityBounds


def is_finite(prior: Prior) -> bool:
    """Whether every number of a prior is one, and makes sense."""
    numbers = (
        prior.lat_deg,
        prior.lon_deg,
        prior.sigma_m,
        prior.yaw_rad,
        prior.sigma_yaw_rad,
        prior.agl_m,
        prior.sigma_agl_ratio,
        prior.roll_rad,
        prior.pitch_rad,
    )
    sigmas = (prior.sigma_m, prior.sigma_yaw_rad, prior.sigma_agl_ratio)
    finite = all(number is None or math.isfinite(number) for number in numbers)
    return finite and min(sigmas) >= 0.0 and (prior.agl_m is None or prior.agl_m > 0.0)


def guesses(prior: Prior, agl_range_m: tuple[float, float]) -> list[Guess]:
    """Headings and heights that cover what the prior leaves open.

    Args:
        prior: finite.
        agl_range_m: heights to try where it says none.
    """
    yaws, yaw_bound_rad = _yaws(prior)
    agls, scale_bound = _agls(prior, agl_range_m)
    bounds = SimilarityBounds(scale_bound, yaw_bound_rad)
    found = [
        (yaw_cost + agl_cost, Guess(yaw_rad, agl_m, bounds))
        for (yaw_rad, yaw_cost), (agl_m, agl_cost) in itertools.product(yaws, agls)
    ]
    found.sort(key=lambda item: item[0])
    return [guess for _, guess in found]


def _yaws(prior: Prior) -> tuple[list[tuple[float, float]], float]:
    """Headings with their squared distance from the prior in sigmas, and how far each reaches."""
    step_rad = 2.0 * math.pi / YAW_STEPS
    if prior.yaw_rad is None or SIGMAS * prior.sigma_yaw_rad >= math.pi:
        yaws = [(float(wrap_pi(i * step_rad)), 0.0) for i in range(YAW_STEPS)]
        return yaws, step_rad / 2.0 + LOOSE_YAW_RAD
    open_rad = SIGMAS * prior.sigma_yaw_rad
    bound_rad = min(open_rad + LOOSE_YAW_RAD, MAX_YAW_BOUND_RAD)
    count = math.ceil(max(0.0, open_rad - YAW_REACH_RAD) / step_rad)
    yaws = (
        [
            (
                float(wrap_pi(prior.yaw_rad + i * step_rad)),
                (i * step_rad / prior.sigma_yaw_rad) ** 2,
            )
            for i in range(-count, count + 1)
        ]
        if count
        else [(prior.yaw_rad, 0.0)]
    )
    return yaws, bound_rad


def _agls(
    prior: Prior, agl_range_m: tuple[float, float]
) -> tuple[list[tuple[float, float]], float]:
    """Heights with their cost, as `_yaws`, and by which factor each reaches."""
    if prior.agl_m is None:
        low_m, high_m = agl_range_m
        count = max(1, math.ceil(math.log(high_m / low_m) / math.log(SCALE_STEP)))
        heights = np.geomspace(low_m, high_m, count + 1)
        middle = math.sqrt(low_m * high_m)
        agls = [(float(agl_m), math.log(agl_m / middle) ** 2) for agl_m in heights]
        return agls, math.sqrt(SCALE_STEP) * LOOSE_SCALE
    opened = 1.0 + SIGMAS * prior.sigma_agl_ratio
    bound = min(opened * LOOSE_SCALE, MAX_SCALE_BOUND)
    count = math.ceil(max(0.0, math.log(opened / SCALE_REACH)) / math.log(SCALE_STEP))
    sigma = math.log1p(prior.sigma_agl_ratio)
    agls = [
        (prior.agl_m * SCALE_STEP**i, (i * math.log(SCALE_STEP) / sigma) ** 2 if i else 0.0)
        for i in range(-count, count + 1)
    ]
    return agls, bound
