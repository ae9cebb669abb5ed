"""The autopilot's clock is found, offset and rate, under latencies that are never negative."""

import math
import random
import tracemalloc

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vwnav.sender_clock import SenderClock

LATENCIES_S = st.lists(st.floats(0.0, 0.2), min_size=5, max_size=45)
PERIOD_S = 0.02
WIRE_S = 0.002  # nothing is faster, either way


class Autopilot:
    """Its clock runs at `rate` of ours; what it says is late by chance, at times in bursts."""

    def __init__(self, rate=1.0, jitter_s=0.004, burst_every_s=0.0, asks=True, seed=0):
        self.rate, self.jitter_s, self.burst_every_s, self.asks = (
            rate,
            jitter_s,
            burst_every_s,
            asks,
        )
        self.rng = random.Random(seed)
        self.clock, self.t_s = SenderClock(), 1000.0
        self.boot_zero_s = 990.0  # of ours, when its clock showed zero
        self.late_until_s = 0.0
        self.up_s = self.down_s = 0.0  # longer than usual is the way to it, and from it

    def boot_s(self, t_s):
        return (t_s - self.boot_zero_s) * self.rate

    def set_rate(self, rate):
        self.boot_zero_s = self.t_s - self.boot_s(self.t_s) / rate
        self.rate = rate

    def fall_behind(self, by_s):
        self.boot_zero_s += by_s

    def latency_s(self):
        """What is sent in a burst of lateness arrives at its end."""
        return max(self.rng.uniform(0.0, self.jitter_s), self.late_until_s - self.t_s) + WIRE_S

    def run(self, seconds):
        """The errors of the dates of all stamps, s; positive is too late."""
        errors_s = []
        for i in range(round(seconds / PERIOD_S)):
            self.t_s += PERIOD_S
            if self.burst_every_s and self.rng.random() < PERIOD_S / self.burst_every_s:
                self.late_until_s = self.t_s + 0.1
            boot_s, received_s = self.boot_s(self.t_s), self.t_s + self.latency_s() + self.down_s
            if self.clock.handle_stamp(boot_s, received_s):
                errors_s.append(self.clock.to_monotonic(boot_s) - self.t_s)
            if self.asks and i % 10 == 0:
                self.ask()
        return errors_s

    def ask(self):
        up_s, down_s = self.latency_s() + self.up_s, self.latency_s() + self.down_s
        answered_s = self.boot_s(self.t_s + up_s)
        self.clock.handle_round_trip(self.t_s, answered_s, self.t_s + up_s + down_s)


def worst(errors_s):
    return max(abs(error_s) for error_s in errors_s)


@pytest.mark.parametrize("rate", [1.0, 1.01, 0.99, 0.98, 0.97])
@pytest.mark.parametrize("asks", [True, False])
def test_a_clock_that_runs_slow_is_dated_within_5_ms(rate, asks):
    autopilot = Autopilot(rate, asks=asks, burst_every_s=1.0)
    autopilot.run(4.0)
    assert worst(autopilot.run(60.0)) < 0.005


@settings(deadline=None, max_examples=40)
@given(
    st.floats(0.97, 1.01),
    st.floats(0.0, 0.008),
    st.sampled_from([0.0, 0.5, 3.0]),
    st.booleans(),
    st.integers(0, 1000),
)
def test_any_rate_jitter_and_bursts_are_dated_within_5_ms(rate, jitter_s, burst_s, asks, seed):
    autopilot = Autopilot(rate, jitter_s, burst_s, asks, seed)
    autopilot.run(5.0)
    assert worst(autopilot.run(20.0)) < 0.005


def test_a_rate_that_changes_is_followed():
    autopilot = Autopilot(1.0)
    autopilot.run(10.0)
    autopilot.set_rate(0.98)
    assert worst(autopilot.run(3.0)) < 0.030
    assert worst(autopilot.run(10.0)) < 0.005


@pytest.mark.parametrize("rate", [0.7, 0.85, 1.3])
def test_a_simulator_that_falls_behind_by_fits_and_starts_is_followed_where_it_answers(rate):
    autopilot = Autopilot(1.0)
    autopilot.run(10.0)
    for _ in range(3):
        autopilot.set_rate(rate)
        assert worst(autopilot.run(5.0)) < 0.1
        autopilot.set_rate(1.0)
        assert worst(autopilot.run(5.0)) < 0.1


@given(st.floats(-1e5, 1e5), LATENCIES_S)
def test_at_first_the_offset_is_right_to_the_least_latency(offset_s, latencies_s):
    clock = SenderClock()
    for i, latency_s in enumerate(latencies_s):
        clock.handle_stamp(i * 0.02, i * 0.02 + offset_s + latency_s)
    newest_s = (len(latencies_s) - 1) * 0.02
    found_s = clock.to_monotonic(newest_s)
    assert found_s == pytest.approx(newest_s + offset_s + min(latencies_s), abs=1e-6)


def test_a_long_way_is_halved_by_the_answers():
    autopilot = Autopilot()
    autopilot.latency_s = lambda: 0.25
    autopilot.run(4.0)
    assert worst(autopilot.run(4.0)) < 0.005
    assert autopilot.clock.round_trip_s == pytest.approx(0.5)


GARBAGE = {
    "zero": lambda boot_s, rng: 0.0,
    "seconds for nanoseconds": lambda boot_s, rng: boot_s / 1e9,
    "the time of day": lambda boot_s, rng: 1.7e9 + boot_s,
    "a second behind": lambda boot_s, rng: boot_s - 1.0,
    "a second ahead": lambda boot_s, rng: boot_s + 1.0,
    "a tenth behind": lambda boot_s, rng: boot_s - 0.1,
    "a tenth ahead": lambda boot_s, rng: boot_s + 0.1,
    "anything": lambda boot_s, rng: rng.uniform(-9.2e9, 9.2e9),
    "anything near": lambda boot_s, rng: boot_s + rng.uniform(-0.5, 0.5),
}


@pytest.mark.parametrize("kind", GARBAGE)
@pytest.mark.parametrize("asks", [True, False])
def test_answers_that_are_garbage_change_nothing(kind, asks):
    """All of them, or one among two that are true."""
    autopilot = Autopilot(0.99, asks=asks, burst_every_s=3.0)
    autopilot.run(5.0)
    errors_s = []
    for _ in range(100):
        errors_s += autopilot.run(0.2)
        sent_s, answered_s = autopilot.t_s, autopilot.boot_s(autopilot.t_s + 0.01)
        lie_s = GARBAGE[kind](answered_s, autopilot.rng)
        autopilot.clock.handle_round_trip(sent_s, lie_s, sent_s + 0.02)
    assert worst(errors_s) < 0.008


@pytest.mark.parametrize("trip", [(5.0, 1.0), (1000.0, 5.0), (float("nan"), 5.0)])
def test_a_round_trip_that_cannot_be_is_no_witness(trip):
    clock = SenderClock()
    sent_s, spent_s = trip
    clock.handle_stamp(1.0, 1000.0)
    clock.handle_round_trip(sent_s, 1.0, sent_s - spent_s)
    assert clock.to_monotonic(1.0) == 1000.0


def test_a_crystal_that_drifts_is_followed():
    clock, drift = SenderClock(), 50e-6
    for i in range(20_000):
        boot_s = i * 0.02
        clock.handle_stamp(boot_s, boot_s * (1 + drift) + 5.0 + 0.001 * (i % 7))
    assert clock.to_monotonic(400.0) == pytest.approx(400.0 * (1 + drift) + 5.0, abs=0.0015)


def test_a_restart_is_noticed_and_the_old_offset_forgotten():
    autopilot = Autopilot()
    autopilot.run(10.0)
    autopilot.boot_zero_s = autopilot.t_s - 3.0  # in the air, too
    errors_s = autopilot.run(1.0)
    assert autopilot.clock.restarts == 1
    assert len(errors_s) >= 47
    assert worst(errors_s) < 0.008


@pytest.mark.parametrize("stamp_s", [0.0, 4294967.295, 9.9])
def test_one_stamp_that_cannot_be_is_not_believed(stamp_s):
    autopilot = Autopilot()
    autopilot.run(10.0)
    for _ in range(20):
        assert not autopilot.clock.handle_stamp(stamp_s, autopilot.t_s)
        assert worst(autopilot.run(0.2)) < 0.005
    assert autopilot.clock.restarts == 0


def test_a_stamp_that_was_overtaken_is_no_point_of_the_hull():
    clock = SenderClock()
    for boot_s, received_s in ((10.0, 1000.0), (10.3, 1000.3), (10.0, 999.99), (10.6, 1000.6)):
        clock.handle_stamp(boot_s, received_s)
    assert clock.to_monotonic(10.6) == pytest.approx(1000.6)


SECONDS = st.one_of(st.floats(0.0, 20.0), st.floats(-1e6, 1e6))
NEWS = st.tuples(st.booleans(), SECONDS, SECONDS, st.floats(0.0, 2.0))


@given(st.lists(NEWS, max_size=60))
def test_whatever_is_told_in_whatever_order_gives_a_time(news):
    clock = SenderClock()
    for is_stamp, boot_s, t_s, spent_s in news:
        if is_stamp:
            clock.handle_stamp(boot_s, t_s)
        else:
            clock.handle_round_trip(t_s, boot_s, t_s + spent_s)
        found_s = clock.to_monotonic(boot_s)
        assert found_s is None or math.isfinite(found_s)


def test_nothing_is_known_before_any_news():
    assert SenderClock().to_monotonic(1.0) is None


@pytest.mark.parametrize(("asks", "within_s"), [(True, 0.7), (False, 4.0)])
def test_a_simulator_that_fell_behind_is_followed(asks, within_s):
    autopilot = Autopilot(asks=asks)
    autopilot.run(10.0)
    autopilot.fall_behind(0.5)
    autopilot.run(within_s)
    assert worst(autopilot.run(10.0)) < 0.010
    assert autopilot.clock.restarts == 0


@given(st.floats(0.3, 2.0), st.floats(0.0, 0.2), st.integers(0, 1000))
def test_one_that_stood_with_questions_waiting_is_dated_rightly_soon_after(stood_s, phase_s, seed):
    """They are answered all at once, before a stamp tells: taken for lies it took a second more."""
    autopilot = Autopilot(seed=seed)
    autopilot.run(8.0 + phase_s)
    asked_s = [autopilot.t_s + 0.2 * i - phase_s for i in range(1, math.ceil(stood_s / 0.2))]
    autopilot.fall_behind(stood_s)
    autopilot.t_s += stood_s
    for sent_s in asked_s:
        boot_s = autopilot.boot_s(autopilot.t_s)
        autopilot.clock.handle_round_trip(sent_s, boot_s, autopilot.t_s + WIRE_S)
    autopilot.run(0.3)
    assert worst(autopilot.run(1.0)) < 0.02


def test_a_simulator_that_stood_still_for_a_while_is_followed():
    autopilot = Autopilot()
    autopilot.run(10.0)
    autopilot.t_s += 20.0
    autopilot.fall_behind(20.0)
    autopilot.run(0.5)
    assert worst(autopilot.run(5.0)) < 0.010
    assert autopilot.clock.restarts == 0


def test_a_burst_of_latency_does_not_move_the_clock():
    clock = SenderClock()
    for i in range(1000):
        t_s = i * 0.02
        late_s = 0.2 if 10.0 < t_s < 12.5 else 0.002
        clock.handle_stamp(t_s - 5.0, t_s + late_s)
        assert clock.to_monotonic(t_s - 5.0) == pytest.approx(t_s + 0.002, abs=0.001)


def test_what_a_link_held_back_is_dated_when_it_was_measured():
    """Five seconds of stamps that arrive in one moment."""
    autopilot = Autopilot()
    autopilot.run(10.0)
    start_s = autopilot.t_s
    for i in range(250):
        t_s = start_s + 0.02 * (i + 1)
        assert autopilot.clock.handle_stamp(autopilot.boot_s(t_s), start_s + 5.0)
        found_s = autopilot.clock.to_monotonic(autopilot.boot_s(t_s))
        assert found_s == pytest.approx(t_s, abs=0.005)


@pytest.mark.parametrize(("up_s", "down_s"), [(0.0, 0.1), (0.0, 0.3), (0.15, 0.15), (0.05, 0.3)])
def test_a_way_that_becomes_longer_in_flight_does_not_move_the_clock(up_s, down_s):
    """For two minutes: the window of what is remembered is 8 s, of both bounds alike.

    It was that of one: both ways longer by 0.15 s dated attitudes 77 ms early 8 s later, 1.5 m at
    8 m/s, 5 sigmas.
    """
    autopilot = Autopilot()
    autopilot.run(10.0)
    autopilot.up_s, autopilot.down_s = up_s, down_s
    assert worst(autopilot.run(120.0)) < 0.010
    autopilot.up_s = autopilot.down_s = 0.0
    assert worst(autopilot.run(20.0)) < 0.010


def test_a_longer_way_of_crystals_that_part_is_followed_slowly():
    """Ten minutes at 10 millionths: what was known before says less and less."""
    autopilot = Autopilot()
    autopilot.run(10.0)
    autopilot.set_rate(1.0 + 10e-6)
    autopilot.down_s = 0.2
    assert worst(autopilot.run(600.0)) < 0.015


def test_stamps_that_are_times_of_no_clock_are_not_kept():
    clock, rng = SenderClock(), random.Random(1)
    clock.handle_stamp(1e6, 1e6)
    tracemalloc.start()
    for _ in range(20_000):
        assert not clock.handle_stamp(rng.uniform(0.0, 9e5), 1e6)
    kept_bytes = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert kept_bytes < 10_000
