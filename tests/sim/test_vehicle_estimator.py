"""The simulated PX4's estimator: how vision is fused, refused, lost and reset."""

import copy
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from px4_bench import Bench

from vwnav.sim.mavlink.command import Result
from vwnav.sim.multirotor.inertial_filter import _ERROR_NOISE, _VELOCITY_NOISE, AxisFilter
from vwnav.sim.px4.estimator import _from_zero_island
from vwnav.sim.px4.modes import NavState


@pytest.fixture(scope="module")
def flying_once() -> Bench:
    return Bench(wind_m_s=5.0, seed=4).hover().offboard((3.0, 0.0, 0.0))


@pytest.fixture
def flying(flying_once: Bench) -> Bench:
    return copy.deepcopy(flying_once)


def set_parameter(bench: Bench, name: str, value: float) -> None:
    bench.vehicle.parameters._values[name] = value


def test_it_stays_within_60_cm_of_the_truth_on_vision(flying: Bench) -> None:
    errors = []
    for _ in range(40):
        flying.run(1.0)
        errors.append(flying.position_error_m)
    assert max(errors) < 0.6


def test_its_tilt_is_right_within_a_degree_while_it_accelerates(flying: Bench) -> None:
    flying.velocity = (-5.0, 3.0, 0.0)
    body, attitude = flying.vehicle.body, flying.vehicle.estimator.attitude
    for _ in range(40):
        flying.run(0.1)
        down = zip(body.rotation[6:], attitude.rotation[6:], strict=True)
        assert sum(a * b for a, b in down) > math.cos(math.radians(1.5))


def test_vision_at_5_hz_or_slower_is_not_fused() -> None:
    bench = Bench()
    bench.vision, bench.vision_every = True, 52  # 208 ms
    bench.run(10.0)
    assert not bench.vehicle.estimator.local_position_ok


def test_vision_at_10_hz_is_fused() -> None:
    bench = Bench()
    bench.vision, bench.vision_every = True, 25
    bench.run(3.0)
    assert bench.vehicle.estimator.local_position_ok


def test_the_prediction_is_flagged_as_gone_within_a_second(flying: Bench) -> None:
    flying.vision = False
    flying.run(0.5)
    assert not flying.vehicle.estimator.fusing
    assert flying.vehicle.estimator.local_position_ok


def test_a_silent_jump_is_followed_in_3_s(flying: Bench) -> None:
    flying.vision_jump_m = 5.0
    flying.run(1.5)
    assert flying.position_error_m < 1.5
    flying.run(2.0)
    assert flying.position_error_m == pytest.approx(5.0, abs=0.8)


def test_a_changed_reset_counter_is_followed_at_once(flying: Bench) -> None:
    before = flying.vehicle.estimator.reset_counter
    flying.vision_jump_m, flying.reset_counter = 30.0, 1
    flying.run(0.2)
    assert flying.position_error_m == pytest.approx(30.0, abs=0.8)
    assert flying.vehicle.estimator.reset_counter == before + 1


def test_vision_that_arrives_100_ms_late_is_fused_where_it_belongs(flying: Bench) -> None:
    flying.vision, flying.vision_noise_m = False, 0.0
    for _ in range(40):
        sample = flying.sample()
        flying.run(0.1)
        flying.vehicle.estimator.handle_vision(sample)
    assert flying.vehicle.estimator.fusing
    assert flying.position_error_m < 0.1


def lost_for_10_s(bench: Bench) -> Bench:
    """From 40 m, in Land and then Descend; what comes back says that it is new."""
    set_parameter(bench, "COM_OBL_RC_ACT", 4)
    bench.velocity = (3.0, 0.0, -2.0)
    bench.run(15.0)
    bench.vision, bench.velocity = False, None
    bench.run(10.0)
    assert not bench.vehicle.estimator.local_position_ok
    assert bench.vehicle.body.d < -20.0
    assert math.hypot(bench.vehicle.body.vn, bench.vehicle.body.ve) > 1.0
    bench.vision, bench.reset_counter = True, 1
    return bench


def slowest_m_s(bench: Bench, seconds: float) -> float:
    """Over the ground."""
    speeds = []
    for _ in range(round(seconds)):
        bench.run(1.0)
        speeds.append(math.hypot(bench.vehicle.body.vn, bench.vehicle.body.ve))
    return min(speeds)


@pytest.mark.parametrize("sigma_m", [None, 40.0])
def test_a_velocity_stops_one_that_has_lost_its_position(flying: Bench, sigma_m) -> None:
    bench = lost_for_10_s(flying)
    bench.vision_sigma_m, bench.vision_tells_velocity = sigma_m, True
    assert bench.run_until_state(NavState.LAND, 3.0) < 2.0
    assert slowest_m_s(bench, 5.0) < 0.5


def test_a_wide_position_alone_tells_it_no_velocity_within_seconds(flying: Bench) -> None:
    bench = lost_for_10_s(flying)
    bench.vision_sigma_m = 40.0
    assert slowest_m_s(bench, 5.0) > 0.5


def test_velocity_is_fused_only_where_it_is_asked_for(flying: Bench) -> None:
    set_parameter(flying, "EKF2_EV_CTRL", 1)
    bench = lost_for_10_s(flying)
    bench.vision_sigma_m, bench.vision_tells_velocity = None, True
    bench.run(3.0)
    assert not bench.vehicle.estimator.local_position_ok


def test_with_a_wide_position_it_lands_but_neither_holds_nor_returns(flying: Bench) -> None:
    bench = lost_for_10_s(flying)
    bench.vision_sigma_m, bench.vision_tells_velocity = 40.0, True
    bench.run(2.0)
    denied = Result.TEMPORARILY_REJECTED
    assert (bench.ask(NavState.HOLD), bench.ask(NavState.RETURN)) == (denied, denied)
    assert bench.ask(NavState.LAND) is Result.ACCEPTED
    bench.run(1.0)
    assert bench.state is NavState.LAND


def test_an_origin_after_the_vision_wrecks_the_position() -> None:
    bench = Bench(home_lat_deg=60.403, home_lon_deg=22.461)
    bench.vision = True
    bench.run(5.0)
    bench.vehicle.estimator.set_origin(60.403, 22.461, 40.0)
    bench.run(2.0)
    assert bench.vehicle.estimator.north.x == pytest.approx(6310841, abs=500)
    assert "horizontal position unstable" in bench.vehicle.commander.problems(bench.vehicle.health)


def test_an_origin_keeps_the_altitude_and_moves_the_zero() -> None:
    bench = Bench(home_alt_amsl_m=120.0)
    bench.run(1.0)
    bench.vehicle.estimator.set_origin(41.1, 29.0, 100.0)
    bench.run(1.0)
    assert bench.vehicle.estimator.down.x == pytest.approx(-20.0, abs=1.0)


def test_the_barometer_alone_holds_the_height(flying: Bench) -> None:
    flying.velocity = (0.0, 0.0, 0.0)
    flying.run(60.0)
    assert abs(flying.vehicle.estimator.down.x - flying.vehicle.body.d) < 2.0


def test_vision_yaw_replaces_a_wrong_compass_when_asked() -> None:
    bench = Bench(heading_bias_deg=10.0)
    set_parameter(bench, "EKF2_EV_CTRL", 9)
    bench.run(1.0)
    assert math.degrees(bench.vehicle.estimator.attitude.yaw_rad) == pytest.approx(10.0, abs=1.5)
    bench.vision, bench.vision_yaw_rad = True, 0.0
    bench.run(8.0)
    assert math.degrees(bench.vehicle.estimator.attitude.yaw_rad) == pytest.approx(0.0, abs=1.0)


def test_the_recorded_jump_is_that_from_latitude_and_longitude_zero() -> None:
    north_m, east_m = _from_zero_island(60.403, 22.461)
    assert north_m == pytest.approx(6310841, abs=200)
    assert east_m == pytest.approx(3000509, abs=200)


@given(st.floats(-5, 5), st.floats(0.01, 4.0), st.lists(st.floats(-20, 20), max_size=30))
def test_the_covariance_stays_positive(
    acceleration: float, variance: float, innovations: list[float]
) -> None:
    axis = AxisFilter(10.0)
    for innovation in innovations:
        axis.predict(acceleration, 0.02)
        axis.grow(0.02)
        axis.fuse_position(innovation, variance)
        axis.fuse_velocity(0.1 * innovation, variance)
    assert min(axis.p00, axis.p11, axis.p22) > 0.0
    assert axis.p00 * axis.p11 >= axis.p01**2


@given(st.lists(st.floats(-5, 5), min_size=9, max_size=9), st.floats(0.001, 0.1))
def test_a_filters_covariance_grows_as_the_motion_says(root: list[float], dt_s: float) -> None:
    """P' = F P F^T + Q of a constant acceleration, by matrices."""
    P = np.reshape(root, (3, 3)) @ np.reshape(root, (3, 3)).T
    axis = AxisFilter(1.0)
    axis.p00, axis.p01, axis.p02, axis.p11, axis.p12, axis.p22 = P[np.triu_indices(3)].tolist()
    F = np.array([[1.0, dt_s, 0.5 * dt_s**2], [0.0, 1.0, dt_s], [0.0, 0.0, 1.0]])
    Q = np.diag([0.0, _VELOCITY_NOISE**2, _ERROR_NOISE**2]) * dt_s
    axis.grow(dt_s)
    grown = (F @ P @ F.T + Q)[np.triu_indices(3)]
    told = axis.p00, axis.p01, axis.p02, axis.p11, axis.p12, axis.p22
    np.testing.assert_allclose(told, grown, rtol=1e-9, atol=1e-9)


@given(st.floats(-50, 50), st.floats(-3, 3))
def test_a_filter_finds_the_position_and_speed_it_is_shown(start: float, speed: float) -> None:
    axis = AxisFilter(10.0)
    for i in range(300):
        axis.predict(0.0, 0.033)
        axis.grow(0.033)
        axis.fuse_position(start + speed * 0.033 * (i + 1) - axis.x, 0.09)
    assert axis.x == pytest.approx(start + speed * 9.9, abs=0.1)
    assert axis.v == pytest.approx(speed, abs=0.1)
