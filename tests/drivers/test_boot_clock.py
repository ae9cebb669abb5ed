"""The autopilot's clock is found under latencies that are never negative."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.drivers.boot_clock import BootClock

LATENCIES_S = st.lists(st.floats(0.0, 0.2), min_size=5, max_size=60)


@given(st.floats(-1e5, 1e5), LATENCIES_S)
def test_the_offset_is_right_to_the_least_latency(offset_s, latencies_s):
    clock = BootClock()
    for i, latency_s in enumerate(latencies_s):
        clock.handle_stamp(i * 0.02, i * 0.02 + offset_s + latency_s)
    found_s = clock.to_monotonic(100.0)
    assert found_s == pytest.approx(100.0 + offset_s + min(latencies_s), abs=1e-6)


@given(LATENCIES_S, st.floats(0.0, 0.04), st.floats(0.0, 1.0))
def test_a_round_trip_bounds_the_error_by_its_half(latencies_s, round_trip_s, share):
    clock = BootClock()
    for i, latency_s in enumerate(latencies_s):
        clock.handle_stamp(i * 0.02, i * 0.02 + 50.0 + latency_s)
    clock.handle_round_trip(60.0, 10.0 + share * round_trip_s, 60.0 + round_trip_s)
    error_s = clock.to_monotonic(10.0) - 60.0
    assert -0.5 * round_trip_s - 1e-9 <= error_s <= 0.5 * round_trip_s + 1e-9


def test_a_crystal_that_drifts_is_followed():
    clock, drift = BootClock(), 50e-6
    for i in range(20_000):
        boot_s = i * 0.02
        clock.handle_stamp(boot_s, boot_s * (1 + drift) + 5.0 + 0.001 * (i % 7))
    assert clock.to_monotonic(400.0) == pytest.approx(400.0 * (1 + drift) + 5.0, abs=0.0015)


def test_a_restart_is_noticed_and_the_old_offset_forgotten():
    clock = BootClock()
    assert not clock.handle_stamp(500.0, 1000.0)
    assert clock.handle_stamp(3.0, 1001.0)
    assert clock.to_monotonic(3.0) == 1001.0


def test_nothing_is_known_before_any_news():
    assert BootClock().to_monotonic(1.0) is None


def test_a_simulator_that_fell_behind_is_followed_within_seconds():
    """Half a second late for good, after a stall; then slower than real time by 3 %."""
    clock = BootClock()
    for i in range(1000):
        t_s = i * 0.02
        clock.handle_stamp(t_s - 5.0 if t_s < 10.0 else t_s - 5.5, t_s + 0.002)
        if i % 10 == 0:
            clock.handle_round_trip(t_s, t_s - 5.0 if t_s < 10.0 else t_s - 5.5, t_s)
    assert clock.to_monotonic(10.0) == pytest.approx(15.5, abs=0.005)
    for i in range(1000):
        t_s = 20.0 + i * 0.02
        clock.handle_stamp(14.5 + i * 0.02 * 0.97, t_s + 0.002)
    assert clock.to_monotonic(14.5 + 999 * 0.02 * 0.97) == pytest.approx(
        20.0 + 999 * 0.02, abs=0.16
    )


def test_a_burst_of_latency_does_not_move_the_clock():
    clock = BootClock()
    for i in range(1000):
        t_s = i * 0.02
        late_s = 0.2 if 10.0 < t_s < 12.5 else 0.002
        clock.handle_stamp(t_s - 5.0, t_s + late_s)
    assert clock.to_monotonic(10.0) == pytest.approx(15.002, abs=0.001)
