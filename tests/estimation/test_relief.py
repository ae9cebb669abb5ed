"""Trees stand on the ground: fixes, ways and rangefinder take others of it for the plane."""

import math

import numpy as np
import pytest

from vwnav.estimation.beginning.starts import Start
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.ekf import Ekf
from vwnav.estimation.events import NedFix
from vwnav.types import Attitude, Height, OdometryMotion

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
AGL_M, TREES_M, SPEED_M_S = 50.0, 12.0, 8.0


def worst_sigmas(relief: float | None) -> float:
    """Northwards over a wood: its crowns are matched with the map, its floor is followed."""
    ekf, worst, keyframe_s = Ekf(EkfConfig()), 0.0, 0.0
    ekf.handle(Attitude(0.0, LEVEL))
    start = Start(
        t_s=0.0, position_ned_m=np.array([0.0, 0.0, -AGL_M]), sigma_m=0.5, agl_m=AGL_M,
        sigma_agl_m=0.5, sigma_velocity_m_s=SPEED_M_S,
    )  # fmt: skip
    ekf.initialise(start)
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
            way = np.array([SPEED_M_S * (t_s - keyframe_s), 0.0, 0.0]) * believed.agl_m / AGL_M
            seen = OdometryMotion(
                keyframe_s, t_s, way, 0.08**2 * np.eye(3), 0.0, 0.003, believed.agl_m, 99,
                relief=relief if wooded else 0.0,
            )  # fmt: skip
            ekf.handle(seen)
            keyframe_s = t_s if n % 100 == 0 else keyframe_s
        if n % 20 == 0:
            agl_m = AGL_M - (TREES_M if wooded else 0.0)
            fix = NedFix(
                t_s=t_s, position_ne_m=np.array([north_m, 0.0]),
                covariance_ne_m2=(0.25 + (0.035 * agl_m) ** 2) * np.eye(2), sigma_tilt_rad=0.035,
                yaw_rad=0.0, sigma_yaw_rad=0.01, agl_m=agl_m, sigma_agl_m=0.5,
            )  # fmt: skip
            ekf.handle(fix)
        off_m = believed.position_ned_m[:2] - [north_m, 0.0]
        covariance = believed.covariance[:2, :2]
        worst = max(worst, math.sqrt(off_m @ np.linalg.solve(covariance, off_m)))
    return worst


def test_with_the_relief_that_ways_show_the_filter_stays_within_its_sigmas_over_a_wood():
    assert worst_sigmas(relief=0.11) < 3.0


def test_without_it_a_way_of_the_forest_floor_is_believed_against_every_fix():
    assert worst_sigmas(relief=None) > 5.0


@pytest.mark.parametrize("relief", [0.0, 0.05, 0.11, 0.3])
def test_whatever_is_told_numbers_stay_finite(relief):
    assert math.isfinite(worst_sigmas(relief))
