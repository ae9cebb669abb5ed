"""Nothing is sent to an autopilot that we would not fly on, and what was lost comes back as new."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.safety.estimate_guard import EstimateGuard
from vwnav.safety.safety_config import EstimateLimits
from vwnav.types import Estimate

LIMITS = EstimateLimits()
DT_S = 0.02
GOOD = Estimate(
    t_s=0.0,
    position_ned_m=np.zeros(3),
    velocity_ned_m_s=np.zeros(3),
    covariance=np.eye(6) * 0.1,
    quat_wxyz=np.array([1.0, 0.0, 0.0, 0.0]),
    sigma_yaw_rad=0.1,
    agl_m=50.0,
    sigma_agl_m=1.0,
    t_last_fix_s=0.0,
    reset_counter=0,
)


def at(t_s: float, north_m: float = 0.0, speed_m_s: float = 0.0, **changes) -> Estimate:
    position, velocity = np.array([north_m, 0.0, -50.0]), np.array([speed_m_s, 0.0, 0.0])
    return replace(GOOD, t_s=t_s, position_ned_m=position, velocity_ned_m_s=velocity, **changes)


def covariance(sigma_m: float = 0.3, sigma_m_s: float = 0.3) -> np.ndarray:
    return np.diag([sigma_m**2] * 3 + [sigma_m_s**2] * 3)


def flying(speed_m_s: float = 0.0) -> EstimateGuard:
    """It has sent one estimate, at 0 s."""
    guard = EstimateGuard()
    assert guard.admit(at(0.0, 0.0, speed_m_s), 0.0, armed=False) is not None
    return guard


def feed(guard: EstimateGuard, start_s: float, end_s: float, make=at) -> list[Estimate]:
    steps = range(round(start_s / DT_S), round(end_s / DT_S))
    sent = (guard.admit(make(i * DT_S), i * DT_S) for i in steps)
    return [e for e in sent if e is not None]


def test_a_good_estimate_is_sent_as_it_is():
    guard = flying(8.0)
    sent = feed(guard, DT_S, 2.0, lambda t: at(t, 8.0 * t, 8.0))
    assert len(sent) == 99
    assert {e.reset_counter for e in sent} == {0}
    assert guard.lost_since_s is None


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (at(0.1, math.nan), "finite"),
        (at(0.1, 0.0, 40.0), "40 m/s"),
        (at(0.1, covariance=covariance(sigma_m_s=5.0)), "velocity is lost"),
        (at(0.1, covariance=covariance(sigma_m=70.0)), "uncertain by 70 m"),
        (at(0.1, covariance=-covariance()), "velocity is lost"),
        (at(0.1, quat_wxyz=np.array([0.5, 0.866, 0.0, 0.0])), "tilted"),
        (at(0.1, quat_wxyz=np.zeros(4)), "tilted"),
        (at(0.1, 8.0), "jumped"),
        (at(0.1, 0.0, 6.0), "velocity jumped"),
        (at(0.1, 500.0, reset_counter=1, covariance=covariance(20.0)), "uncertain by 20 m"),
    ],
)
def test_one_that_we_would_not_fly_on_is_not_sent(bad, reason):
    guard = flying()
    assert guard.admit(bad, 0.1) is None
    assert guard.lost_since_s == 0.1
    assert reason in guard.reason


def test_a_jump_that_the_filter_announces_is_sent_when_it_is_sure():
    sent = flying().admit(at(0.1, 500.0, reset_counter=1), 0.1)
    assert sent is not None
    assert sent.reset_counter == 1


def test_one_that_jumps_on_and_on_is_lost_though_it_says_so():
    def restless(t_s: float) -> Estimate:
        return at(t_s, 5.0 * round(t_s / 0.1), reset_counter=round(t_s / 0.1))

    assert len({e.reset_counter for e in feed(flying(), DT_S, 9.0, restless)}) <= 2


@pytest.mark.parametrize(
    ("north_m", "sigma_m", "back_s"), [(4.0, 1.5, 1.5), (4.0, 3.0, None), (9.0, 1.5, None)]
)
def test_one_that_settles_within_what_it_had_said_is_back_without_a_fix(north_m, sigma_m, back_s):
    """Two jumps of 4 m in 0.7 s, of 4 m known to 3: no fix came, and it came down blind, 73 m."""

    def make(t_s: float) -> Estimate:
        jumps = int(t_s >= 1.0) + int(t_s >= 1.7)
        sigmas = covariance(sigma_m if jumps == 2 else 3.0 if jumps else 4.5, 0.2)
        told_m = 5.0 + north_m if jumps == 2 else 5.0 * jumps
        return at(t_s, told_m, reset_counter=jumps, covariance=sigmas)

    guard = flying()
    looks = (guard.admit(make(DT_S * i), DT_S * i, seen_s=DT_S * i) for i in range(1, 300))
    sent = [e for e in looks if e is not None]
    late = [e.t_s for e in sent if e.t_s > 1.7]
    assert (late[0] - 1.7 if late else None) == (back_s and pytest.approx(back_s, abs=0.1))
    assert len({e.reset_counter for e in sent}) == (3 if late else 2)


def test_small_corrections_pass_but_many_of_them_in_a_second_do_not():
    assert len(feed(flying(), DT_S, 1.0, lambda t: at(t, 2.0 * (t > 0.5)))) == 49
    guard = flying()
    feed(guard, DT_S, 1.0, lambda t: at(t, 2.0 * t / DT_S))
    assert "jumped" in guard.reason


def test_an_estimate_that_is_late_is_left_out_and_one_that_stays_late_is_lost():
    guard = flying()
    assert guard.admit(at(0.1), 0.4) is None
    assert guard.lost_since_s is None
    assert guard.admit(at(0.4), 0.4) is not None
    assert guard.admit(None, 0.9) is None
    assert guard.admit(at(1.0), 1.5) is None
    assert guard.lost_since_s == 1.5


def lost_at_1_s() -> EstimateGuard:
    guard = flying()
    feed(guard, DT_S, 1.0)
    assert guard.admit(at(1.0, 0.0, 50.0), 1.0) is None
    return guard


def fixes_every(period_s: float, offset_s: float = 0.0):
    def make(t_s: float, **changes) -> Estimate:
        t_fix_s = offset_s + period_s * math.floor((t_s - offset_s) / period_s)
        return at(t_s, t_last_fix_s=t_fix_s, **changes)

    return make


def test_a_lost_estimate_is_not_back_because_it_looks_good():
    assert feed(lost_at_1_s(), 1.02, 30.0) == []


def test_it_comes_back_as_a_new_one_after_three_fixes_over_a_second():
    guard = lost_at_1_s()
    sent = feed(guard, 1.02, 5.0, fixes_every(0.5, 1.1))
    assert sent[0].t_s == pytest.approx(2.1, abs=0.03)  # fixes of 1.1, 1.6 and 2.1 s
    assert {e.reset_counter for e in sent} == {1}
    assert guard.lost_since_s is None


def test_fixes_from_before_the_loss_or_in_a_burst_do_not_count():
    assert feed(lost_at_1_s(), 1.02, 5.0, lambda t: at(t, t_last_fix_s=0.5 + 0.1 * t)) == []
    burst = feed(lost_at_1_s(), 1.02, 9.0, lambda t: at(t, t_last_fix_s=min(t, 1.4)))
    assert burst == []


def test_it_does_not_come_back_while_it_is_unsure():
    unsure = {"covariance": covariance(sigma_m=6.0)}
    make = fixes_every(0.5)
    assert feed(lost_at_1_s(), 1.02, 9.0, lambda t: make(t, **unsure)) == []


def test_fixes_that_contradict_each_other_begin_the_count_again():
    def make(t_s: float) -> Estimate:
        return at(t_s, 20.0 * math.floor(t_s / 0.8), t_last_fix_s=0.4 * math.floor(t_s / 0.4))

    assert feed(lost_at_1_s(), 1.02, 9.0, make) == []


def test_after_a_long_sleep_nothing_is_sent_at_once():
    guard = flying(8.0)
    feed(guard, DT_S, 1.0, lambda t: at(t, 8.0 * t, 8.0))
    extrapolated = feed(guard, 21.0, 40.0, lambda t: at(t, 8.0 * t, 8.0))
    assert extrapolated == []
    assert "no estimate for 20.0 s" in guard.reason


@pytest.mark.parametrize("gap_s", [0.6, 0.9])
def test_after_a_short_stall_it_goes_on_once_it_is_steady_where_it_should_be(gap_s):
    guard = flying(8.0)
    feed(guard, DT_S, 1.0, lambda t: at(t, 8.0 * t, 8.0))
    sent = feed(guard, 1.0 + gap_s, 4.0, lambda t: at(t, 8.0 * t, 8.0))
    assert sent[0].t_s == pytest.approx(1.0 + gap_s + 0.5, abs=0.05)
    assert {e.reset_counter for e in sent} == {0}


def test_after_a_short_stall_it_does_not_go_on_elsewhere():
    guard = flying()
    feed(guard, DT_S, 1.0)
    assert feed(guard, 1.8, 9.0, lambda t: at(t, 7.0)) == []


def wide(t_s: float, sigma_m: float = 40.0, sigma_m_s: float = 0.5) -> Estimate:
    """On its way at 8 m/s, with no fix since the start."""
    return at(t_s, 8.0 * t_s, 8.0, covariance=covariance(sigma_m, sigma_m_s))


def feed_seeing(
    guard: EstimateGuard,
    start_s: float,
    end_s: float,
    make,
    late_s: float = 0.1,
    looked_at_s: float = 0.5,
) -> list[Estimate]:
    """Every image tells a motion, 0.1 s later; the watchdog looks at a new one for a while."""
    sent: list[Estimate] = []
    for i in range(round(start_s / DT_S), round(end_s / DT_S)):
        t_s = i * DT_S
        guard.follow_relay(bool(sent) and t_s - sent[0].t_s > looked_at_s, t_s)
        estimate = guard.admit(make(t_s), t_s, True, t_s - late_s)
        if estimate is not None:
            sent.append(estimate)
    return sent


def after_a_gap() -> EstimateGuard:
    guard = flying(8.0)
    feed(guard, DT_S, 1.0, lambda t: at(t, 8.0 * t, 8.0))
    guard.miss("the autopilot is not heard", 1.0)
    return guard


@pytest.mark.parametrize("sigma_m", [50.0, 2.0])
def test_after_a_gap_it_comes_back_with_a_sure_velocity_and_a_place_that_is_told_as_unproven(
    sigma_m,
):
    sent = feed_seeing(after_a_gap(), 10.0, 13.0, lambda t: wide(t, sigma_m))
    assert sent[0].t_s == pytest.approx(10.0 + LIMITS.unproven_s, abs=0.03)
    assert {e.reset_counter for e in sent} == {1}
    told_m = max(sigma_m, LIMITS.unproven_sigma_m)
    assert [e.sigma_horizontal_m for e in sent] == pytest.approx([told_m] * len(sent))
    assert {e.covariance[3, 3] for e in sent} == {0.25}


def test_fixes_that_come_later_make_it_a_sure_one_which_is_new_again():
    def make(t_s: float) -> Estimate:
        seen_s = 0.5 * math.floor(t_s / 0.5)
        return replace(wide(t_s, 2.0), t_last_fix_s=seen_s if t_s > 12.0 else 0.0)

    sent = feed_seeing(after_a_gap(), 10.0, 15.0, make)
    (first,) = [b for a, b in pairwise(sent) if a.reset_counter != b.reset_counter]
    assert first.t_s == pytest.approx(13.0, abs=0.03)  # fixes of 12.0, 12.5 and 13.0 s
    assert first.sigma_horizontal_m == pytest.approx(2.0)
    assert {e.reset_counter for e in sent} == {1, 2}


@pytest.mark.parametrize("looked_at_s", [0.1, 0.5, 0.9])
def test_the_autopilot_has_had_a_second_of_it_before_it_is_new_again(looked_at_s):
    """However long the watchdog looks at it first: half a second was assumed, and it was 0.74."""

    def make(t_s: float) -> Estimate:
        seen_s = 11.2 + 0.4 * math.floor((t_s - 11.2) / 0.4) if t_s >= 11.2 else 0.0
        return replace(wide(t_s, 2.0), reset_counter=1, t_last_fix_s=seen_s)

    sent = feed_seeing(after_a_gap(), 10.0, 15.0, make, looked_at_s=looked_at_s)
    (again,) = [b for a, b in pairwise(sent) if a.reset_counter != b.reset_counter]
    least_s = looked_at_s + LIMITS.steady_s
    assert again.t_s - sent[0].t_s == pytest.approx(least_s, abs=0.03)


def test_a_jump_of_an_unproven_one_stays_unproven():
    def make(t_s: float) -> Estimate:
        found = {"reset_counter": 1, "t_last_fix_s": 13.5} if t_s >= 13.5 else {}
        return replace(
            wide(t_s, 2.0), position_ned_m=np.array([8.0 * t_s, 9.0 * bool(found), -50.0]), **found
        )

    sent = feed_seeing(after_a_gap(), 10.0, 16.0, make)
    assert {e.reset_counter for e in sent} == {1, 2}
    assert min(e.sigma_horizontal_m for e in sent) == pytest.approx(LIMITS.unproven_sigma_m)
    assert sent[-1].t_s > 15.9


@pytest.mark.parametrize(
    "make",
    [
        lambda t: wide(t, sigma_m_s=2.0),
        lambda t: wide(t, sigma_m=65.0),
        lambda t: wide(t, sigma_m_s=2.0 if round(t / DT_S) % 40 == 0 else 0.5),
        lambda t: replace(wide(t), velocity_ned_m_s=np.array([6.0 * (t % 1.0 > 0.5), 0.0, 0.0])),
    ],
)
def test_after_a_gap_it_does_not_come_back_without_a_steady_velocity_or_from_anywhere(make):
    assert feed_seeing(after_a_gap(), 10.0, 19.0, make) == []


def test_a_fix_right_after_it_came_back_is_waited_for_and_told_a_second_later_at_the_earliest():
    def make(t_s: float) -> Estimate:
        found = {"reset_counter": 1, "t_last_fix_s": 12.0} if t_s >= 12.0 else {}
        place = np.array([8.0 * t_s, 9.0 * bool(found), -50.0])
        return replace(wide(t_s, 2.0), position_ned_m=place, **found)

    sent = feed_seeing(after_a_gap(), 10.0, 16.0, make)
    changes = [b for a, b in pairwise(sent) if a.reset_counter != b.reset_counter]
    assert [e.t_s for e in changes] == pytest.approx([13.5], abs=0.15)
    assert sent[-1].t_s > 15.9
    assert min(e.sigma_horizontal_m for e in sent) == pytest.approx(LIMITS.unproven_sigma_m)


def test_after_a_brief_gap_an_unproven_one_goes_on_as_unproven():
    guard = after_a_gap()
    assert feed_seeing(guard, 10.0, 12.0, lambda t: wide(t, 2.0))
    sent = feed_seeing(guard, 12.8, 15.0, lambda t: wide(t, 2.0))
    assert {e.reset_counter for e in sent} == {1}
    assert min(e.sigma_horizontal_m for e in sent) == pytest.approx(LIMITS.unproven_sigma_m)


def test_what_no_image_shows_is_made_up_and_does_not_come_back():
    assert feed(after_a_gap(), 10.0, 19.0, wide) == []
    assert feed_seeing(after_a_gap(), 10.0, 19.0, wide, late_s=0.6) == []
    guard = after_a_gap()
    assert [guard.admit(wide(t_s), t_s, True, 0.9) for t_s in (1.1, 1.2, 1.3)] == [None] * 3


@pytest.mark.parametrize(
    ("off_m", "fix_s", "told_m"),
    [(5.0, 0.0, 20.0), (25.0, 0.0, None), (5.0, 2.0, LIMITS.unproven_sigma_m), (25.0, 2.0, None)],
)
def test_a_blind_one_may_correct_itself_inside_of_what_it_said_and_by_a_fix_as_unproven(
    off_m, fix_s, told_m
):
    """Twenty metres unsure: what the air tells of its velocity moves its place by metres.

    So does a first fix after a while. As long as that ended what was sent, an aircraft that landed
    blind was told nothing from its first fix on, and came down 202 m off.
    """

    def make(t_s: float) -> Estimate:
        moved = t_s >= 2.0
        place = np.array([8.0 * t_s, off_m * moved, -50.0])
        fixed = {"reset_counter": int(moved), "t_last_fix_s": fix_s if moved else 0.0}
        return replace(wide(t_s, 20.0, 1.0), position_ned_m=place, **fixed)

    guard = flying(8.0)
    sent = feed(guard, DT_S, 4.0, make)
    assert (sent[-1].t_s > 3.9) is (told_m is not None)
    assert {e.reset_counter for e in sent} == ({0} if told_m is None else {0, 1})
    if told_m is not None:
        assert sent[-1].sigma_horizontal_m == pytest.approx(told_m)


@pytest.mark.parametrize("seen_s", [None, 0.9])
def test_a_velocity_that_was_unknown_and_is_sure_again_has_been_felt_if_not_seen(seen_s):
    def admitted(start_s: float, end_s: float, sigma_m_s: float) -> list[Estimate]:
        steps = [i * DT_S for i in range(round(start_s / DT_S), round(end_s / DT_S))]
        sent = (guard.admit(wide(t_s, 5.0, sigma_m_s), t_s, True, seen_s) for t_s in steps)
        return [e for e in sent if e is not None]

    guard = after_a_gap()
    assert admitted(10.0, 12.0, 5.0) == []
    sent = admitted(12.0, 20.0, 1.0)
    assert sent[0].t_s == pytest.approx(12.0 + LIMITS.unproven_s, abs=0.03)
    assert sent[-1].t_s > 19.9
    assert min(e.sigma_horizontal_m for e in sent) == pytest.approx(LIMITS.unproven_sigma_m)
    guard.miss("the autopilot is not heard", 20.0)
    assert admitted(22.0, 30.0, 1.0) == []


def test_what_was_wrong_with_it_is_no_gap():
    guard = lost_at_1_s()
    assert feed_seeing(guard, 1.02, 9.0, wide) == []
    guard = after_a_gap()
    assert guard.admit(at(9.98, 0.0, 50.0), 9.98) is None
    assert feed_seeing(guard, 10.0, 19.0, wide) == []


def test_what_the_watchdog_refuses_is_no_gap_and_a_gap_after_it_makes_it_none():
    guard = flying(8.0)
    feed(guard, DT_S, 1.0, lambda t: at(t, 8.0 * t, 8.0))
    guard.lose("the watchdog does not hand it on", 1.0)
    guard.miss("the autopilot is not heard", 2.0)
    assert feed_seeing(guard, 10.0, 19.0, wide) == []


def test_a_navigator_that_begins_in_the_air_tells_a_velocity_before_it_has_found_the_place():
    sent = feed_seeing(EstimateGuard(first_counter=7), 0.0, 4.0, wide)
    assert sent[0].t_s == pytest.approx(0.1 + LIMITS.unproven_s, abs=0.03)
    assert {e.reset_counter for e in sent} == {8}


def test_what_only_the_caller_knows_makes_it_lost_too():
    guard = flying()
    guard.lose("the watchdog holds the estimates back", 0.5)
    assert feed(guard, 0.5, 3.0) == []
    assert feed(guard, 3.0, 6.0, fixes_every(0.5))[0].reset_counter == 1


def test_a_navigator_that_begins_in_the_air_sends_only_a_proven_estimate_with_a_new_counter():
    guard = EstimateGuard(first_counter=7)
    sent = feed(guard, 0.0, 4.0, fixes_every(0.5))
    assert sent[0].t_s >= 1.0
    assert {e.reset_counter for e in sent} == {8}


def test_disarmed_on_the_ground_it_may_jump_and_come_back_freely():
    guard = lost_at_1_s()
    assert guard.admit(at(1.1, 600.0), 1.1, armed=False) is not None
    assert guard.lost_since_s is None
    assert guard.admit(at(1.12, 600.0), 1.12) is not None


ANY = st.floats(-1e4, 1e4) | st.sampled_from([math.nan, math.inf, 0.0])
NEAR = st.floats(-4.0, 4.0)
STEP = st.fixed_dictionaries(
    {
        "wait_s": st.sampled_from([0.02, 0.02, 0.02, 0.1, 0.3, 0.7, 3.0]),
        "age_s": st.sampled_from([0.0, 0.0, 0.0, 0.1, 0.4, -1.0]),
        "north_m": NEAR | ANY,
        "speed_m_s": NEAR | ANY,
        "sigma_m": st.sampled_from([0.3, 0.3, 4.0, 50.0, math.nan]),
        "sigma_m_s": st.sampled_from([0.3, 0.3, 2.0, 9.0]),
        "tilt_rad": st.sampled_from([0.0, 0.0, 0.3, 2.0]),
        "has_fix": st.booleans(),
        "reset": st.sampled_from([0, 0, 0, 1]),
    }
)


@given(st.lists(STEP, max_size=60))
def test_whatever_comes_nothing_is_sent_that_we_would_not_fly_on(steps):
    guard, t_s, counter, t_fix_s, last, jumped_s = flying(), 0.0, 0, 0.0, at(0.0), -math.inf
    for step in steps:
        t_s += step["wait_s"]
        counter += step["reset"]
        t_fix_s = t_s if step["has_fix"] else t_fix_s
        half = step["tilt_rad"] / 2.0
        estimate = at(
            t_s - step["age_s"],
            step["north_m"],
            step["speed_m_s"],
            covariance=covariance(step["sigma_m"], step["sigma_m_s"]),
            quat_wxyz=np.array([math.cos(half), math.sin(half), 0.0, 0.0]),
            t_last_fix_s=t_fix_s,
            reset_counter=counter,
        )
        sent = guard.admit(estimate, t_s)
        if sent is not None:
            check_law(sent, last, t_s)
            if sent.reset_counter != last.reset_counter:
                assert sent.t_s - jumped_s >= LIMITS.steady_s
                jumped_s = sent.t_s
            last = sent


def check_law(sent: Estimate, last: Estimate, t_s: float) -> None:
    assert np.all(np.isfinite(sent.position_ned_m))
    assert abs(t_s - sent.t_s) <= LIMITS.max_age_s
    assert sent.t_s >= last.t_s
    assert abs(sent.velocity_ned_m_s[0]) < LIMITS.max_speed_m_s
    assert sent.covariance[3, 3] < LIMITS.max_velocity_sigma_m_s**2
    assert sent.covariance[0, 0] < LIMITS.max_position_sigma_m**2
    assert sent.reset_counter >= last.reset_counter
    moved_m = float(np.hypot(*(sent.position_ned_m - last.position_ned_m)[:2]))
    span_s = sent.t_s - last.t_s
    if sent.reset_counter == last.reset_counter:
        assert moved_m <= LIMITS.max_speed_m_s * span_s + LIMITS.max_jump_m + 1e-9
        assert span_s <= LIMITS.brief_gap_s + LIMITS.settle_s + 0.3
    elif moved_m > math.sqrt(last.covariance[0, 0]):  # inside its sigma it is no other place
        assert sent.covariance[0, 0] <= LIMITS.new_position_sigma_m**2


@given(st.lists(st.booleans(), min_size=1, max_size=12), st.floats(0.0, 1.0))
def test_a_sleep_never_ends_in_an_estimate_of_the_same_counter(sleeps, speed):
    guard, t_s, north_m = flying(), 0.0, 0.0
    for sleep in sleeps:
        before = guard.lost_since_s is None
        t_s += 5.0 if sleep else 0.1
        north_m += speed * 8.0 * (5.0 if sleep else 0.1)
        sent = guard.admit(at(t_s, north_m, speed * 8.0), t_s)
        assert sent is None or (before and not sleep)


@pytest.mark.parametrize("axis", [0, 1])
def test_the_worse_of_north_and_east_counts(axis):
    for first, sigma, word in [(0, 70.0, "uncertain by 70 m"), (3, 5.0, "velocity is lost")]:
        variances = np.full(6, 0.1)
        variances[first + axis] = sigma**2
        guard = flying()
        assert guard.admit(at(0.1, covariance=np.diag(variances)), 0.1) is None
        assert word in guard.reason


def test_after_a_brief_stall_one_that_says_that_it_jumped_is_no_longer_the_same():
    guard = flying()
    assert feed(guard, DT_S, 0.2)
    assert not feed(guard, 1.0, 6.0, lambda t: at(t, reset_counter=1))


def test_what_the_watchdog_does_not_hand_on_for_long_is_lost():
    guard = flying(8.0)
    for i in range(200):
        guard.follow_relay(i < 50, i * DT_S)
        if guard.lost_since_s is not None:
            break
    assert guard.lost_since_s == pytest.approx(50 * DT_S + LIMITS.held_back_s, abs=0.05)
    assert guard.reason == "the watchdog does not hand it on"
