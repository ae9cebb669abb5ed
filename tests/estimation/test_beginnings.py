"""Beginnings in the air and at places nobody knows: what the filter may not take for known."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.estimation.beginning.first_fix import start_at
from vwnav.estimation.beginning.starts import Start, begun_anew
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.ekf import Ekf
from vwnav.estimation.events import NedFix
from vwnav.estimation.states import States, Verdict
from vwnav.types import Attitude, Height, ImuSample, MapFix, Range

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
STEP_S = 0.02
TRUE_AGL_M = 50.0


def fix_at(t_s: float, ne_m, agl_m: float = TRUE_AGL_M, sigma_m: float = 0.3, yaw_rad=0.0):
    leaning_m = agl_m * math.radians(2.0)
    return NedFix(
        t_s=t_s,
        position_ne_m=np.array(ne_m, dtype=float),
        covariance_ne_m2=(sigma_m**2 + leaning_m**2) * np.eye(2),
        yaw_rad=yaw_rad,
        sigma_yaw_rad=0.01,
        agl_m=agl_m,
        sigma_agl_m=0.7,
        sigma_tilt_rad=math.radians(2.0),
    )


class Aircraft:
    """A level one, straight up and down, and what its autopilot tells of that."""

    def __init__(self, ekf: Ekf, up_m: float, barometer_m: float, ranges: bool) -> None:
        self.ekf, self.up_m, self.barometer_m, self.ranges = ekf, up_m, barometer_m, ranges
        self.t_s, self.climbs_m_s = 0.0, 0.0
        self.rng = np.random.default_rng(0)
        self.steps = 0

    def fly(self, seconds: float, climb_m_s: float = 0.0) -> None:
        for _ in range(round(seconds / STEP_S)):
            push = (climb_m_s - self.climbs_m_s) / 0.3
            self.climbs_m_s += push * STEP_S
            self.up_m += self.climbs_m_s * STEP_S
            self.t_s += STEP_S
            self.tell(push)

    def tell(self, push: float) -> None:
        noise = self.rng.normal(size=8)
        force, rates = np.array([0.0, 0.0, -9.80665 - push]) + 0.05 * noise[:3], 1e-3 * noise[3:6]
        self.ekf.handle(Attitude(self.t_s, LEVEL))
        self.ekf.handle(ImuSample(self.t_s, force, rates, STEP_S))
        self.steps += 1
        if self.steps % 5 == 0:
            told_m = self.up_m - self.barometer_m
            self.ekf.handle(Height(self.t_s, told_m + 0.1 * float(noise[6])))
            if self.ranges:
                self.ekf.handle(Range(self.t_s, max(self.up_m + 0.03 * float(noise[7]), 0.1)))

    @property
    def estimate(self):
        return self.ekf.estimate(self.t_s)


def found(t_s: float, agl_m: float) -> MapFix:
    return MapFix(
        t_s=t_s,
        lat_deg=60.0,
        lon_deg=22.0,
        covariance_ne_m2=3.0 * np.eye(2),
        yaw_rad=0.0,
        sigma_yaw_rad=0.01,
        agl_m=agl_m,
        sigma_agl_m=0.7,
        point="nadir",
        features="sift",
    )


@pytest.mark.parametrize("ranges", [False, True])
@pytest.mark.parametrize("zeroed_m", [0.0, 5.0, 20.0, 50.0, 55.0])
def test_a_start_in_the_air_keeps_the_height_that_the_map_told(zeroed_m, ranges):
    """A barometer counts from where the link came up, which may be in the air."""
    ekf = Ekf(EkfConfig())
    aircraft = Aircraft(ekf, TRUE_AGL_M, zeroed_m, ranges)
    aircraft.fly(1.0)
    ekf.initialise(start_at(found(aircraft.t_s, TRUE_AGL_M), np.zeros(3)))
    for _ in range(20):
        aircraft.fly(0.4)
        assert ekf.handle(fix_at(aircraft.t_s, (0.0, 0.0))).accepted
        assert aircraft.estimate.agl_m == pytest.approx(TRUE_AGL_M, abs=2.0)
    assert ekf.state.range_trust.doubted_s is None


def test_a_successor_whose_filter_begins_anew_keeps_height_and_bias_of_its_barometer():
    ekf = Ekf(EkfConfig())
    place = np.array([0.0, 0.0, -TRUE_AGL_M])
    ekf.initialise(Start(t_s=0.0, position_ned_m=place, agl_m=TRUE_AGL_M, sigma_baro_m=50.0))
    Aircraft(ekf, TRUE_AGL_M, TRUE_AGL_M, ranges=False).fly(5.0)
    state = ekf.state
    anew = begun_anew(state, EkfConfig())
    told_m = float(anew.x[States.BARO] - anew.x[States.DOWN])
    assert told_m == pytest.approx(0.0, abs=0.5)
    assert anew.x[States.DOWN] == pytest.approx(-TRUE_AGL_M, abs=1.0)
    H = np.zeros(States.SIZE)
    H[States.DOWN], H[States.BARO] = -1.0, 1.0
    assert math.sqrt(H @ anew.P @ H) < 3.0
    assert math.sqrt(anew.P[States.DOWN, States.DOWN]) > 20.0
    zeroed = begun_anew(state._replace(baro_zeroed=True), EkfConfig())
    assert abs(zeroed.x[States.BARO]) <= 2.0


@pytest.mark.parametrize("ranges", [False, True])
@pytest.mark.parametrize("north_m", [600.0, -600.0])
def test_a_first_fix_far_from_the_origin_leaves_the_ground_under_the_feet(north_m, ranges):
    """Who stands 600 m from the frame's origin stands on ground of there, 30 m higher or lower."""
    ekf = Ekf(EkfConfig(), ground=lambda north_m, east_m: 0.05 * north_m)
    ekf.initialise(Start(t_s=0.0))
    aircraft = Aircraft(ekf, 0.15, 0.15, ranges)
    aircraft.fly(1.0)
    aircraft.fly(18.0, climb_m_s=2.5)
    aircraft.fly(1.0)
    assert np.hypot(*aircraft.estimate.slope_ne) < 1e-3
    assert aircraft.estimate.sigma_agl_m < 2.0
    for _ in range(3):
        told = ekf.handle(fix_at(aircraft.t_s, (north_m, 0.0), aircraft.up_m))
        assert told.parts[-1].verdict is Verdict.FUSED
        assert aircraft.estimate.agl_m == pytest.approx(aircraft.up_m, abs=2.0)
        aircraft.fly(0.4)
    assert ekf.state.range_trust.doubted_s is None


@given(
    apart_s=st.floats(0.3, 200.0),
    off_m=st.floats(4.0, 15.0),
    bearing_rad=st.floats(-math.pi, math.pi),
    turned_deg=st.floats(-25.0, 25.0),
)
def test_a_lone_wrong_fix_long_after_a_lone_right_one_is_believed_by_half(
    apart_s, off_m, bearing_rad, turned_deg
):
    """After an outage its residual and the one of before differ by no more than drift explains."""
    ekf = Ekf(EkfConfig())
    place = np.array([0.0, 0.0, -TRUE_AGL_M])
    ekf.initialise(Start(t_s=0.0, position_ned_m=place, sigma_m=6.0, agl_m=TRUE_AGL_M))
    tell(ekf, 0.1, 2.0)
    ekf.handle(fix_at(2.0, (0.3, -0.2), sigma_m=0.3))
    tell(ekf, 2.1, 2.0 + apart_s)
    wrong_m = off_m * np.array([math.cos(bearing_rad), math.sin(bearing_rad)])
    ekf.handle(fix_at(2.0 + apart_s, wrong_m, sigma_m=0.3, yaw_rad=math.radians(turned_deg)))
    state = ekf.state
    off = float(np.linalg.norm(state.x[States.POSITION_NE]))
    assert off < 5.0 * math.sqrt(np.trace(state.P[States.POSITION_NE, States.POSITION_NE]))
    bias = States.HEADING_BIAS
    assert abs(state.x[bias]) < 5.0 * math.sqrt(state.P[bias, bias])


def tell(ekf: Ekf, first_s: float, last_s: float) -> None:
    """Attitudes and heights, a few a second, and no image that tells a way."""
    step_s = max(0.1, (last_s - first_s) / 100.0)
    for t_s in np.arange(first_s, last_s + 1e-9, step_s).tolist():
        ekf.handle(Attitude(t_s, LEVEL))
        ekf.handle(Height(t_s, TRUE_AGL_M))


def test_who_begins_again_elsewhere_says_so_by_a_reset_counter_that_was_not_told_yet():
    """From 0 again, a place 400 m off could come with the counter that was sent last."""
    ekf = Ekf(EkfConfig())
    ekf.initialise(Start(t_s=0.0, position_ned_m=None, agl_m=TRUE_AGL_M, sigma_velocity_m_s=15.0))
    aircraft = Aircraft(ekf, TRUE_AGL_M, TRUE_AGL_M, ranges=False)
    for _ in range(3):
        aircraft.fly(0.5)
        ekf.handle(fix_at(aircraft.t_s, [40.0, 30.0]))
    before = ekf.estimate(aircraft.t_s)
    assert before.reset_counter > 0
    again = np.array([-300.0, 80.0, -TRUE_AGL_M])
    ekf.initialise(Start(t_s=aircraft.t_s, position_ned_m=again, sigma_m=1.0, agl_m=TRUE_AGL_M))
    assert ekf.estimate(aircraft.t_s).reset_counter > before.reset_counter
