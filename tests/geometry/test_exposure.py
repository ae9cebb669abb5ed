"""How long an exposure may be for how the aircraft moves."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.geometry.exposure import MOST_BLUR_PX, BlurLimit, blur_px_s
from vwnav.types import Estimate

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
FLYING = Estimate(
    t_s=0.0,
    position_ned_m=np.zeros(3),
    velocity_ned_m_s=np.array([8.0, 0.0, 0.0]),
    covariance=np.eye(6),
    quat_wxyz=LEVEL,
    sigma_yaw_rad=0.1,
    agl_m=50.0,
    sigma_agl_m=1.0,
    t_last_fix_s=None,
    reset_counter=0,
)


def test_the_numbers_of_the_hardware_page():
    """78 degrees, 640 px: 16 ms at 50 m and 12 m/s, 8 ms at 25 m."""
    focal_px = 320.0 / math.tan(math.radians(39.0))
    assert pytest.approx(0.0158, abs=1e-4) == MOST_BLUR_PX / blur_px_s(focal_px, 12.0, 50.0)
    assert pytest.approx(0.0079, abs=1e-4) == MOST_BLUR_PX / blur_px_s(focal_px, 12.0, 25.0)


@given(st.floats(100.0, 5000.0), st.floats(0.0, 40.0), st.floats(-5.0, 500.0))
def test_no_image_of_a_steady_flight_is_blurred(focal_px, speed_m_s, agl_m):
    limit = BlurLimit(focal_px, 8.0, 50.0)
    velocity = np.array([0.6 * speed_m_s, 0.0, 0.8 * speed_m_s])
    now = replace(FLYING, velocity_ned_m_s=velocity, agl_m=agl_m)
    most_s = limit.most_s(now)
    assert 0.0 < most_s <= MOST_BLUR_PX
    assert blur_px_s(focal_px, speed_m_s, agl_m) * most_s <= MOST_BLUR_PX + 1e-9


def test_without_an_estimate_it_is_that_of_the_plan():
    limit = BlurLimit(500.0, 10.0, 40.0)
    planned_s = MOST_BLUR_PX / (500.0 * 10.0 / 40.0)
    assert limit.most_s(None) == pytest.approx(planned_s)
    limit.most_s(replace(FLYING, velocity_ned_m_s=np.array([30.0, 0.0, 0.0])))
    assert limit.most_s(None) == pytest.approx(planned_s)


def test_a_turn_shortens_it_for_two_seconds():
    limit = BlurLimit(500.0, 10.0, 40.0)
    steady_s = limit.most_s(FLYING)
    half = 0.05 * 0.5  # 0.5 rad/s for 0.1 s
    turned = np.array([math.cos(half), math.sin(half), 0.0, 0.0])
    turning_s = limit.most_s(replace(FLYING, t_s=0.1, quat_wxyz=turned))
    assert turning_s == pytest.approx(MOST_BLUR_PX / (500.0 * (8.0 / 50.0 + 0.5)))
    assert limit.most_s(replace(FLYING, t_s=1.9, quat_wxyz=turned)) == pytest.approx(turning_s)
    assert limit.most_s(replace(FLYING, t_s=2.2, quat_wxyz=turned)) == pytest.approx(steady_s)


def test_a_heading_that_is_corrected_is_no_turn_that_would_make_it_night():
    limit = BlurLimit(500.0, 10.0, 40.0)
    limit.most_s(FLYING)
    about = np.array([0.0, 0.0, 0.0, 1.0])
    assert limit.most_s(replace(FLYING, t_s=0.02, quat_wxyz=about)) > 0.001
    assert limit.most_s(replace(FLYING, t_s=0.02, quat_wxyz=LEVEL)) > 0.001
