"""A filter that cannot run away: what it refuses, when it jumps, and how it begins anew."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.bench.estimator.run import play
from vwnav.bench.estimator.streams import MeasurementStream, sense
from vwnav.bench.estimator.world import FilterWorld, fly
from vwnav.estimation.beginning.starts import Start, begun_anew
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.ekf import Ekf
from vwnav.estimation.events import Exposed, NedFix
from vwnav.estimation.inertial.attitudes import yaw_of
from vwnav.estimation.states import States, Verdict
from vwnav.estimation.timeline import Timeline, outside
from vwnav.types import Attitude, Height, OdometryMotion, Stationary

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


def hovering(position_ned_m=(0.0, 0.0, -50.0), seconds: float = 2.0, **config) -> Ekf:
    ekf = Ekf(EkfConfig(**config))
    place = None if position_ned_m is None else np.array(position_ned_m)
    ekf.initialise(Start(t_s=0.0, position_ned_m=place, sigma_m=2.0, agl_m=50.0))
    go_on(ekf, 0.0, seconds, 50.0 if place is not None else 0.0)
    return ekf


def go_on(ekf: Ekf, start_s: float, seconds: float, height_m: float) -> None:
    for i in range(1, round(10 * seconds) + 1):
        ekf.handle(Attitude(start_s + 0.1 * i, LEVEL))
        ekf.handle(Height(start_s + 0.1 * i, height_m))


def fix(t_s: float, north_m: float, sigma_m: float = 0.5) -> NedFix:
    place, covariance = np.array([north_m, 0.0]), sigma_m**2 * np.eye(2)
    return NedFix(t_s=t_s, position_ne_m=place, covariance_ne_m2=covariance)


def flying(speed_m_s: float, sigma_m: float = 1.0) -> Ekf:
    """At the start of a way whose first place is known to a metre, or less well."""
    ekf, place = Ekf(EkfConfig()), np.array([0.0, 0.0, -50.0])
    ekf.handle(Attitude(0.0, LEVEL))
    sigma_m_s = 1.0 + speed_m_s
    start = Start(t_s=0.0, position_ned_m=place, sigma_m=sigma_m, agl_m=50.0)
    ekf.initialise(replace(start, sigma_velocity_m_s=sigma_m_s))
    return ekf


def follow(ekf: Ekf, start_s: float, seconds: float, velocity_ne_m_s: np.ndarray) -> float:
    """Ways five times a second; the time at their end."""
    t_s, way_m = start_s, np.array([*(0.2 * velocity_ne_m_s), 0.0])
    for _ in range(round(5 * seconds)):
        before_s, t_s = t_s, round(t_s + 0.2, 6)
        ekf.handle(Attitude(t_s, LEVEL))
        noise_m2 = 0.03**2 * np.eye(3)
        ekf.handle(OdometryMotion(before_s, t_s, way_m, noise_m2, 0.0, 0.003, 50.0, 99))
        ekf.handle(Height(t_s, 50.0))
    return t_s


def test_the_first_fix_of_an_unknown_place_counts_as_a_reset():
    ekf = hovering(None)
    assert ekf.estimate(2.0).reset_counter == 0
    assert ekf.handle(fix(2.0, 500.0)).verdict is Verdict.RELOCATED
    assert ekf.estimate(2.0).reset_counter == 1


def test_fixes_that_move_the_aircraft_onto_a_hill_bring_the_height_of_their_image_along():
    """A picture older than the history was as high over the ground there as it says."""
    ekf = Ekf(EkfConfig(history_s=0.1), lambda north_m, east_m: 30.0 if north_m > 250.0 else 0.0)
    ekf.initialise(
        Start(t_s=0.0, position_ned_m=np.array([0.0, 0.0, -50.0]), sigma_m=2.0, agl_m=50.0)
    )
    for i in range(20):
        go_on(ekf, 0.5 * i, 0.3, 50.0)
        taken_s = 0.5 * i + 0.3
        ekf.handle(Exposed(taken_s))
        go_on(ekf, taken_s, 0.2, 50.0)
        told = ekf.handle(replace(fix(taken_s, 500.0), agl_m=20.0, sigma_agl_m=0.5))
        if told.verdict is Verdict.RELOCATED:
            break
    assert told.verdict is Verdict.RELOCATED
    assert ekf.state.x[States.EXPOSED_AGL] == pytest.approx(20.0, abs=1.0)
    assert ekf.estimate(taken_s + 0.2).agl_m == pytest.approx(20.0, abs=1.0)


def test_a_correction_by_metres_counts_as_a_reset_and_a_small_one_does_not():
    ekf = hovering()
    ekf.handle(fix(2.0, 1.0))
    assert ekf.estimate(2.0).reset_counter == 0
    ekf = hovering(seconds=20.0)
    ekf.handle(fix(20.0, 8.0))
    ekf.handle(fix(20.1, 8.0))
    assert ekf.estimate(20.1).position_ned_m[0] > 5.0
    assert ekf.estimate(20.1).reset_counter == 1


def broken(ekf: Ekf, index: int, value: float):
    state = ekf.state
    x = state.x.copy()
    x[index] = value
    return state._replace(x=x)


@pytest.mark.parametrize(
    ("index", "value", "why"),
    [
        (States.VELOCITY.start, 40.0, "40 m/s"),
        (States.VELOCITY.start + 2, -30.0, "30 m/s of climb"),
        (States.TILT.start, math.radians(20.0), "20 degrees"),
        (0, math.nan, "not finite"),
    ],
)
def test_a_state_outside_of_the_envelope_begins_anew_at_the_last_trusted_fix(index, value, why):
    ekf, config = hovering(), EkfConfig()
    for t_s in (2.0, 2.1):
        ekf.handle(fix(t_s, 1.0))
    go_on(ekf, 2.1, 4.0, 50.0)
    state = broken(ekf, index, value)
    assert outside(ekf.state, config) is None
    assert why in outside(state, config)
    anew = begun_anew(state, config)
    assert anew.x[0] == pytest.approx(1.0, abs=0.5)
    assert anew.reset_counter == state.reset_counter + 1
    assert math.sqrt(anew.P[0, 0]) > 0.4 * config.most_speed_m_s * 4.0
    assert np.all(anew.x[States.VELOCITY] == 0.0)
    assert anew.x[2] == pytest.approx(-50.0, abs=1.0) or math.isnan(value)
    assert outside(anew, config) is None


def test_a_runaway_is_said_and_counted():
    said: list[str] = []
    ekf = hovering(seconds=1.0, most_speed_m_s=2.0)
    ekf.on_event(said.append)
    lean = np.array([math.cos(0.2), 0.0, -math.sin(0.2), 0.0])  # 4 m/s^2 by its thrust
    for i in range(1, 100):
        ekf.handle(Attitude(1.0 + 0.02 * i, lean))
        ekf.handle(Height(1.0 + 0.02 * i, 50.0))
    assert said
    assert "left its envelope" in said[0]
    found = ekf.estimate(3.0)
    assert found.reset_counter >= 1
    assert len(said) == 1  # not again and again
    assert np.hypot(*found.velocity_ned_m_s[:2]) < 2.5


def stream_of(world: FilterWorld, seed: int) -> MeasurementStream:
    rng = np.random.default_rng(seed)
    return sense(world, fly(world, [rng])[0], rng)


@pytest.mark.parametrize("imu_hz", [0.0, 50.0])
def test_pressure_wrong_for_most_of_a_second_does_not_move_the_height_with_it(imu_hz):
    """6 m for 0.7 s: it was followed by all of it, at a climb of 9.4 m/s."""
    stream = stream_of(FilterWorld(seconds=30.0, imu_hz=imu_hz), 2)
    events = [
        replace(event, seen=Height(event.seen.t_s, event.seen.height_m + 6.0))
        if isinstance(event.seen, Height) and 20.0 < event.seen.t_s < 20.7
        else event
        for event in stream.events
    ]
    run, undisturbed = play(replace(stream, events=events)), play(stream)
    moved_m = [
        a.position_ned_m[2] - b.position_ned_m[2]
        for a, b in zip(run.estimates, undisturbed.estimates, strict=True)
    ]
    assert np.max(np.abs(moved_m)) < 1.0
    assert max(abs(e.velocity_ned_m_s[2]) for e in run.estimates if e.t_s > 19.0) < 2.0


def test_one_sudden_fix_that_nothing_confirms_is_believed_no_further_than_wrong_ones_err():
    ekf = hovering(None, time_offset_sigma_s=0.01)  # at 14 m/s one of 80 ms is a metre
    ekf.handle(fix(2.0, 0.0))
    for i in range(1, 11):
        ekf.handle(Attitude(2.0 + i, LEVEL))  # seconds apart: nothing tells how it flies
        ekf.handle(Height(2.0 + i, 0.0))
    wide = ekf.estimate(12.0)
    assert wide.sigma_horizontal_m > 60.0
    assert ekf.handle(fix(12.0, 100.0)).verdict is Verdict.UNCONFIRMED
    lone = ekf.estimate(12.0)
    assert 20.0 < lone.sigma_horizontal_m < 45.0
    for t_s in (12.05, 12.1, 12.15, 12.2):
        ekf.handle(Height(t_s, 0.0))
        ekf.handle(Attitude(t_s, LEVEL))
    assert ekf.handle(fix(12.2, 100.0)).accepted
    assert ekf.estimate(12.2).sigma_horizontal_m < 2.0


def test_two_wrong_fixes_that_are_minutes_apart_do_not_agree_by_chance():
    """Of an unsure place: 49 m lay between them, and the second was believed to 1.6 m."""
    ekf, t_s = flying(0.0, sigma_m=100.0), 0.0
    for place_ne_m in ([150.0, 0.0], [105.0, 20.0]):
        t_s = follow(ekf, t_s, 40.0, np.zeros(2))
        wrong = replace(fix(t_s, 0.0), position_ne_m=np.array(place_ne_m))
        assert ekf.handle(wrong).verdict is Verdict.UNCONFIRMED
    assert ekf.estimate(t_s).sigma_horizontal_m > 20.0


@pytest.mark.parametrize("off_m", [-30.0, 20.0, 40.0])
@pytest.mark.parametrize("course_rad", [0.0, 0.7, 2.0])
def test_a_place_that_is_open_to_one_side_is_not_open_to_a_pull_along_the_way(off_m, course_rad):
    """A way of 120 m by compass: two that lay ahead alike were believed, and the height with them.

    That was a third off, at 14 sigmas of the place half a minute later, and right ones refused.
    """
    ahead = np.array([math.cos(course_rad), math.sin(course_rad)])
    ekf = flying(8.0)
    follow(ekf, 0.0, 15.0, 8.0 * ahead)
    for n in range(76, 82):
        t_s = follow(ekf, round(0.2 * n - 0.2, 6), 0.2, 8.0 * ahead)
        wrong_m = (8.0 * t_s + off_m) * ahead
        ekf.handle(replace(fix(t_s, 0.0), position_ne_m=wrong_m))
    estimate = ekf.estimate(t_s)
    off = float((estimate.position_ned_m[:2] - 8.0 * t_s * ahead) @ ahead)
    assert abs(off) < 5.0 * math.sqrt(ahead @ estimate.covariance[:2, :2] @ ahead)
    assert estimate.agl_m == pytest.approx(50.0, abs=3.0)


@pytest.mark.parametrize("apart_s", [2.0, 3.0, 8.0])
def test_fixes_that_are_refused_and_agree_are_believed_however_slowly_they_are_found(apart_s):
    """Twelve had to agree within 30 s: found every 3 s they were refused for good."""
    ekf, t_s, accepted = flying(0.0), 0.0, []
    for _ in range(16):
        t_s = follow(ekf, t_s, apart_s, np.zeros(2))
        accepted.append(ekf.handle(fix(t_s, 40.0)).accepted)
    assert not any(accepted[:11])
    assert all(accepted[11:])
    assert ekf.estimate(t_s).position_ned_m[0] == pytest.approx(40.0, abs=1.0)


@given(
    st.floats(-38.0, 38.0), st.floats(0.0, 10.0), st.floats(-math.pi, math.pi), st.integers(1, 15)
)
def test_a_first_fix_of_ground_that_looks_alike_is_left_at_the_second_right_one(
    turned_deg, aside_m, bearing_rad, quiet
):
    """Turned by 17 degrees it was believed for 10 s, as right ones were refused."""
    ekf, t_s = Ekf(EkfConfig()), 2.0
    above = np.array([0.0, 0.0, -50.0])
    ekf.initialise(Start(t_s=0.0, position_ned_m=above, sigma_m=5.0, agl_m=50.0))
    go_on(ekf, 0.0, t_s, 50.0)
    aside = aside_m * np.array([math.cos(bearing_rad), math.sin(bearing_rad)])
    wrong = aside, math.radians(turned_deg), 1
    for place, turned_rad, count in (wrong, (np.zeros(2), 0.0, 2)):
        for _ in range(count):
            told = NedFix(
                t_s=t_s, position_ne_m=place, covariance_ne_m2=0.5**2 * np.eye(2),
                yaw_rad=turned_rad, sigma_yaw_rad=0.012,
            )  # fmt: skip
            ekf.handle(told)
            estimate = ekf.estimate(t_s)
            off_m, P = estimate.position_ned_m[:2], estimate.covariance[:2, :2]
            assert off_m @ np.linalg.solve(P, off_m) < 5.0**2
            yaw_rad = yaw_of(estimate.quat_wxyz)
            assert abs(yaw_rad) < 5.0 * estimate.sigma_yaw_rad
            go_on(ekf, t_s, 0.1 * quiet, 50.0)
            t_s += 0.1 * quiet
    assert np.hypot(*off_m) < 1.5
    assert abs(yaw_rad) < math.radians(3.0)


def test_who_stands_comes_to_rest_whatever_was_believed_in_the_landing():
    ekf = hovering((0.0, 0.0, -0.3))
    state = broken(ekf, States.VELOCITY.start, 4.0)
    P = state.P.copy()
    P[3:6, 3:6] = 0.04 * np.eye(3)
    ekf._timeline = Timeline(state._replace(P=P), ekf._context)
    for i in range(1, 20):
        ekf.handle(Attitude(2.0 + 0.05 * i, LEVEL))
        ekf.handle(Stationary(2.0 + 0.05 * i))
    assert np.hypot(*ekf.estimate(3.0).velocity_ned_m_s[:2]) < 0.1


def standing(seconds: float = 2.0) -> Ekf:
    """An aircraft that stands for so long, and then nothing is heard of it."""
    ekf = hovering((0.0, 0.0, 0.0), seconds=0.1)
    for i in range(1, round(10.0 * seconds) + 1):
        ekf.handle(Attitude(0.1 * i, LEVEL))
        ekf.handle(Height(0.1 * i, 0.0))
        ekf.handle(Stationary(0.1 * i))
    return ekf


@given(st.floats(0.0, 0.99))
def test_who_stood_still_stands_in_a_second_of_silence(silence_s):
    found = standing().estimate(2.0 + silence_s)
    assert np.sqrt(np.diag(found.covariance)[3:].max()) < 1.5


def test_a_longer_silence_may_have_been_a_take_off():
    found = standing().estimate(4.0)
    assert np.sqrt(np.diag(found.covariance)[3:].max()) > 4.0


def test_who_flew_a_moment_ago_is_not_known_to_stand():
    ekf = hovering()
    sigmas = np.sqrt(np.diag(ekf.estimate(3.0).covariance))
    assert sigmas[3:].max() > 4.0


def test_ways_from_a_forgotten_keyframe_are_told_from_image_to_image():
    """A hovering aircraft's keyframe stays for minutes; the filter has begun anew meanwhile."""
    ekf, told = hovering(seconds=4.0), []
    for i in range(1, 30):
        t_s = 4.0 + i / 15.0
        ekf.handle(Attitude(t_s, LEVEL))
        ekf.handle(Height(t_s, 50.0))
        way = np.array([2.0 * (t_s - 4.0), 0.0, 0.0])
        motion = OdometryMotion(0.5, t_s, way, 0.01**2 * np.eye(3), 0.0, 0.01, 50.0, 99)
        told.append(ekf.handle(motion).verdict)
    assert told[0] is Verdict.NO_ANCHOR
    assert told.count(Verdict.FUSED) > 20
    assert ekf.estimate(t_s).velocity_ned_m_s[0] == pytest.approx(2.0, abs=0.2)
