"""A signal lands the aircraft, or is said where a pilot flies it; two of them do no more."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.quick import first_quick

TESTS = Path(__file__).resolve().parents[1]
FLIES = """
import sys, threading, time
from collections import deque
from test_runtime import Handle, Images, Link, Mission, Path, Record
from vehicles import FLYING
from vwnav.clock import WallClock
from vwnav.mission.mission import FlightEnd, Phase
from vwnav.machine.signals import heeding_signals
from vwnav.runtime import FlightRuntime
from vwnav.safety.camera_watch import CameraWatch
from vwnav.safety.estimate_guard import EstimateGuard
from vwnav.seams import GuardedWatcher

class Flown(Mission):
    def abort(self, reason):
        self.end = FlightEnd(reason)

class Says(Record):
    def event(self, text):
        if "interrupted" in text:
            time.sleep(0.02)  # long enough for a second one to come meanwhile
            print(text, flush=True)

images, link = Images(), Link()
link.vehicle = FLYING
runtime = FlightRuntime(
    Path(), Flown(ticks=60, phase=Phase[sys.argv[1]]), link, EstimateGuard(), Handle(),
    CameraWatch(64, 48), GuardedWatcher(Says()), deque(),
)
with heeding_signals(runtime.interrupt):
    print("flies", flush=True)
    end = runtime.run(images, WallClock())
    print("ended:", end.reason, flush=True)
"""


def told(
    phase: str,
    signals: list[signal.Signals],
    gap_s: float = 0.0,
    ignored: tuple[signal.Signals, ...] = (),
) -> list[str]:
    """What it says that is told to end while it flies."""

    def start() -> None:
        for each in signal.SIGINT, signal.SIGHUP, signal.SIGTERM:
            signal.signal(each, signal.SIG_IGN if each in ignored else signal.SIG_DFL)

    command = [sys.executable, "-c", FLIES, phase]
    path = os.pathsep.join([str(TESTS), str(TESTS.parent)])
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        env=os.environ | {"PYTHONPATH": path}, preexec_fn=start,
    ) as process:  # fmt: skip
        assert process.stdout is not None
        assert process.stdout.readline() == "flies\n"
        time.sleep(0.5)
        for number in signals:
            process.send_signal(number)
            time.sleep(gap_s)
        said, _ = process.communicate(timeout=30.0)
    return said.splitlines()


@pytest.mark.parametrize("gap_s", first_quick([0.0003, 0.005, 0.12]))
@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGINT, signal.SIGTERM])
def test_two_signals_end_no_navigator_on_whose_estimates_a_pilot_flies(number, gap_s):
    said = told("RELEASED", [number, number], gap_s)
    assert said[-1] == "ended: None", said  # the mission's own end
    assert "somebody else flies" in said[0]


@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGINT, signal.SIGTERM])
def test_one_signal_before_take_off_or_in_flight_ends_it_well(number):
    assert told("GET_READY", [number])[-1] == "ended: interrupted by the operator: landing"


def test_a_terminal_that_is_closed_and_a_service_that_is_stopped_at_once_land():
    several = [signal.SIGHUP, signal.SIGTERM, signal.SIGHUP, signal.SIGINT]
    assert told("ROUTE", several)[-1] == "ended: interrupted by the operator: landing"


def test_a_signal_that_it_was_started_to_ignore_stays_ignored():
    """`nohup` says SIGHUP, a shell's `&` says SIGINT."""
    both = signal.SIGHUP, signal.SIGINT
    assert told("ROUTE", [*both], ignored=both) == ["ended: None"]
