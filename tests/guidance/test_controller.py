import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.guidance.controller import RouteFollower
from vwnav.guidance.limits import LimitsConfig
from vwnav.vehicle import VelocitySetpoint

LIMITS = LimitsConfig()
# 803 m with a slight turn, right angles, a climb and an acute corner.
ROUTE = np.array(
    [[120, 0, -50], [200, 20, -50], [200, 175, -50], [50, 175, -56], [50, -50, -50], [0, 0, -50.0]]
)
numbers = st.floats(allow_nan=True, allow_infinity=True)
lengths = st.floats(-1e4, 1e4)


def off_route_m(track: np.ndarray, route: np.ndarray) -> np.ndarray:
    """Horizontal distance (k,) of each point to the nearest leg."""
    points = np.vstack([[0.0, 0.0], route[:, :2]])
    nearest = np.full(len(track), np.inf)
    for a, b in itertools.pairwise(points):
        part = np.clip((track[:, :2] - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        leg = a + part[:, None] * (b - a)
        nearest = np.minimum(nearest, np.hypot(*(track[:, :2] - leg).T))
    return nearest


@pytest.mark.parametrize("seed", range(4))
def test_an_800_m_route_is_followed_within_a_metre_in_gusts(make_drone, fly, seed: int) -> None:
    points = np.vstack([[0.0, 0.0, -50.0], ROUTE])
    assert np.hypot(*np.diff(points[:, :2], axis=0).T).sum() > 800.0
    track = fly(make_drone(seed), RouteFollower(ROUTE, LIMITS).step, 180.0)
    off_m = off_route_m(track, ROUTE)
    assert off_m.max() < 1.0
    assert np.sqrt((off_m**2).mean()) < 0.4
    assert np.hypot(*(track[-1, :2] - ROUTE[-1, :2])) < 2.0


def test_calm_air_and_sure_estimates_leave_corners_only(make_drone, fly) -> None:
    drone = make_drone(0, noise_m=0.0, gust_m_s2=0.0, wind_m_s2=np.zeros(3))
    off_m = off_route_m(fly(drone, RouteFollower(ROUTE, LIMITS).step, 180.0), ROUTE)
    assert off_m.max() < 0.6
    assert np.median(off_m) < 0.02


def test_fast_flight_with_bad_estimates_stays_stable(make_drone, fly) -> None:
    limits = LimitsConfig(cruise_m_s=10.0, speed_max_m_s=12.0)
    drone = make_drone(1, noise_m=0.8)
    off_m = off_route_m(fly(drone, RouteFollower(ROUTE, limits).step, 180.0), ROUTE)
    assert off_m.max() < 4.0


def test_height_follows_the_slope_of_the_legs(make_drone, fly) -> None:
    track = fly(make_drone(2), RouteFollower(ROUTE, LIMITS).step, 180.0)
    climbing = track[(track[:, 1] > 173.0) & (track[:, 0] > 60.0) & (track[:, 0] < 190.0)]
    due_m = -50.0 - 6.0 * (200.0 - climbing[:, 0]) / 150.0
    assert np.abs(climbing[:, 2] - due_m).max() < 1.2


def test_corners_are_flown_slowly_and_straight_on_is_not(make_drone, fly) -> None:
    route = np.array([[100, 0, -50], [200, 0, -50], [200, 100, -50.0]])
    track = fly(make_drone(3), RouteFollower(route, LIMITS).step, 120.0)
    speed_m_s = np.hypot(track[:, 3], track[:, 4])
    at = [np.argmin(np.hypot(*(track[:, :2] - point[:2]).T)) for point in route[:2]]
    assert speed_m_s[at[0]] > 7.0
    assert speed_m_s[at[1]] < 2.5


def test_the_end_is_reached_slowly_and_then_held(make_drone, fly, make_estimate) -> None:
    follower = RouteFollower(ROUTE[:1], LIMITS)
    track = fly(make_drone(4), follower.step, 60.0)
    assert np.linalg.norm(track[-1, 3:]) < 1.2
    later = follower.step(make_estimate(ROUTE[0], t_s=1000.0))
    assert later.done
    assert abs(later.setpoint.north_m_s) < 1.0


def test_not_done_while_still_fast_at_the_last_waypoint(make_estimate) -> None:
    follower = RouteFollower(ROUTE[:1], LIMITS)
    follower.step(make_estimate([0.0, 0.0, -50.0]))
    fast = make_estimate(ROUTE[0], np.array([5.0, 0.0, 0.0]), t_s=1.0)
    assert not follower.step(fast).done
    assert follower.step(make_estimate(ROUTE[0], t_s=2.0)).done


@given(
    st.lists(st.tuples(lengths, lengths, lengths), min_size=1, max_size=6),
    st.lists(st.tuples(lengths, lengths, lengths, st.floats(0.0, 0.4)), min_size=2, max_size=20),
)
def test_no_setpoint_exceeds_the_limits(make_estimate, route, places) -> None:
    follower = RouteFollower(np.array(route), LIMITS)
    t_s, before, yaw_before = 0.0, None, None
    for *position, step_s in places:
        t_s += step_s
        setpoint = follower.step(make_estimate(position, t_s=t_s, yaw_rad=0.4)).setpoint
        velocity = np.array([setpoint.north_m_s, setpoint.east_m_s])
        assert np.hypot(*velocity) <= LIMITS.speed_max_m_s + 1e-9
        assert -LIMITS.climb_m_s <= setpoint.down_m_s <= LIMITS.descend_m_s
        if before is not None:
            most = LIMITS.acceleration_m_s2 * step_s + 1e-9
            assert np.hypot(*(velocity - before)) <= most
            turn = (setpoint.yaw_rad - yaw_before + math.pi) % (2 * math.pi) - math.pi
            assert abs(turn) <= LIMITS.yaw_rate_rad_s * step_s + 1e-9
        before, yaw_before = velocity, setpoint.yaw_rad


@given(
    st.lists(
        st.tuples(numbers, numbers, numbers, numbers, numbers, numbers), min_size=1, max_size=10
    )
)
def test_no_estimate_whatever_makes_a_setpoint_that_is_not_finite(make_estimate, values) -> None:
    follower = RouteFollower(ROUTE, LIMITS)
    for north, east, down, speed, t_s, sigma in values:
        velocity = np.array([speed, 0.0, 0.0])
        estimate = make_estimate(
            [north, east, down], velocity, t_s=t_s, covariance=np.diag(np.full(6, sigma))
        )
        setpoint = follower.step(estimate).setpoint
        velocity = (setpoint.north_m_s, setpoint.east_m_s, setpoint.down_m_s)
        assert all(math.isfinite(v) for v in velocity)
        assert setpoint.yaw_rad is None or math.isfinite(setpoint.yaw_rad)


def test_estimate_that_is_not_finite_stops_the_aircraft(make_estimate) -> None:
    guidance = RouteFollower(ROUTE, LIMITS).step(make_estimate([math.nan, 0.0, 0.0]))
    assert guidance.setpoint == VelocitySetpoint(0.0, 0.0, 0.0)
    assert not guidance.done


@pytest.mark.parametrize(("sigma_m", "target"), [(0.5, 0), (4.0, 1), (100.0, 1)])
def test_waypoint_counts_within_one_sigma_up_to_a_limit(
    make_estimate, sigma_m: float, target: int
) -> None:
    follower = RouteFollower(np.array([[100, 0, -50], [100, 100, -50.0]]), LIMITS)
    follower.step(make_estimate([0.0, 0.0, -50.0]))
    near = make_estimate([96.5, 0.0, -50.0], t_s=1.0, sigma_m=sigma_m)
    assert follower.step(near).target_index == target


def test_waypoint_does_not_count_at_another_height(make_estimate) -> None:
    follower = RouteFollower(np.array([[100, 0, -50], [100, 100, -50.0]]), LIMITS)
    follower.step(make_estimate([0.0, 0.0, -50.0]))
    low = follower.step(make_estimate([100.0, 0.0, -40.0], t_s=1.0))
    assert low.target_index == 0
    assert low.setpoint.down_m_s < 0.0


def test_after_a_pause_it_starts_from_the_speed_there_is(make_estimate) -> None:
    follower = RouteFollower(ROUTE, LIMITS)
    for i in range(100):
        fast = follower.step(make_estimate([0.5 * i, 0.0, -50.0], t_s=i * 0.1)).setpoint
    assert fast.north_m_s > 7.0
    held = make_estimate([50.0, 0.0, -50.0], t_s=20.0, yaw_rad=1.0)
    after = follower.step(held).setpoint
    assert after.north_m_s == 0.0
    assert after.yaw_rad == pytest.approx(1.0)


def test_missed_waypoint_is_flown_back_to(make_estimate) -> None:
    follower = RouteFollower(np.array([[100, 0, -50.0]]), LIMITS)
    for i in range(30):
        step = follower.step(make_estimate([0.0 if i == 0 else 110.0, 0.0, -50.0], t_s=i * 0.1))
    assert step.setpoint.north_m_s < -0.5


def test_straight_up_leg_climbs_over_the_place(make_drone, fly) -> None:
    route = np.array([[0, 0, -80], [0, 0, -80], [30, 0, -80.0]])
    track = fly(make_drone(5), RouteFollower(route, LIMITS).step, 60.0)
    below = track[track[:, 2] > -77.0]
    assert np.hypot(below[:, 0], below[:, 1]).max() < 1.0


@pytest.mark.parametrize("end_m", [-35.0, -90.0])
@pytest.mark.parametrize("aside_m", [0.2, 0.6, 3.0, 12.0])
def test_waypoints_nearly_above_each_other_are_flown_by_their_height(
    make_drone, fly, aside_m: float, end_m: float
) -> None:
    route = np.array([[20, 0, -60], [20 + aside_m, 0, end_m], [50, 0, end_m]])
    drone = make_drone(6, noise_m=0.3, position_m=np.array([0.0, 0.0, -60.0]))
    track = fly(drone, RouteFollower(route, LIMITS).step, 60.0)
    assert np.hypot(*(track[-1, :2] - route[-1, :2])) < 2.0
    # Never in the corner below its line: a wall or a slope may be what it climbs, or comes down by.
    on_leg = (track[:, 0] > 20.0) & (track[:, 0] < 20.0 + aside_m)
    due_m = -60.0 + (end_m + 60.0) * (track[on_leg, 0] - 20.0) / aside_m
    assert aside_m < 5.0 or np.all(track[on_leg, 2] - due_m < 3.0)


def test_yaw_turns_along_the_leg_and_stays_on_short_ones(make_estimate) -> None:
    follower = RouteFollower(np.array([[0, 100, -50.0]]), LIMITS)
    for i in range(60):
        yaw_rad = follower.step(make_estimate([0, 0, -50.0], t_s=i * 0.1)).setpoint.yaw_rad
    assert yaw_rad == pytest.approx(math.pi / 2)
    up = RouteFollower(np.array([[0, 0, -90.0]]), LIMITS)
    assert up.step(make_estimate([0, 0, -50.0], yaw_rad=0.7)).setpoint.yaw_rad == pytest.approx(0.7)


@pytest.mark.parametrize(
    "route", [np.zeros((0, 3)), np.zeros((3, 2)), np.array([[0.0, math.nan, 0.0]])]
)
def test_what_is_no_route_is_refused(route: np.ndarray) -> None:
    with pytest.raises(ValueError, match="expected"):
        RouteFollower(route, LIMITS)


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_senseless_limits_are_refused(value: float) -> None:
    with pytest.raises(ValueError, match="cruise_m_s"):
        LimitsConfig(cruise_m_s=value)
