"""Faults that are made in real processes: from inside of them, and by signals to the right one."""

import os
import pickle
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from vwnav.bench.flights.faults.camera import CameraTrouble, ImagesLate, upside_down
from vwnav.bench.flights.faults.computer import LoopHangs, MatchingRaises, ModelRaises, StepRaises
from vwnav.bench.flights.live import inside
from vwnav.bench.flights.live.breaks import can_be_broken, inside_of
from vwnav.bench.flights.live.campaign import live_rows
from vwnav.bench.flights.live.inside import patch_folder, trigger_of
from vwnav.bench.flights.live.processes import guarding, send
from vwnav.bench.flights.table import TABLE, row_of
from vwnav.types import Frame

ASKS = """
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

from vwnav.flight import Flight
from vwnav.mavlink.autopilot import LinkedAutopilot
from vwnav.pipeline import Pipeline
from vwnav.vision.features.learned import LearnedFeatures
from vwnav.vision.localizer import Localizer

def outcome(call):
    try:
        call(SimpleNamespace())
    except RuntimeError as error:
        return str(error)
    except (AttributeError, TypeError):
        return "as it is"  # nothing of the kind that it works on was given

extract, localize = LearnedFeatures.extract, Localizer.localize
for call in (LinkedAutopilot.step, Flight.tick, Pipeline.step, extract, localize):
    print(outcome(call))
"""


def told(folder, *words):
    """What each of the calls says, in a process of that command line."""
    env = os.environ | {"PYTHONPATH": os.pathsep.join([str(folder), *filter(None, sys.path)])}
    command = [sys.executable, "-c", ASKS, *words]
    return subprocess.run(
        command, env=env, capture_output=True, text=True, check=True
    ).stdout.splitlines()


def test_each_fault_breaks_what_it_names_while_its_file_is_there(tmp_path):
    faults = [StepRaises("link"), StepRaises("mission"), StepRaises("picture")]
    faults += [ModelRaises(), MatchingRaises()]
    folder = patch_folder(tmp_path, dict(enumerate(faults)))
    assert told(folder, "fly") == 5 * ["as it is"]
    for number in (1, 3):
        trigger_of(folder, number).touch()
    broken, model = "broken on purpose", "bad allocation in the inference session"
    assert told(folder, "fly") == ["as it is", broken, "as it is", model, "as it is"]
    trigger_of(folder, 4).touch()
    # The model is the same file for every navigator; a step is broken in the first one's process.
    assert told(folder, "fly", "--standby") == 3 * ["as it is"] + [model, "as it is"]
    assert told(folder, "fly")[4] == broken
    assert told(folder, "watchdog") == 5 * ["as it is"]


def test_late_images_come_so_late_and_tell_so_or_not():
    frames = [Frame(0.1 * i, np.zeros((2, 2), np.uint8), i) for i in range(30)]
    stamped, unstamped = inside._late(0.5, True), inside._late(0.5, False)
    came = [(now.t_s, stamped(now), unstamped(now)) for now in frames]
    late = [(t_s, a.t_s, b.t_s) for t_s, a, b in came if a is not None and b is not None]
    assert len(late) == 25
    for t_s, exposed_s, said_s in late:
        assert t_s - exposed_s == pytest.approx(0.5, abs=0.11)
        assert said_s == pytest.approx(exposed_s + 0.5)


def test_every_fault_that_a_live_row_breaks_inside_can_be_handed_to_another_process():
    inner = [fault for row in live_rows(TABLE, True) for fault in inside_of(row.breaks).values()]
    kinds = {type(fault) for fault in inner}
    assert kinds == {
        CameraTrouble, ImagesLate, ModelRaises, MatchingRaises, StepRaises, LoopHangs,
    }  # fmt: skip
    assert pickle.loads(pickle.dumps(inner)) == inner
    assert CameraTrouble(upside_down) in inner


def test_what_only_the_aircraft_can_do_is_not_ours():
    assert not can_be_broken(row_of("battery low").breaks, True)
    assert not can_be_broken((), True)
    both = row_of("pilot takes over after the navigator was killed").breaks
    assert can_be_broken(both, True)
    assert not can_be_broken(both, False)


def test_the_watchdog_that_guards_is_the_first_one_then_each_spare_one_in_turn():
    navigator = 9_999_999  # no process has it
    code = "import time; time.sleep(60)"
    words = ["vwnav.watchdog", "--navigator-pid", str(navigator)]
    started = []
    try:
        for more in ([], ["--spare"], ["--spare"]):
            started.append(subprocess.Popen([sys.executable, "-c", code, *words, *more]))
            time.sleep(0.05)  # the kernel counts a process' start in hundredths
        first, spare, later = (each.pid for each in started)
        assert guarding(navigator) == first
        send(signal.SIGSTOP, first)
        assert awaited(navigator, spare)
        started[1].kill()
        started[1].wait()
        assert guarding(navigator) == later
    finally:
        for each in started:
            each.kill()
            each.wait()
    assert guarding(navigator) is None
    send(signal.SIGTERM, first)  # it has ended: nothing happens


def awaited(navigator, pid):
    """A stop takes effect a moment later."""
    until_s = time.monotonic() + 5.0
    while guarding(navigator) != pid and time.monotonic() < until_s:
        time.sleep(0.01)
    return guarding(navigator) == pid
