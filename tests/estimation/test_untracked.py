"""Images of a video alone that cannot be followed: what they leave open, and for how long."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.estimation.beginning.starts import Start, begun_anew
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.ekf import Ekf
from vwnav.estimation.events import NedFix, Untracked
from vwnav.estimation.states import Verdict
from vwnav.types import Attitude, Estimate, OdometryMotion

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
AGL_M, SPEED_M_S, INTERVAL_S = 80.0, 10.0, 0.1
gaps = st.lists(st.floats(0.02, 2.0), min_size=1, max_size=12)


def fix(t_s: float, yaw_rad: float = 0.0) -> NedFix:
    place, covariance_m2 = np.array([SPEED_M_S * t_s, 0.0]), np.eye(2)
    return NedFix(
        t_s=t_s, position_ne_m=place, covariance_ne_m2=covariance_m2,
        yaw_rad=yaw_rad, sigma_yaw_rad=0.01, agl_m=AGL_M, sigma_agl_m=1.0,
    )  # fmt: skip


def way(t0_s: float, t1_s: float) -> OdometryMotion:
    seen_m = np.array([SPEED_M_S * (t1_s - t0_s), 0.0, 0.0])
    return OdometryMotion(t0_s, t1_s, seen_m, 0.01 * np.eye(3), 0.0, 0.005, AGL_M, 99)


def followed(seconds: float = 2.0) -> tuple[Ekf, float]:
    """A video alone that flies north at 10 m/s and is seen to, and the time of its last image."""
    ekf, t_s = Ekf(EkfConfig().without_telemetry()), 0.0
    start = np.array([0.0, 0.0, -AGL_M])
    ekf.initialise(Start(t_s=0.0, position_ned_m=start, agl_m=AGL_M, sigma_velocity_m_s=15.0))
    ekf.handle(Attitude(0.0, LEVEL))
    ekf.handle(fix(0.0))
    for _ in range(round(seconds / INTERVAL_S)):
        see(ekf, t_s, t_s + INTERVAL_S)
        t_s += INTERVAL_S
        ekf.handle(fix(t_s))
    return ekf, t_s


def see(ekf: Ekf, t0_s: float, t1_s: float) -> Verdict:
    """An image that was followed from the one before."""
    ekf.handle(Attitude(t1_s, LEVEL))
    return ekf.handle(way(t0_s, t1_s)).verdict


def lose(ekf: Ekf, t_s: float, *gaps_s: float) -> float:
    """Images so far apart that were not followed; the time of the last one."""
    for gap_s in gaps_s:
        t_s += gap_s
        ekf.estimate(t_s)  # which tells the filter the time, as a pipeline does
        ekf.handle(Attitude(t_s, LEVEL))
        ekf.handle(Untracked(t_s))
    return t_s


def sigmas(found: Estimate) -> np.ndarray:
    """Of place, velocity, heading and height."""
    variances = np.diag(found.covariance)
    return np.array([*np.sqrt(variances), found.sigma_yaw_rad, found.sigma_agl_m])


@given(gaps)
def test_no_sigma_falls_while_no_image_is_followed(gaps_s):
    ekf, t_s = followed(0.5)
    before = sigmas(ekf.estimate(t_s))
    for gap_s in gaps_s:
        t_s = lose(ekf, t_s, gap_s)
        now = sigmas(ekf.estimate(t_s))
        assert np.all(now >= before)
        before = now


@given(gaps)
def test_how_often_images_come_that_tell_nothing_does_not_matter(gaps_s):
    """A turn lasts: the heading is as open after one gap as after many that are as long."""
    many, t_s = followed(0.5)
    one, _ = followed(0.5)
    t1_s = lose(many, t_s, *gaps_s)
    lose(one, t_s, t1_s - t_s)
    found, expected = sigmas(many.estimate(t1_s)), sigmas(one.estimate(t1_s))
    assert found[6] == pytest.approx(expected[6], rel=1e-6)
    assert found[:6] == pytest.approx(expected[:6], rel=0.03)


def test_a_quarter_turn_in_a_second_is_within_two_sigmas_and_soon_the_heading_is_not_known():
    ekf, t_s = followed()
    assert ekf.estimate(t_s).sigma_yaw_rad < math.radians(1.0)
    t_s = lose(ekf, t_s, 0.1)
    assert math.radians(5.0) < ekf.estimate(t_s).sigma_yaw_rad < math.radians(12.0)
    assert ekf.state.heading_known
    t_s = lose(ekf, t_s, *[0.1] * 9)
    assert ekf.estimate(t_s).sigma_yaw_rad > math.radians(45.0)
    assert not ekf.state.heading_known


def test_ways_are_not_turned_by_a_heading_that_is_not_known_until_a_fix_tells_it():
    ekf, t_s = followed()
    t_s = lose(ekf, t_s, 0.6)
    open_m = ekf.estimate(t_s).sigma_horizontal_m
    assert see(ekf, t_s, t_s + 0.1) is Verdict.HEADING_UNKNOWN
    assert ekf.estimate(t_s + 0.1).sigma_horizontal_m > open_m
    ekf.handle(fix(t_s + 0.1, yaw_rad=0.3))
    assert math.radians(10.0) < ekf.estimate(t_s + 0.1).sigma_yaw_rad < math.radians(16.0)
    assert ekf.state.heading_known
    for later_s in (0.1, 0.2):
        assert see(ekf, t_s + later_s, t_s + later_s + 0.1) is Verdict.FUSED
        ekf.handle(fix(t_s + later_s + 0.1, yaw_rad=0.3))
    assert ekf.estimate(t_s + 0.3).sigma_yaw_rad < math.radians(2.0)


def test_an_outage_is_counted_from_the_last_image_that_was_followed():
    """Two of half a second leave less open than one of a second."""
    apart, t_s = followed()
    t_s = lose(apart, t_s, 0.2)
    see(apart, t_s, t_s + 0.1)
    t_s = lose(apart, t_s + 0.1, 0.2)
    together, t0_s = followed()
    lose(together, t0_s, 0.2, 0.2)
    found, one = apart.estimate(t_s), together.estimate(t_s)
    assert found.sigma_yaw_rad == pytest.approx(one.sigma_yaw_rad / math.sqrt(2.0), rel=0.01)


def test_a_fix_of_before_the_loss_leaves_the_heading_of_now_open():
    """A search in another thread ends when the history no longer reaches its image."""
    from vwnav.estimation.events import Exposed

    ekf, t_s = followed()
    ekf.handle(Exposed(t_s))
    lost_s = lose(ekf, t_s, *[0.5] * 8)
    assert ekf.handle(fix(t_s)).accepted
    assert not ekf.state.heading_known
    assert ekf.estimate(lost_s).sigma_yaw_rad > math.radians(45.0)


def test_a_video_alone_that_begins_anew_does_not_know_its_heading():
    ekf, _ = followed()
    again = begun_anew(ekf.state, EkfConfig().without_telemetry())
    assert not again.heading_known
    assert begun_anew(ekf.state, EkfConfig()).heading_known
