"""Errors against the truth."""

import numpy as np
import pytest

from vwnav.geometry.geodesy import LocalFrame
from vwnav.sim.score import Score, summarise
from vwnav.sim.truth_state import TruthState
from vwnav.types import Estimate

HOME = LocalFrame(60.4, 22.5, 10.0)


def truth_at(north_m: float, east_m: float) -> TruthState:
    lat, lon, alt = HOME.to_geodetic(np.array([north_m, east_m, -50.0]))
    level, still = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    return TruthState(0.0, float(lat), float(lon), float(alt), level, still, still)


def estimate_at(north_m: float, east_m: float, fixed: bool = True) -> Estimate:
    return Estimate(
        t_s=0.0,
        position_ned_m=np.array([north_m, east_m, -48.0]),
        velocity_ned_m_s=np.zeros(3),
        covariance=np.eye(6),
        quat_wxyz=np.array([1.0, 0.0, 0.0, 0.0]),
        sigma_yaw_rad=0.1,
        agl_m=48.0,
        sigma_agl_m=1.0,
        t_last_fix_s=0.0 if fixed else None,
        reset_counter=0,
    )


def test_the_error_is_horizontal():
    score = Score(HOME)
    score.add_estimate(estimate_at(3.0, 4.0), truth_at(0.0, 0.0))
    assert score.last_error_m == pytest.approx(5.0, abs=1e-3)


def test_before_the_first_fix_only_the_last_error_is_kept():
    score = Score(HOME)
    score.add_estimate(estimate_at(3.0, 4.0, fixed=False), truth_at(0.0, 0.0))
    assert score.estimate_errors_m == []
    assert score.last_error_m is not None


def test_the_path_is_the_true_one():
    score = Score(HOME)
    for north_m in (0.0, 30.0, 10.0):
        score.add_estimate(estimate_at(0.0, 0.0), truth_at(north_m, 0.0))
    assert score.path_m() == pytest.approx(50.0, abs=0.01)
    assert score.max_distance_from_home_m() == pytest.approx(30.0, abs=0.01)


def test_a_summary_of_nothing_is_nothing():
    assert summarise([]) is None
    assert summarise([1.0, 3.0]).mean_m == 2.0
