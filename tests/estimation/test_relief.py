"""Trees stand on the ground: fixes, ways and rangefinder take others of it for the plane."""

import math

import numpy as np
import pytest

from vwnav.estimation.beginning.starts import Start
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.ekf import Ekf
from vwnav.estimation.events import NedFix
from vwnav.types import Array, Attitude, Height, OdometryMotion

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
AGL_M, TREES_M, SPEED_M_S = 50.0, 12.0, 8.0


def at_height() -> Ekf:
    ekf = Ekf(EkfConfig())
    ekf.handle(Attitude(0.0, LEVEL))
    start = Start(
        t_s=0.0, position_ned_m=np.array([0.0, 0.0, -AGL_M]), sigma_m=0.5, agl_m=AGL_M,
        sigma_agl_m=0.5, sigma_velocity_m_s=SPEED_M_S,
    )  # fmt: skip
    ekf.initialise(start)
    return ekf


def way(since_s: float, t_s: float, agl_m: float, share: float, relief: float | None):
    """Northwards, `share` of what was flown."""
    seen_m = np.array([share * SPEED_M_S * (t_s - since_s), 0.0, 0.0]) * agl_m / AGL_M
    return OdometryMotion(
        since_s, t_s, seen_m, 0.08**2 * np.eye(3), 0.0, 0.003, agl_m, 99, relief=relief
    )


def fix(t_s: float, agl_m: float) -> NedFix:
    return NedFix(
        t_s=t_s, position_ne_m=np.array([SPEED_M_S * t_s, 0.0]),
        covariance_ne_m2=(0.25 + (0.035 * agl_m) ** 2) * np.eye(2), sigma_tilt_rad=0.035,
        yaw_rad=0.0, sigma_yaw_rad=0.01, agl_m=agl_m, sigma_agl_m=0.5,
    )  # fmt: skip


def sigmas(off: Array, covariance: Array) -> float:
    return math.sqrt(off @ np.linalg.solve(covariance, off))


def worst_sigmas(relief: float | None) -> float:
    """Northwards over a wood: its crowns are matched with the map, its floor is followed."""
    ekf, worst, keyframe_s = at_height(), 0.0, 0.0
    for n in range(1, 1501):
        t_s = round(0.02 * n, 6)
        north_m = SPEED_M_S * t_s
        wooded = t_s > 10.0
        ekf.handle(Attitude(t_s, LEVEL))
        if n % 5 == 0:
            ekf.handle(Height(t_s, AGL_M))
        believed = ekf.estimate(t_s)
        assert believed is not None
        if n % 10 == 0:
            ekf.handle(way(keyframe_s, t_s, believed.agl_m, 1.0, relief if wooded else 0.0))
            keyframe_s = t_s if n % 100 == 0 else keyframe_s
        if n % 20 == 0:
            ekf.handle(fix(t_s, AGL_M - (TREES_M if wooded else 0.0)))
        off_m = believed.position_ned_m[:2] - [north_m, 0.0]
        worst = max(worst, sigmas(off_m, believed.covariance[:2, :2]))
    return worst


def worst_velocity_sigmas(relief: float | None, seed: int) -> float:
    """Over a wood of which each image takes another part for the plane."""
    rng = np.random.default_rng(seed)
    ekf, worst, keyframe_s = at_height(), 0.0, 0.0
    for n in range(1, 1001):
        t_s = round(0.02 * n, 6)
        ekf.handle(Attitude(t_s, LEVEL))
        if n % 5 == 0:
            ekf.handle(Height(t_s, AGL_M))
        believed = ekf.estimate(t_s)
        assert believed is not None
        if n % 10 == 0:
            share = 1.0 + rng.normal(0.0, 0.05)
            ekf.handle(way(keyframe_s, t_s, believed.agl_m, share, relief))
            keyframe_s = t_s if n % 100 == 0 else keyframe_s
        if n % 20 == 0:
            ekf.handle(fix(t_s, AGL_M))
        off_m_s = believed.velocity_ned_m_s[:2] - [SPEED_M_S, 0.0]
        worst = max(worst, sigmas(off_m_s, believed.covariance[3:5, 3:5]))
    return worst


@pytest.mark.parametrize("seed", range(3))
def test_where_each_image_takes_another_part_of_it_for_the_ground_the_velocity_is_within_its_sigmas(
    seed,
):
    assert worst_velocity_sigmas(0.11, seed) < 4.0
    assert worst_velocity_sigmas(None, seed) > 4.0  # were nothing told of it


def test_with_the_relief_that_ways_show_the_filter_stays_within_its_sigmas_over_a_wood():
    assert worst_sigmas(relief=0.11) < 3.0


def test_without_it_a_way_of_the_forest_floor_is_believed_against_every_fix():
    assert worst_sigmas(relief=None) > 5.0


@pytest.mark.parametrize("relief", [0.0, 0.05, 0.11, 0.3])
def test_whatever_is_told_numbers_stay_finite(relief):
    assert math.isfinite(worst_sigmas(relief))
