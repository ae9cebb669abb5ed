"""The filter on simulated streams: laws, honesty, and one thing broken at a time."""

import math
from dataclasses import replace

import numpy as np
import pytest
from flights import World, feed, make, run
from hypothesis import given, settings
from hypothesis import strategies as st

from vwnav.estimation.ekf import Ekf, EkfConfig, NedFix, Start
from vwnav.types import Attitude, OdometryMotion

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
CALM = World(seconds=90.0)


def horizontal(flight, after_s=30.0):
    error = np.hypot(*flight.error_ne_m.T)
    return error[flight.t_s > after_s]


@pytest.fixture(scope="module")
def flights():
    return [run(make(CALM, np.random.default_rng(seed))) for seed in range(6)]


def test_position_and_velocity_are_good_enough_to_fly_on(flights):
    errors = np.concatenate([horizontal(flight) for flight in flights])
    assert np.mean(errors) < 1.0
    speeds = np.concatenate([np.hypot(*f.error_v_m_s[f.t_s > 30.0, :2].T) for f in flights])
    assert np.sqrt(np.mean(speeds**2)) < 0.4


def test_the_filter_knows_how_wrong_it_is(flights):
    """Normalised error squared of north and east has mean 2 for an honest filter."""
    nees = []
    for flight in flights:
        for error, P in zip(flight.error_ne_m[300:], flight.P[300:], strict=True):
            nees.append(error @ np.linalg.solve(P[:2, :2], error))
    assert 0.5 < np.mean(nees) < 4.0


def test_the_covariance_stays_symmetric_and_positive(flights):
    for flight in flights:
        for state in flight.states[::20]:
            assert np.allclose(state.P, state.P.T, atol=1e-9)
            assert np.linalg.eigvalsh(state.P)[0] > -1e-9


def test_wrong_fixes_are_refused():
    world = replace(CALM, wrong_share=0.1)
    flight = run(make(world, np.random.default_rng(4)))
    assert np.max(horizontal(flight)) < 5.0


def test_a_compass_that_jumps_by_20_degrees_is_found_out():
    world = replace(CALM, yaw_step_deg=20.0, yaw_step_s=40.0)
    flight = run(make(world, np.random.default_rng(5)))
    late = np.abs(flight.error_yaw_rad[flight.t_s > 60.0])
    assert math.degrees(np.mean(late)) < 1.5


def test_height_above_ground_survives_a_drifting_barometer():
    flight = run(make(replace(CALM, baro_drift_m=3.0), np.random.default_rng(6)))
    assert np.mean(np.abs(flight.error_agl_ratio[flight.t_s > 40.0])) < 0.03


def test_a_wrong_start_is_left_only_when_fixes_agree():
    start = Start(t_s=0.0, position_ned_m=np.array([150.0, 0.0, 0.0]), sigma_m=3.0)
    flight = run(make(CALM, np.random.default_rng(7)), start=start)
    assert np.mean(horizontal(flight, 40.0)) < 1.5
    assert flight.estimates[-1].reset_counter == 1


def test_an_unknown_start_takes_the_first_fixes():
    start = Start(t_s=0.0, position_ned_m=None)
    flight = run(make(CALM, np.random.default_rng(8)), start=start)
    assert np.mean(horizontal(flight)) < 1.5


def test_the_order_of_arrival_does_not_matter():
    stream = make(replace(CALM, seconds=20.0), np.random.default_rng(9))
    by_time = sorted(stream.events, key=lambda event: _measured_at(event))
    results = []
    for events in (stream.sorted(), by_time):
        ekf = Ekf(EkfConfig())
        ekf.initialise(Start(t_s=0.0, position_ned_m=np.zeros(3), sigma_m=3.0))
        for event in events:
            feed(ekf, event)
        results.append(ekf.estimate(19.0))
    first, second = results
    assert np.allclose(first.position_ned_m, second.position_ned_m, atol=0.05)


def _measured_at(event) -> float:
    value = event[2]
    match event[1]:
        case "height":
            return value[0]
        case "odometry":
            return value.t1_s
    return value.t_s


def test_asking_changes_nothing():
    ekf = _flying()
    first = ekf.estimate(1.4)
    for t_s in (1.2, 1.9, 1.3):
        ekf.estimate(t_s)
    again = ekf.estimate(1.4)
    assert np.array_equal(first.position_ned_m, again.position_ned_m)
    assert np.array_equal(first.covariance, again.covariance)


def test_on_a_linear_problem_it_is_the_kalman_filter():
    """A fix on a resting aircraft: position and variance of the textbook's scalar update."""
    ekf = Ekf(EkfConfig())
    ekf.initialise(Start(t_s=0.0, position_ned_m=np.zeros(3), sigma_m=2.0))
    ekf.handle_attitude(Attitude(0.0, LEVEL))
    ekf.handle_fix(NedFix(t_s=0.0, position_ne_m=np.array([1.0, 0.0]), covariance_ne_m2=np.eye(2)))
    found = ekf.estimate(0.0)
    gain = 4.0 / (4.0 + 1.0)
    assert found.position_ned_m[0] == pytest.approx(gain, abs=1e-3)
    assert found.covariance[0, 0] == pytest.approx((1.0 - gain) * 4.0, abs=1e-2)


ANY = st.floats(allow_nan=True, allow_infinity=True, width=64)


@settings(max_examples=60)
@given(values=st.lists(ANY, min_size=8, max_size=8), kind=st.integers(0, 4))
def test_no_measurement_whatever_breaks_it(values, kind):
    ekf = _flying()
    a, b, c, d = (np.array(values[:2]), np.array(values[:3]), values[3], values[4])
    with np.errstate(all="ignore"):
        match kind:
            case 0:
                ekf.handle_fix(NedFix(t_s=c, position_ne_m=a, covariance_ne_m2=np.eye(2) * d))
            case 1:
                ekf.handle_odometry(OdometryMotion(c, d, b, np.eye(3), d, c, values[5], 5))
            case 2:
                ekf.handle_height(c, d)
            case 3:
                ekf.handle_attitude(Attitude(c, np.array(values[:4])))
            case 4:
                ekf.handle_rangefinder(c, d)
    found = ekf.estimate(1.2)
    assert np.all(np.isfinite(found.position_ned_m))
    assert np.linalg.eigvalsh(found.covariance)[0] > -1e-9
    assert np.linalg.norm(found.quat_wxyz) == pytest.approx(1.0)


def _flying() -> Ekf:
    ekf = Ekf(EkfConfig())
    start = np.array([0.0, 0.0, -50.0])
    ekf.initialise(Start(t_s=0.0, position_ned_m=start, sigma_m=2.0, agl_m=50.0))
    for i in range(6):
        ekf.handle_attitude(Attitude(0.2 * i, LEVEL))
        ekf.handle_height(0.2 * i, 50.0)
    return ekf
