"""From the navigator's end, or its stop, to the first zero velocity: fifty trials of each.

    python -m pytest -m long -s tests/watchdog/test_watchdog_trials.py

says the largest and the median time of each.
"""

import signal
import statistics
import time

import pytest
from link_peer import PX4_OFFBOARD, wait_for
from watchdog_flight import SETPOINT, Flight, flight

TRIALS = 50
STEADY_S = 0.3


def said(name: str, times_s: list[float]) -> float:
    median_s, largest_s = statistics.median(times_s), max(times_s)
    print(f"{name}: {len(times_s)} trials, median {median_s:.3f} s, maximum {largest_s:.3f} s")
    return largest_s


@pytest.mark.long
def test_killed_to_zero_velocity_within_0_3_s():
    times_s = []
    for _ in range(TRIALS):
        with flight() as flying:
            times_s.append(flying.first_still_s(flying.signal(signal.SIGKILL)))
    assert said("killed", times_s) <= 0.3


@pytest.mark.long
def test_stopped_to_zero_velocity_within_0_6_s():
    times_s = []
    while len(times_s) < TRIALS:
        with flight() as flying:
            for _ in range(10):
                times_s.append(flying.first_still_s(flying.signal(signal.SIGSTOP)))
                claim_again(flying)
    assert said("stopped", times_s) <= 0.6


def claim_again(flying: Flight) -> None:
    flying.signal(signal.SIGCONT)
    flying.peer.custom_mode = PX4_OFFBOARD
    since_s = flying.signal(signal.SIGUSR2)
    wait_for(lambda: len([s for s in flying.peer.of(SETPOINT, since_s) if s.vx]) > 10)
    time.sleep(STEADY_S)
