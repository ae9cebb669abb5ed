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
