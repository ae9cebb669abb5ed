"""How far off its route an aircraft is, and whether its battery carries it home."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_recovery import ESTIMATE
from vehicles import FLYING

from vwnav.safety.bounds import CarriedOff, RouteBounds
from vwnav.safety.energy import EnergyWatch
from vwnav.safety.safety_config import SafetyConfig

ROUTE, HOME = np.array([[100.0, 0.0, -50.0], [100.0, 80.0, -50.0]]), np.array([0.0, 0.0])


@pytest.mark.parametrize(
    ("ne_m", "off_m"),
    [
        ((50.0, -7.0), 7.0),  # beside the first leg
        ((103.0, 40.0), 3.0),
        ((-30.0, -40.0), 50.0),  # behind home
        ((100.0, 95.0), 15.0),  # beyond the last waypoint
        ((50.0, 40.0), 0.0),  # on the way home
    ],
)
def test_the_distance_is_that_to_the_nearest_leg(ne_m, off_m):
    bounds = RouteBounds(ROUTE, HOME)
    assert bounds.off_route_m(np.array([*ne_m, -999.0])) == pytest.approx(off_m, abs=1e-6)


@given(st.floats(-500.0, 500.0), st.floats(-500.0, 500.0))
def test_no_sample_of_the_legs_is_nearer(north_m, east_m):
    stops = np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 80.0], [0.0, 0.0]])
    shares = np.linspace(0.0, 1.0, 201)[:, None]
    legs = [a + shares * (b - a) for a, b in itertools.pairwise(stops)]
    sampled_m = min(float(np.min(np.hypot(*(leg - (north_m, east_m)).T))) for leg in legs)
    off_m = RouteBounds(ROUTE, HOME).off_route_m(np.array([north_m, east_m, 0.0]))
    assert off_m <= sampled_m + 1e-9
    assert off_m >= sampled_m - 0.4


def test_a_route_that_is_home_itself_has_a_distance():
    bounds = RouteBounds(np.zeros((1, 3)), HOME)
    assert bounds.off_route_m(np.array([3.0, 4.0, 0.0])) == pytest.approx(5)


def away(north_m: float, wind=None, agl_m: float = 50.0):
    position = np.array([north_m, 0.0, -50.0])
    wind = None if wind is None else np.array(wind)
    return replace(ESTIMATE, position_ned_m=position, agl_m=agl_m, wind_ne_m_s=wind)


def straight(estimate, lowest_m: float = 15.0) -> np.ndarray:
    return np.array([[*HOME, min(estimate.position_ned_m[2], -lowest_m)]])


def home_s(estimate, lowest_m: float = 15.0) -> float:
    return EnergyWatch(SafetyConfig(), 8.0).home_s(estimate, straight(estimate, lowest_m))


def watching() -> EnergyWatch:
    watch = EnergyWatch(SafetyConfig(), 8.0)
    watch.way_home_ned_m = straight
    return watch


def test_the_way_home_takes_its_length_at_cruise_and_a_metre_a_second_down():
    assert home_s(away(400.0)) == pytest.approx(400.0 / 8.0 + 50.0)
    assert home_s(away(0.5, (0.0, 10.0))) == pytest.approx(0.5 / 8.0 + 50.0)


def test_from_low_down_it_takes_the_climb_to_the_height_of_the_return_besides():
    low = replace(away(400.0, agl_m=4.0), position_ned_m=np.array([400.0, 0.0, -4.0]))
    assert home_s(low) == pytest.approx(400.0 / 8.0 + 11.0 + 15.0)


@pytest.mark.parametrize("agl_m", [20.0, 90.0])
def test_what_it_comes_down_is_its_height_above_home_whatever_ground_it_is_over(agl_m):
    assert home_s(away(400.0, agl_m=agl_m)) == pytest.approx(400.0 / 8.0 + 50.0)


def test_a_way_home_over_a_ridge_takes_the_climb_and_each_leg():
    assert home_s(away(400.0), 80.0) == pytest.approx(400.0 / 8.0 + 30.0 + 80.0)
    back = np.array([[400.0, 300.0, -50.0], [0.0, 300.0, -50.0], [0.0, 0.0, -50.0]])
    watch = EnergyWatch(SafetyConfig(), 8.0)
    assert watch.home_s(away(400.0), back) == pytest.approx(1000.0 / 8.0 + 50.0)


def test_a_wind_from_aside_takes_what_is_held_against_it():
    made_m_s = math.sqrt(12.0**2 - 11.0**2)
    assert home_s(away(400.0, (0.0, 11.0))) == pytest.approx(400.0 / made_m_s + 50.0)
    assert home_s(away(400.0, (0.0, -30.0))) == pytest.approx(400.0 / 1.0 + 50.0)


def test_a_head_wind_makes_it_longer_and_a_tail_wind_no_faster_than_cruise():
    assert home_s(away(400.0, (-10.0, 0.0))) == home_s(away(400.0))  # home is south of it
    assert home_s(away(400.0, (8.0, 0.0))) == pytest.approx(400.0 / 4.0 + 50.0)
    assert home_s(away(400.0, (30.0, 0.0))) == pytest.approx(400.0 / 1.0 + 50.0)


def flown(seconds: float, used: float, north_m: float = 800.0, **changes) -> bool:
    """Whether it says that it is time, at the end of a flight that used so much."""
    watch = watching()
    vehicle = replace(FLYING, in_air=True, battery_ratio=0.5)
    watch.step(vehicle, away(0.0), 100.0)
    last = replace(vehicle, **{"battery_ratio": 0.5 - used} | changes)
    return watch.step(last, away(north_m), 100.0 + seconds)


def test_it_is_time_when_what_is_left_is_less_than_what_the_way_takes_and_a_share_more():
    # 150 s home; left of 0.5 - used above 12 %, at used / 60 s.
    turn = 0.38 / (1.0 + 1.3 * 150.0 / 60.0)
    assert not flown(60.0, turn - 0.002)
    assert flown(60.0, turn + 0.002)
    assert not flown(60.0, turn + 0.002, north_m=400.0)


def test_nobody_can_tell_before_half_a_minute_and_three_per_cent():
    assert not flown(29.9, 0.3)
    assert flown(30.0, 0.3)
    assert not flown(60.0, 0.029, north_m=1e5)
    assert flown(60.0, 0.031, north_m=1e5)


@pytest.mark.parametrize("changes", [{"battery_ratio": None}, {"in_air": False}])
def test_without_a_reading_or_on_the_ground_there_is_no_verdict(changes):
    assert not flown(60.0, 0.3, **changes)


def test_a_fresh_battery_begins_anew():
    watch = watching()
    low, full = (replace(FLYING, in_air=True, battery_ratio=r) for r in (0.3, 0.9))
    watch.step(low, away(0.0), 0.0)
    watch.step(full, away(0.0), 50.0)
    used = replace(full, battery_ratio=0.5)
    assert not watch.step(used, away(800.0), 79.0)  # 29 s since it was full
    assert watch.step(used, away(8000.0), 81.0)
    assert math.isfinite(watch.home_s(away(0.0), straight(away(0.0))))


def test_who_is_carried_off_is_told_from_who_flies_home_whichever_way():
    """Straight home across a wide route he leaves its legs behind, by the flown way home first."""
    across, by_the_route = [(100.0, 400.0), (190.0, 300.0), (120.0, 100.0)], [(150.0, 400.0),
        (90.0, 450.0), (70.0, 600.0)]  # fmt: skip
    for way in (across, by_the_route):
        drift = CarriedOff(60.0)
        assert max(drift.step(*each) for each in way) == 0.0
    drift = CarriedOff(60.0)
    assert [drift.step(*each) for each in ((65.0, 90.0), (100.0, 120.0), (150.0, 170.0))] == [
        0.0, 30.0, 80.0,
    ]  # fmt: skip
    assert drift.step(50.0, 80.0) == 0.0
    assert drift.step(150.0, 170.0) == 0.0
