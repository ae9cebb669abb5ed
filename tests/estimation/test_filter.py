"""The filter on simulated streams: laws, honesty, and one thing broken at a time."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from vwnav.bench.estimator.flown import Run, accepted_wrong
from vwnav.bench.estimator.run import play
from vwnav.bench.estimator.scores import position_nees
from vwnav.bench.estimator.streams import MeasurementStream, sense
from vwnav.bench.estimator.world import FilterWorld, fly
from vwnav.estimation import odometry
from vwnav.estimation.beginning.starts import Start
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.ekf import Ekf
from vwnav.estimation.events import NedFix
from vwnav.estimation.states import States, Verdict
from vwnav.types import Attitude, Height, ImuSample, OdometryMotion, Range

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
USUAL = FilterWorld(seconds=90.0)


def stream_of(world: FilterWorld, seed: int) -> MeasurementStream:
    rng = np.random.default_rng(seed)
    return sense(world, fly(world, [rng])[0], rng)


def horizontal(run: Run, after_s: float = 30.0):
    error = np.hypot(*run.rows.error_ne_m.T)
    return error[run.rows.t_s > after_s]


@pytest.fixture(scope="module")
def runs():
    rngs = [np.random.default_rng(seed) for seed in range(6)]
    return [play(sense(USUAL, t, r)) for t, r in zip(fly(USUAL, rngs), rngs, strict=True)]


def test_position_and_velocity_are_good_enough_to_fly_on(runs):
    errors = np.concatenate([horizontal(run) for run in runs])
    assert np.mean(errors) < 1.0
    speeds = np.concatenate([np.hypot(*r.rows.error_v_m_s[r.rows.t_s > 30.0, :2].T) for r in runs])
    assert np.sqrt(np.mean(speeds**2)) < 0.4


def test_the_filter_knows_how_wrong_it_is(runs):
    """Normalised error squared of north and east has mean 2 for an honest filter.

    Errors of tilt live for a whole flight: six flights are few, so the bounds are wide here;
    `vwnav bench estimator` holds 200 flights against those of chi-square.
    """
    nees = np.concatenate([position_nees(r.rows)[r.rows.t_s > 30.0] for r in runs])
    assert 1.0 < np.mean(nees) < 3.6


def test_the_covariance_stays_symmetric_and_positive(runs):
    for run in runs:
        assert np.array_equal(run.last.P, run.last.P.T)
        assert np.linalg.eigvalsh(run.last.P)[0] > 0.0
        assert np.all(np.linalg.eigvalsh(run.rows.P) > 0.0)


def test_twenty_seconds_without_a_fix_cost_two_percent_of_the_way():
    world = replace(USUAL, hover_share=0.0, outages_s=((60.0, 80.0),))
    for seed in range(3):
        rows = play(stream_of(world, seed)).rows
        at, before = np.searchsorted(rows.t_s, [79.9, 60.0])
        error_m = np.hypot(*rows.error_ne_m[at])
        sigma_m = math.sqrt(np.linalg.eigvalsh(rows.P[at, :2, :2])[-1])
        assert error_m < 0.02 * (rows.way_m[at] - rows.way_m[before])
        assert error_m < 3.0 * sigma_m


def test_wrong_fixes_are_refused():
    run = play(stream_of(replace(USUAL, wrong_share=0.1), 4))
    assert np.max(horizontal(run)) < 4.0
    assert accepted_wrong(run, 20.0) == 0


def test_ten_wrong_fixes_that_agree_do_not_move_it():
    run = play(stream_of(replace(USUAL, wrong_runs_s=(40.0, 60.0)), 4))
    assert np.max(horizontal(run)) < 4.0
    assert accepted_wrong(run, 20.0) == 0
    assert run.estimates[-1].reset_counter == 0


def test_a_compass_that_jumps_by_20_degrees_is_found_out_within_20_s():
    run = play(stream_of(replace(USUAL, yaw_step_deg=20.0, yaw_step_s=40.0), 5))
    late = np.abs(run.rows.error_yaw_rad[run.rows.t_s > 60.0])
    assert math.degrees(np.max(late)) < 1.5


def test_heading_holds_through_turns_of_90_degrees_a_second():
    run = play(stream_of(replace(USUAL, turn_deg_s=90.0, leg_s=8.0), 5))
    error_deg = np.degrees(run.rows.error_yaw_rad[run.rows.t_s > 30.0])
    assert np.sqrt(np.mean(error_deg**2)) < 1.0
    assert np.max(np.abs(error_deg)) < 3.0


def test_height_above_ground_survives_a_drifting_barometer():
    rows = play(stream_of(replace(USUAL, baro_drift_m=3.0), 6)).rows
    ratio = np.abs(rows.error_agl_m / rows.agl_m)
    assert np.max(ratio[rows.t_s > 40.0]) < 0.03


def test_height_above_a_hill_of_40_m_comes_from_the_terrain_table():
    world = replace(USUAL, height_m=80.0, hill_m=40.0, table=True, hover_share=0.0)
    rows = play(stream_of(world, 6)).rows
    ratio = np.abs(rows.error_agl_m / rows.agl_m)
    assert np.ptp(rows.agl_m[rows.t_s > 40.0]) > 25.0
    assert np.sqrt(np.mean(ratio[rows.t_s > 40.0] ** 2)) < 0.03


def test_a_hundred_fixes_of_one_place_do_not_take_away_what_they_share():
    """The map may be turned and scaled there, and a view may lean: each of them says the same."""
    sigmas = []
    for config in (EkfConfig(), EkfConfig(map_turn_rad=1e-6, map_scale=1e-6)):
        ekf = _flying(config)
        for i in range(1, 101):
            t = 1.0 + 0.2 * i
            ekf.handle(Attitude(t, LEVEL))
            ekf.handle(Height(t, 50.0))
            ekf.handle(
                NedFix(
                    t_s=t, position_ne_m=np.zeros(2), covariance_ne_m2=0.1 * np.eye(2),
                    yaw_rad=0.0, sigma_yaw_rad=0.005, agl_m=50.0, sigma_agl_m=0.5,
                )
            )  # fmt: skip
        found = ekf.estimate(t)
        sigmas.append((found.sigma_seen_yaw_rad, found.sigma_agl_m))
    (yaw_rad, agl_m), (sure_yaw_rad, sure_agl_m) = sigmas
    assert yaw_rad > EkfConfig().map_turn_rad > 1.5 * sure_yaw_rad
    assert agl_m > 1.3 * sure_agl_m


@pytest.mark.parametrize(("height_m", "imu_hz"), [(90.0, 0.0), (140.0, 0.0), (90.0, 50.0)])
def test_a_climb_faster_than_thought_is_no_reason_to_refuse_the_barometer(height_m, imu_hz):
    """At 11 and 17 m/s, after 10 m/s^2 at the start: heights and ways are refused at first."""
    world = replace(USUAL, seconds=40.0, height_m=height_m, imu_hz=imu_hz)
    rows = play(stream_of(world, 0)).rows
    ratio = np.abs(rows.error_agl_m / rows.agl_m)
    assert np.max(ratio[rows.t_s > 15.0]) < 0.05


def test_a_barometer_that_jumps_for_good_costs_no_height_above_ground():
    """A hatch that opens: 12 m. Fixes put it right within seconds."""
    stream = stream_of(replace(USUAL, seconds=60.0), 2)
    jumped = [
        replace(event, seen=Height(event.seen.t_s, event.seen.height_m + 12.0))
        if isinstance(event.seen, Height) and event.seen.t_s > 40.0
        else event
        for event in stream.events
    ]
    rows = play(replace(stream, events=jumped)).rows
    ratio = np.abs(rows.error_agl_m / rows.agl_m)
    assert np.max(ratio[rows.t_s > 45.0]) < 0.03


def test_the_imu_is_used_where_it_is_streamed():
    """Between images the accelerometer knows better than thrust and drag do."""
    world = replace(USUAL, seconds=60.0, hover_share=0.0)
    errors = []
    for imu_hz in (0.0, 50.0):
        rows = play(stream_of(replace(world, imu_hz=imu_hz), 1)).rows
        errors.append(np.sqrt(np.mean(rows.error_v_m_s[rows.t_s > 30.0, :2] ** 2)))
    assert errors[1] < 0.85 * errors[0]


def test_an_accelerometer_bias_is_found():
    ekf = _flying()
    for i in range(1, 2000):
        t = 1.0 + 0.01 * i
        ekf.handle(Attitude(t, LEVEL))
        ekf.handle(ImuSample(t, np.array([0.0, 0.0, -9.80665 + 0.2]), np.zeros(3)))
        if i % 10 == 0:
            ekf.handle(Height(t, 50.0))
    assert ekf.state.x[States.ACCELEROMETER_BIAS][2] == pytest.approx(0.2, abs=0.05)


@pytest.mark.long
def test_nothing_grows_that_should_not_in_a_million_steps():
    """Fourteen hours of barometer and odometry without a fix: what they bound stays bounded."""
    ekf = _flying()
    cov = np.eye(3) * 0.03**2
    for i in range(1, 500_001):
        t = 1.0 + 0.1 * i
        ekf.handle(Attitude(t, LEVEL))
        ekf.handle(Height(t, 50.0))
        ekf.handle(OdometryMotion(1.1, t, np.zeros(3), cov, 0.0, 0.003, 50.0, 99))
    P = ekf.state.P
    assert np.array_equal(P, P.T)
    assert np.linalg.eigvalsh(P)[0] > 0.0
    found = ekf.estimate(t)
    assert np.linalg.norm(found.quat_wxyz) == pytest.approx(1.0, abs=1e-12)
    assert np.hypot(*found.position_ned_m[:2]) < 0.1
    assert found.sigma_horizontal_m < 2.5
    assert np.sqrt(P[3, 3]) < 0.2


@pytest.mark.parametrize(("touching_speed_m_s", "blown_away"), [(1.5, False), (1e-6, True)])
def test_after_the_touch_the_wind_does_not_blow_the_estimate_away(touching_speed_m_s, blown_away):
    """Autopilots tell a landing seconds late, and a level aircraft in wind should drift."""
    ekf = Ekf(EkfConfig(touching_speed_m_s=touching_speed_m_s))
    above = np.array([0.0, 0.0, -20.0])
    ekf.initialise(Start(t_s=0.0, position_ned_m=above, sigma_m=0.5, agl_m=20.0))
    lean = np.array([math.cos(0.04), 0.0, -math.sin(0.04), 0.0])  # 0.8 m/s^2 against the wind
    for k in range(400):
        t_s = 0.05 * k
        down_m = -20.0 + t_s
        ekf.handle(Attitude(t_s, lean))
        ekf.handle(Height(t_s, -down_m))
        place = {"position_ne_m": np.zeros(2), "covariance_ne_m2": 0.25 * np.eye(2)}
        ekf.handle(NedFix(t_s=t_s, agl_m=-down_m, sigma_agl_m=0.1, **place))
    for k in range(60):
        ekf.handle(Attitude(20.0 + 0.05 * k, LEVEL))
        ekf.handle(Height(20.0 + 0.05 * k, -0.1))
    apart_m = np.hypot(*ekf.estimate(23.0).position_ned_m[:2])
    assert (apart_m > 1.5) == blown_away
    assert (apart_m < 0.8) != blown_away


@pytest.mark.parametrize(("touching_s", "is_right"), [(10.0, True), (600.0, False)])
def test_one_that_hovers_just_above_the_ground_may_drift(touching_s, is_right):
    """A pilot's hands, at 0.2 m: it gathers 1.2 m/s, and no landing is told."""
    ekf = Ekf(EkfConfig(touching_s=touching_s))
    ekf.initialise(Start(t_s=0.0, position_ned_m=np.array([0.0, 0.0, -3.0]), agl_m=3.0))
    worst = 0.0
    for k in range(1, 1200):
        t_s = 0.05 * k
        leans = 20.0 < t_s < 32.0
        lean = np.array([math.cos(0.005), 0.0, -math.sin(0.005), 0.0]) if leans else LEVEL
        ekf.handle(Attitude(t_s, lean))
        ekf.handle(Height(t_s, max(3.0 - 0.3 * t_s, 0.2)))
        north_m_s = 0.098 * min(max(t_s - 20.0, 0.0), 12.0)
        found = ekf.estimate(t_s)
        sigma_m_s = math.sqrt(found.covariance[3, 3])
        worst = max(worst, abs(found.velocity_ned_m_s[0] - north_m_s) / sigma_m_s)
    assert (worst < 3.0) == is_right, worst


def test_the_touch_of_one_that_came_down_blind_does_not_make_its_place_any_surer():
    """The ground has stopped it: 50 m of uncertainty had become 38 by that."""
    ekf = Ekf(EkfConfig())
    ekf.initialise(Start(t_s=0.0, position_ned_m=np.array([0.0, 0.0, -6.0]), agl_m=6.0))
    sigmas_m = []
    for k in range(620):
        t_s = 0.05 * k
        ekf.handle(Attitude(t_s, LEVEL))
        ekf.handle(Height(t_s, max(6.0 - 0.2 * t_s, 0.0)))
        sigmas_m.append(ekf.estimate(t_s).sigma_horizontal_m)
    assert sigmas_m[-1] > 20.0
    assert sigmas_m[-1] > 0.95 * max(sigmas_m), (sigmas_m[-1], max(sigmas_m))
    assert np.sqrt(ekf.state.P[3, 3]) < 1.0


@pytest.mark.parametrize(("held", "turned"), [(True, False), (False, True)])
def test_wind_that_takes_hold_at_take_off_does_not_turn_the_heading(monkeypatch, held, turned):
    """Before the first fix only odometry could turn it, and what it sees is the wind."""
    measure = odometry._displacement
    if not held:

        def corrects_heading(*args):
            return replace(measure(*args), considered=())

        monkeypatch.setattr(odometry, "_displacement", corrects_heading)
    windy = FilterWorld(seconds=16.0, wind_m_s=9.0, hover_share=0.0, yaw_bias_deg=0.0, fix_hz=0.01)
    rows = play(stream_of(windy, 0)).rows
    assert (math.degrees(np.max(np.abs(rows.error_yaw_rad))) > 5.0) == turned
    assert (math.degrees(np.max(np.abs(rows.error_yaw_rad))) < 2.0) != turned


def test_a_long_way_without_fixes_is_the_sum_of_its_pieces():
    """What the heading's error does to the place far away, no image's noise may move.

    By the gain whose heading rows alone were zero it moved 5.9 m in 480 m, now 2.4.
    """
    ekf, rng = Ekf(EkfConfig().without_telemetry()), np.random.default_rng(1)
    above = np.array([0.0, 0.0, -50.0])
    ekf.initialise(Start(t_s=0.0, position_ned_m=above, agl_m=50.0, sigma_velocity_m_s=15.0))
    ekf.handle(Attitude(0.0, LEVEL))
    place = {"position_ne_m": np.zeros(2), "covariance_ne_m2": 0.01 * np.eye(2)}
    for t_s in (0.0, 0.01, 0.02):  # found again and again
        ekf.handle(NedFix(t_s=t_s, yaw_rad=0.0, sigma_yaw_rad=0.01, **place))
    sums = {0.0: np.zeros(3)}
    for i in range(1, 601):
        t_s, t0_s = i / 15.0, (i - 1) // 30 * 2.0
        seen = np.array([12.0 * (t_s - t0_s), 0.0, 0.0]) + rng.normal(size=3) * [0.05, 0.05, 0.0]
        cov = 0.05**2 * np.eye(3)
        ekf.handle(Attitude(t_s, LEVEL))
        ekf.handle(OdometryMotion(t0_s, t_s, seen, cov, 0.0, 0.01, 50.0, 99))
        sums[t_s] = sums[t0_s] + seen
    found = ekf.estimate(t_s)
    assert math.sqrt(found.covariance[1, 1]) > 5.0
    assert np.hypot(*(found.position_ned_m - sums[t_s])[:2]) < 3.0


def test_a_wrong_start_is_left_only_when_fixes_agree():
    start = Start(t_s=0.0, position_ned_m=np.array([150.0, 0.0, 0.0]), sigma_m=3.0)
    run = play(stream_of(USUAL, 7), start=start)
    assert np.mean(horizontal(run, 40.0)) < 1.5
    assert run.estimates[-1].reset_counter == 1


def test_an_unknown_start_takes_the_first_fixes():
    run = play(stream_of(USUAL, 8), start=Start(t_s=0.0, position_ned_m=None))
    assert np.mean(horizontal(run)) < 1.5


def test_the_order_of_arrival_does_not_matter():
    stream = stream_of(replace(USUAL, seconds=20.0), 9)
    by_time = sorted(stream.events, key=lambda event: _measured_at(event.seen))
    results = []
    for events in (stream.events, by_time):
        ekf = Ekf(EkfConfig())
        ekf.initialise(Start(t_s=0.0, position_ned_m=np.zeros(3), sigma_m=3.0))
        for event in events:
            ekf.handle(event.seen)
        results.append(ekf.estimate(19.0))
    first, second = results
    assert np.allclose(first.position_ned_m, second.position_ned_m, atol=0.05)


def _measured_at(seen) -> float:
    return seen.t1_s if isinstance(seen, OdometryMotion) else seen.t_s


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
    ekf = Ekf(EkfConfig(map_sigma_m=1e-6))
    ekf.initialise(Start(t_s=0.0, position_ned_m=np.zeros(3), sigma_m=2.0))
    ekf.handle(Attitude(0.0, LEVEL))
    ekf.handle(NedFix(t_s=0.0, position_ne_m=np.array([1.0, 0.0]), covariance_ne_m2=np.eye(2)))
    found = ekf.estimate(0.0)
    gain = 4.0 / (4.0 + 1.0)
    assert found.position_ned_m[0] == pytest.approx(gain, abs=1e-3)
    assert found.covariance[0, 0] == pytest.approx((1.0 - gain) * 4.0, abs=1e-2)


ANY = st.floats(allow_nan=True, allow_infinity=True, width=64)


@settings(max_examples=60)
@example(values=[0.0, 0.0, 0.0, 0.0, 2.7e154, 0.0, 0.0, 0.0], kind=1)  # whose square is no float
@given(values=st.lists(ANY, min_size=8, max_size=8), kind=st.integers(0, 4))
def test_no_measurement_whatever_breaks_it(values, kind):
    ekf = _flying()
    a, b, c, d = (np.array(values[:2]), np.array(values[:3]), values[3], values[4])
    with np.errstate(all="ignore"):
        match kind:
            case 0:
                ekf.handle(NedFix(t_s=c, position_ne_m=a, covariance_ne_m2=np.eye(2) * d))
            case 1:
                ekf.handle(OdometryMotion(c, d, b, np.eye(3), d, c, values[5], 5))
            case 2:
                ekf.handle(Height(c, d))
            case 3:
                ekf.handle(Attitude(c, np.array(values[:4])))
            case 4:
                ekf.handle(Range(c, d))
    found = ekf.estimate(1.2)
    assert np.all(np.isfinite(found.position_ned_m))
    assert np.linalg.eigvalsh(found.covariance)[0] > -1e-9
    assert np.linalg.norm(found.quat_wxyz) == pytest.approx(1.0)


@pytest.mark.parametrize("distance_m", [0.0, -3.0, 1e6, 1e200, np.inf, np.nan])
def test_a_distance_that_cannot_be_is_refused(distance_m):
    assert _flying().handle(Range(1.1, distance_m)).verdict is Verdict.NOT_FINITE


def _flying(config: EkfConfig | None = None) -> Ekf:
    ekf = Ekf(config or EkfConfig())
    start = np.array([0.0, 0.0, -50.0])
    ekf.initialise(Start(t_s=0.0, position_ned_m=start, sigma_m=2.0, agl_m=50.0))
    for i in range(6):
        ekf.handle(Attitude(0.2 * i, LEVEL))
        ekf.handle(Height(0.2 * i, 50.0))
    return ekf
