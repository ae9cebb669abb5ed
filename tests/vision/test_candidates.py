import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.geometry.rotations import wrap_pi
from vwnav.types import Prior
from vwnav.vision.candidates import SCALE_REACH, SIGMAS, YAW_REACH_RAD, hypotheses

SHARP = Prior(yaw_rad=1.0, sigma_yaw_rad=0.03, agl_m=50.0, sigma_agl_ratio=0.03)
HEIGHTS_M = (20.0, 600.0)


def test_a_sharp_prior_leaves_one_hypothesis():
    (only,) = hypotheses(SHARP, HEIGHTS_M)
    assert (only.yaw_rad, only.agl_m) == (1.0, 50.0)


@given(
    yaw=st.floats(-3.1, 3.1),
    sigma_yaw=st.floats(0.01, 1.0),
    sigma_agl=st.floats(0.01, 0.3),
    off_yaw=st.floats(-1, 1),
    off_agl=st.floats(-1, 1),
)
def test_whatever_the_prior_allows_is_within_reach_of_a_hypothesis(
    yaw, sigma_yaw, sigma_agl, off_yaw, off_agl
):
    prior = Prior(yaw_rad=yaw, sigma_yaw_rad=sigma_yaw, agl_m=80.0, sigma_agl_ratio=sigma_agl)
    true_yaw = yaw + off_yaw * SIGMAS * sigma_yaw
    true_agl = 80.0 * (1.0 + SIGMAS * sigma_agl) ** off_agl
    assert any(
        abs(wrap_pi(each.yaw_rad - true_yaw)) <= YAW_REACH_RAD
        and abs(math.log(each.agl_m / true_agl)) <= math.log(SCALE_REACH)
        for each in hypotheses(prior, HEIGHTS_M)
    )


def test_the_likeliest_hypothesis_comes_first():
    first = hypotheses(replace(SHARP, sigma_yaw_rad=0.3, sigma_agl_ratio=0.2), HEIGHTS_M)[0]
    assert first.yaw_rad == pytest.approx(1.0)
    assert first.agl_m == pytest.approx(50.0)


def test_an_unknown_heading_is_tried_all_around():
    yaws = np.sort([each.yaw_rad for each in hypotheses(replace(SHARP, yaw_rad=None), HEIGHTS_M)])
    gaps = np.diff(np.append(yaws, yaws[0] + 2.0 * math.pi))
    assert gaps.max() <= 2.0 * YAW_REACH_RAD


def test_an_unknown_height_is_tried_over_its_range():
    heights = np.sort([g.agl_m for g in hypotheses(replace(SHARP, agl_m=None), HEIGHTS_M)])
    assert heights[0] == pytest.approx(20.0)
    assert heights[-1] == pytest.approx(600.0)
    assert np.max(heights[1:] / heights[:-1]) <= SCALE_REACH**2


@pytest.mark.parametrize("name", ["lat_deg", "sigma_m", "yaw_rad", "agl_m", "roll_rad"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_prior_that_is_no_number_leaves_nothing_to_try(name, value):
    assert hypotheses(replace(SHARP, **{name: value}), HEIGHTS_M) == []


@pytest.mark.parametrize("wrong", [{"agl_m": 0.0}, {"agl_m": -5.0}, {"sigma_m": -1.0}])
def test_a_prior_that_makes_no_sense_leaves_nothing_to_try(wrong):
    assert hypotheses(replace(SHARP, **wrong), HEIGHTS_M) == []
