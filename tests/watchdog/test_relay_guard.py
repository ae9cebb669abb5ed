"""What the watchdog hands on of the navigator's estimates."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.watchdog.relay_guard import (
    RelayedPosition,
    RelayedVelocity,
    RelayGuard,
    RelayLimits,
)

LIMITS = RelayLimits()
DT_S = 0.02


def at(t_s: float, north_m: float = 0.0, counter: int = 0, sigma_m: float = 0.5) -> RelayedPosition:
    return RelayedPosition(t_s, (north_m, 0.0, -50.0), sigma_m, counter)


def flying(speed_m_s: float = 0.0) -> RelayGuard:
    """One second of flight."""
    guard = RelayGuard()
    assert guard.admit_position(at(0.0), 0.0, armed=False)
    assert all(feed(guard, DT_S, 1.0, lambda t: at(t, speed_m_s * t)))
    return guard


def feed(guard: RelayGuard, start_s: float, end_s: float, make=at) -> list[bool]:
    steps = range(round(start_s / DT_S), round(end_s / DT_S))
    return [guard.admit_position(make(i * DT_S), i * DT_S, armed=True) for i in steps]


@pytest.mark.parametrize("bad", [at(1.0, math.nan), at(1.0, 8.0), at(1.0, 0.0, 1, 30.0)])
def test_a_position_that_cannot_be_is_held_back_and_all_after_it(bad):
    guard = flying()
    assert not guard.admit_position(bad, 1.0, armed=True)
    assert not any(feed(guard, 1.02, 9.0))


def test_one_that_jumps_on_and_on_is_held_back_though_it_says_so():
    passed = feed(flying(), 1.0, 9.0, lambda t: at(t, 5.0 * round(t / 0.1), round(t / 0.1)))
    assert sum(passed) <= 6


def test_a_faster_aircraft_than_there_is_is_held_back():
    assert not feed(flying(30.0), 1.0, 2.0, lambda t: at(t, 30.0 + (t - 1.0) * 60.0))[-1]


def test_after_a_sleep_of_20_s_the_extrapolated_position_is_not_handed_on():
    guard = flying(8.0)
    assert not any(feed(guard, 21.0, 60.0, lambda t: at(t, 8.0 * t)))
    assert not any(feed(flying(), 21.0, 60.0))


def test_after_a_sleep_a_new_estimate_passes_once_it_is_steady():
    passed = feed(flying(8.0), 21.0, 23.0, lambda t: at(t, 3.0, counter=1))
    assert passed.index(True) * DT_S == pytest.approx(LIMITS.steady_s, abs=0.03)
    assert all(passed[passed.index(True) :])


def test_after_a_sleep_one_that_wanders_or_is_unsure_does_not_pass_though_it_calls_itself_new():
    assert not any(feed(flying(), 21.0, 25.0, lambda t: at(t, 5.0 * round(t / 0.2), counter=1)))
    assert not any(feed(flying(), 21.0, 25.0, lambda t: at(t, 0.0, counter=1, sigma_m=20.0)))


def feed_both(guard: RelayGuard, start_s: float, end_s: float, **told: float) -> list[bool]:
    """Positions at 8 m/s, 40 m wide, with a velocity."""
    speed_m_s, sigma_m_s = told.get("speed_m_s", 8.0), told.get("sigma_m_s", 0.5)
    steps = range(round(start_s / DT_S), round(end_s / DT_S))
    return [
        guard.admit_both(
            at(t_s, 8.0 * t_s, int(told.get("counter", 1)), told.get("sigma_m", 40.0)),
            RelayedVelocity(t_s, (speed_m_s, 0.0, 0.0), sigma_m_s), t_s, armed=True,
        )
        for t_s in (i * DT_S for i in steps)
    ]  # fmt: skip


def test_after_a_sleep_a_new_one_whose_place_is_unsure_passes_with_a_velocity():
    passed = feed_both(flying(8.0), 21.0, 23.0)
    assert passed.index(True) * DT_S == pytest.approx(LIMITS.steady_s, abs=0.03)
    assert all(passed[passed.index(True) :])


def test_what_passes_with_an_unsure_place_may_be_renewed_with_one_without_a_gap():
    guard = flying(8.0)
    feed_both(guard, 21.0, 23.0)
    assert all(feed_both(guard, 23.0, 25.0, counter=2))
    assert not any(feed_both(guard, 25.0, 25.2, counter=3, sigma_m_s=3.0))


def test_one_whose_place_was_sure_is_not_renewed_with_an_unsure_one_at_once():
    guard = flying(8.0)
    now_s = 1.0
    assert feed_both(guard, now_s, now_s + 0.2, counter=0, sigma_m=1.0)[-1]
    assert not any(feed_both(guard, now_s + 0.2, now_s + 0.4))


@pytest.mark.parametrize(
    "told",
    [
        {"sigma_m": 80.0},
        {"sigma_m_s": 3.0},
        {"sigma_m_s": math.nan},
        {"speed_m_s": 1.0},  # its positions move at 8 m/s
        {"speed_m_s": 50.0},
        {"speed_m_s": math.nan},
    ],
)
def test_one_whose_velocity_is_unsure_or_not_that_of_its_positions_does_not_pass(told):
    assert not any(feed_both(flying(8.0), 21.0, 29.0, **told))


def test_an_impossible_velocity_stops_the_position_that_comes_with_it():
    guard = flying(8.0)
    fast = RelayedVelocity(1.0, (50.0, 0.0, 0.0), 0.3)
    assert not guard.admit_both(at(1.0, 8.0), fast, 1.0, armed=True)
    assert "50 m/s" in guard.reason


def test_a_short_stall_goes_on_where_it_should_be_and_not_elsewhere():
    passed = feed(flying(8.0), 2.2, 4.0, lambda t: at(t, 8.0 * t))
    assert passed.index(True) * DT_S == pytest.approx(LIMITS.steady_s, abs=0.03)
    assert not any(feed(flying(8.0), 2.2, 9.0, lambda t: at(t, 30.0)))


def test_an_old_one_is_left_out_alone():
    guard = flying()
    assert not guard.admit_position(at(1.0), 1.4, armed=True)
    assert guard.admit_position(at(1.4), 1.4, armed=True)


def test_speeds_pass_with_the_positions_and_an_impossible_one_stops_both():
    guard = flying()
    assert guard.admit_velocity(RelayedVelocity(1.0, (8.0, 0.0, 0.0), 0.3), 1.0)
    assert not guard.admit_velocity(RelayedVelocity(0.5, (8.0, 0.0, 0.0), 0.3), 1.0)
    assert not guard.admit_velocity(RelayedVelocity(1.0, (50.0, 0.0, 0.0), 0.3), 1.0)
    assert not guard.admit_position(at(1.0), 1.0, armed=True)
    assert not guard.admit_velocity(RelayedVelocity(1.1, (1.0, 0.0, 0.0), 0.3), 1.1)


def test_on_the_ground_it_may_jump():
    guard = flying()
    assert guard.admit_position(at(1.0, 500.0), 1.0, armed=False)
    assert guard.admit_position(at(1.02, 500.0), 1.02, armed=True)


def test_the_first_one_in_the_air_has_to_be_steady_too():
    passed = feed(RelayGuard(), 0.0, 2.0)
    assert passed.index(True) * DT_S == pytest.approx(LIMITS.steady_s, abs=0.03)


STEP = st.tuples(
    st.sampled_from([0.02, 0.02, 0.02, 0.1, 0.3, 0.7, 1.5, 5.0]),  # wait
    st.sampled_from([0.0, 0.0, 0.0, 0.2, 1.0, -1.0, math.nan]),  # age
    st.floats(-5.0, 5.0) | st.floats(-1e4, 1e4) | st.just(math.nan),  # north
    st.sampled_from([0, 0, 0, 0, 1]),  # reset
    st.sampled_from([0.5, 0.5, 20.0, math.nan]),  # sigma
)


@given(st.lists(STEP, max_size=80))
def test_whatever_comes_nothing_is_handed_on_that_cannot_be(steps):
    guard, t_s, counter, last = flying(), 1.0, 0, at(0.98)
    for wait_s, age_s, north_m, reset, sigma_m in steps:
        t_s, counter = t_s + wait_s, counter + reset
        position = at(t_s - age_s, north_m, counter, sigma_m)
        if not guard.admit_position(position, t_s, armed=True):
            continue
        span_s = position.t_s - last.t_s
        assert abs(t_s - position.t_s) <= LIMITS.max_age_s
        if counter == last.reset_counter:
            moved_m = abs(north_m - last.position_ned_m[0])
            assert moved_m <= LIMITS.max_speed_m_s * span_s + LIMITS.max_jump_m + 1e-9
            assert 0.0 <= span_s <= LIMITS.brief_gap_s + LIMITS.steady_s + 1.0
        else:
            assert sigma_m <= LIMITS.new_position_sigma_m
        last = position
