"""The simulated time among real processes: whom it waits for, whom not, and for how long."""

import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from vwnav.clock import AwaitedExecutor, WallClock
from vwnav.pace import PATIENCE_S, PacedClock

ROOT = Path(__file__).parents[1]
# Its words come on stdin: each line is a time from now that it names.
OTHER = """
import sys
from pathlib import Path
from vwnav.pace import PacedClock
clock = PacedClock(Path(sys.argv[1]))
other = clock.join("other")
for line in sys.stdin:
    other.until(clock() + float(line))
    print(clock(), flush=True)
"""


@pytest.fixture
def clock():
    paced = PacedClock.create()
    yield paced
    paced.remove()


class Other:
    """A participant in a process of its own."""

    def __init__(self, clock):
        command = [sys.executable, "-c", OTHER, str(clock.file)]
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT
        )

    def until(self, in_s):
        """Its time when it had said so."""
        print(in_s, file=self.process.stdin, flush=True)
        return float(self.process.stdout.readline())


@pytest.fixture
def other(clock):
    participant = Other(clock)
    participant.until(60.0)
    yield participant
    participant.process.kill()
    participant.process.communicate()


def pace_of(clock, wall_s=0.3):
    """Seconds that pass for each second of the wall's."""
    wall_begin_s, begin_s = time.monotonic(), clock()
    time.sleep(wall_s)
    return (clock() - begin_s) / (time.monotonic() - wall_begin_s)


RUNS = pytest.approx(1.0, abs=0.15)
STANDS = pytest.approx(0.0, abs=0.15)


def test_with_nobody_late_it_is_the_walls(clock, other):
    assert clock() == pytest.approx(time.monotonic(), abs=0.1)
    assert pace_of(clock) == RUNS
    assert sum(clock.held_s().values()) == 0.0


def test_it_waits_for_one_who_is_late_and_never_catches_up(clock, other):
    until_s = other.until(0.05) + 0.05
    time.sleep(0.5)
    assert clock() <= until_s
    assert clock.held_s()["other"] >= 0.4
    assert other.until(60.0) <= until_s
    assert pace_of(clock) == RUNS


def test_all_processes_have_the_same_time(clock, other):
    other.until(0.05)
    time.sleep(0.3)
    for _ in range(20):
        before_s = clock()
        assert before_s <= other.until(60.0) <= clock()


def test_nobody_is_waited_for_longer_than_that_and_then_until_the_next_word(clock, other):
    other.until(0.0)
    began_s = time.monotonic()
    clock.wait_until(clock() + 0.05)
    assert PATIENCE_S <= time.monotonic() - began_s < PATIENCE_S + 0.5
    assert pace_of(clock) == RUNS
    other.until(0.0)
    assert pace_of(clock) == STANDS


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
def test_one_that_was_stopped_is_not_waited_for_and_again_once_it_goes_on(clock, other):
    other.until(0.0)
    os.kill(other.process.pid, signal.SIGSTOP)
    assert pace_of(clock) == RUNS
    os.kill(other.process.pid, signal.SIGCONT)
    assert pace_of(clock) == RUNS
    other.until(0.0)
    assert pace_of(clock) == STANDS


def test_one_that_has_ended_is_not_waited_for(clock, other):
    other.until(0.0)
    other.process.kill()
    assert pace_of(clock) == RUNS


def test_it_never_goes_back_for_one_who_names_a_time_that_has_passed(clock, other):
    before_s = clock()
    assert other.until(-5.0) >= before_s
    assert clock() >= before_s
    assert pace_of(clock) == STANDS


def test_it_is_monotonic_while_many_are_late_by_turns(clock, other):
    seen_s, stop = [], threading.Event()

    def run():
        mine, times_s = clock.join("thread"), [clock()]
        while not stop.is_set():
            mine.until(clock() + 0.002)
            time.sleep(0.004)
            times_s += [clock() for _ in range(50)]
        mine.leave()
        seen_s.append(times_s)

    threads = [threading.Thread(target=run) for _ in range(3)]
    for thread in threads:
        thread.start()
    theirs_s = [other.until(0.001) for _ in range(100)]
    stop.set()
    for thread in threads:
        thread.join()
    assert all(times_s == sorted(times_s) for times_s in [*seen_s, theirs_s])


def test_one_who_left_is_not_waited_for(clock):
    mine = clock.join("mine")
    mine.until(clock())
    assert pace_of(clock) == STANDS
    mine.leave()
    assert pace_of(clock) == RUNS


def test_one_stopped_while_it_held_the_file_stops_nobody(clock):
    mine = clock.join("mine")
    blocker = subprocess.Popen(
        [sys.executable, "-c", _HOLD_LOCK, str(clock.file)], stdout=subprocess.PIPE
    )
    blocker.stdout.readline()
    began_s = time.monotonic()
    for _ in range(20):
        mine.until(clock() + 60.0)
    assert time.monotonic() - began_s < 0.6
    blocker.kill()
    blocker.communicate()


_HOLD_LOCK = """
import fcntl, sys, time
with open(sys.argv[1], "rb") as file:
    fcntl.flock(file, fcntl.LOCK_EX)
    print(flush=True)
    time.sleep(60)
"""


@pytest.mark.parametrize("paced", [False, True])
def test_waiting_ends_at_the_time_waited_for(paced, clock):
    chosen = clock if paced else WallClock()
    until_s = chosen() + 0.1
    chosen.wait_until(until_s)
    assert 0.0 <= chosen() - until_s < 0.1
    chosen.wait_until(until_s)  # has passed: at once
    assert chosen() - until_s < 0.1


def test_time_waits_for_a_call_that_takes_longer_than_usual(clock):
    with ThreadPoolExecutor(1) as pool:
        executor = AwaitedExecutor(pool, clock, clock.join("calls"), usual_s=0.05)
        began_s = clock()
        assert executor.submit(time.sleep, 0.4).result() is None
        assert clock() - began_s < 0.1
        assert pace_of(clock) == RUNS
