"""Whatever ends the navigator, the watchdog brakes, holds and lands; with real processes."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from link_peer import PX4_HOLD, PX4_LAND, free_port, is_still, wait_for
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from watchdog_flight import ESTIMATE, HERE, SETPOINT, flight, lives, stalled_log

from tests.quick import first_quick
from vwnav.errors import LinkError
from vwnav.watchdog.launch import start_watchdog
from vwnav.watchdog.successor import Resume, SuccessorProcess

# The bounds of flight are 0.3 s after an end and 0.6 s after a stop (see the trials); a loaded
# machine that runs the tests may take longer to run the watchdog at all.
SLACK_S = 0.15


@pytest.mark.parametrize(
    "number", first_quick([signal.SIGKILL, signal.SIGTERM, signal.SIGUSR1, signal.SIGINT], 2)
)
def test_a_navigator_that_ends_in_any_way_is_braked_for_at_once_and_landed(number):
    with flight() as flying:
        assert flying.first_still_s(flying.signal(number)) < 0.3 + SLACK_S
        wait_for(lambda: flying.peer.custom_mode == PX4_LAND, 8.0)
        wait_for(lambda: [m for m in flying.peer.of("STATUSTEXT") if m.text.endswith(": landing")])
        assert flying.watchdog_lives()


def test_a_log_on_a_disk_that_stalls_delays_neither_brake_nor_hold_nor_land():
    with stalled_log() as log, flight(log=log) as flying:
        killed_s = flying.signal(signal.SIGKILL)
        assert flying.first_still_s(killed_s) < 0.3 + SLACK_S
        wait_for(lambda: flying.peer.custom_mode == PX4_HOLD, 1.0 + SLACK_S)
        wait_for(lambda: flying.peer.custom_mode == PX4_LAND, 3.0)
        assert time.monotonic() - killed_s < 3.5 + 2 * SLACK_S


def test_a_navigator_that_sleeps_and_wakes_up_neither_flies_nor_tells_a_place():
    with flight() as flying:
        assert flying.first_still_s(flying.signal(signal.SIGSTOP)) < 0.6 + SLACK_S
        time.sleep(3.0)
        woken_s = flying.signal(signal.SIGCONT)
        time.sleep(2.0)
        assert flying.peer.of(ESTIMATE, woken_s) == []
        assert all(is_still(s) for s in flying.peer.of(SETPOINT, woken_s))
        wait_for(lambda: flying.peer.custom_mode == PX4_LAND, 8.0)


def test_a_service_that_stops_the_watchdog_too_gets_the_aircraft_landed_first():
    with flight() as flying:
        os.kill(flying.watchdog, signal.SIGTERM)
        assert flying.first_still_s(flying.signal(signal.SIGTERM)) < 0.3 + SLACK_S
        wait_for(lambda: flying.peer.custom_mode == PX4_LAND, 8.0)
        assert flying.watchdog_lives()


def test_after_the_navigators_end_a_successor_gives_estimates_and_never_flies(tmp_path):
    notes = tmp_path / "notes"
    with flight([sys.executable, str(HERE / "successor.py"), str(notes)]) as flying:
        wait_for(lambda: notes.exists() and notes.read_text() == "started\n")
        killed_s = flying.signal(signal.SIGKILL)
        wait_for(lambda: [m for m in flying.peer.of(ESTIMATE, killed_s) if m.reset_counter == 1])
        wait_for(lambda: flying.peer.custom_mode == PX4_LAND, 8.0)
        assert all(is_still(s) for s in flying.peer.of(SETPOINT, killed_s + 0.1))
    wait_for(lambda: "ended" in notes.read_text().splitlines())
    resume = json.loads(notes.read_text().splitlines()[1])
    assert resume["position"]["position_ned_m"][0] > 2.0
    assert resume["velocity_ne_m_s"][0] == pytest.approx(8.0, abs=1.5)


def test_a_successor_that_dies_is_started_again_a_few_times(tmp_path):
    notes = tmp_path / "notes"
    with flight([sys.executable, str(HERE / "successor.py"), str(notes), "dies"]) as flying:
        wait_for(lambda: notes.exists())
        flying.signal(signal.SIGKILL)
        wait_for(lambda: notes.read_text().count("position_ned_m") == 2, 15.0)
        wait_for(lambda: flying.peer.custom_mode == PX4_LAND, 8.0)


def test_a_navigator_that_is_stopped_is_ended_and_its_successor_tells_the_place(
    tmp_path,
):
    notes = tmp_path / "notes"
    with flight([sys.executable, str(HERE / "successor.py"), str(notes)]) as flying:
        wait_for(lambda: notes.exists())
        stopped_s = flying.signal(signal.SIGSTOP)
        time.sleep(2.0)
        assert flying.process.poll() is None  # one that is silent for so long may come back
        assert flying.process.wait(3.0) == -signal.SIGKILL
        wait_for(lambda: flying.peer.custom_mode == PX4_LAND)
        wait_for(lambda: [m for m in flying.peer.of(ESTIMATE, stopped_s) if m.reset_counter == 1])
        assert [m for m in flying.peer.of("STATUSTEXT", stopped_s) if "second one" in m.text]


@pytest.mark.long
def test_when_the_whole_machine_slept_the_navigator_is_not_ended_for_it(tmp_path):
    """Suspended, frozen, starved: the watchdog that wakes first has heard nothing for long."""
    notes = tmp_path / "notes"
    with flight([sys.executable, str(HERE / "successor.py"), str(notes)]) as flying:
        wait_for(lambda: notes.exists())
        flying.signal(signal.SIGSTOP)
        watchdogs = flying.all_watchdogs()
        for each in watchdogs:
            os.kill(each, signal.SIGSTOP)
        time.sleep(6.0)
        for each in sorted(watchdogs, reverse=True):  # the spare one first
            os.kill(each, signal.SIGCONT)
        time.sleep(1.5)
        assert flying.guards() == flying.watchdog
        assert flying.process.poll() is None
        flying.signal(signal.SIGCONT)
        time.sleep(4.0)
        assert flying.process.poll() is None


def test_a_successor_that_hangs_is_ended_and_another_one_started(tmp_path):
    notes = tmp_path / "notes"
    with flight([sys.executable, str(HERE / "successor.py"), str(notes), "stops"]) as flying:
        wait_for(lambda: notes.exists())
        flying.signal(signal.SIGKILL)
        wait_for(lambda: notes.read_text().count("position_ned_m") == 2, 15.0)
        again_s = time.monotonic()
        wait_for(lambda: len(flying.peer.of(ESTIMATE, again_s)) > 10)
    wait_for(lambda: "ended" in notes.read_text().splitlines())


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_while_one_successor_serves_the_next_has_loaded_and_takes_over_at_once(tmp_path, number):
    notes = tmp_path / "notes"
    with flight([sys.executable, str(HERE / "successor.py"), str(notes), "loads"]) as flying:
        wait_for(lambda: notes.exists() and notes.read_text() == "started\n", 8.0)
        flying.signal(signal.SIGKILL)
        wait_for(lambda: notes.read_text().count("started") == 2, 8.0)
        (first,) = served_by(notes)
        ended_s = time.monotonic()
        os.kill(first, number)
        silent_s = 0.0 if number == signal.SIGKILL else 3.0  # before it is ended
        wait_for(lambda: len(served_by(notes)) == 2, silent_s + 1.0 + SLACK_S)
        wait_for(lambda: flying.peer.of(ESTIMATE, ended_s + silent_s + 0.1))


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
@pytest.mark.parametrize("after_s", first_quick([0.0, 1.2, 4.5]))
def test_a_watchdog_that_dies_after_its_navigator_is_followed_by_one_that_lands_it(number, after_s):
    """It has yet to brake; it holds; it lands."""
    with flight() as flying:
        flying.wait_for_a_spare()
        flying.signal(signal.SIGKILL)
        time.sleep(after_s)
        os.kill(flying.watchdog, number)
        wait_for(lambda: flying.guards() != flying.watchdog, 8.0)
        wait_for(lambda: flying.peer.custom_mode == PX4_LAND, 8.0)
        asked = [int(m.param3) for m in flying.peer.commands(mavlink.MAV_CMD_DO_SET_MODE)]
        assert asked.count(6) <= 2  # Land, not again and again: it knows that it has landed it
    wait_for(lambda: not flying.all_watchdogs(), 10.0)


@pytest.mark.long
def test_a_successor_that_serves_goes_on_under_the_watchdog_that_follows(tmp_path):
    """Nobody has to find the place anew; the next one waits behind it again, and all end."""
    notes = tmp_path / "notes"
    with flight([sys.executable, str(HERE / "successor.py"), str(notes), "loads"]) as flying:
        flying.wait_for_a_spare()
        wait_for(lambda: notes.exists() and notes.read_text() == "started\n", 8.0)
        flying.signal(signal.SIGKILL)
        (first,) = wait_for(lambda: served_by(notes), 8.0)
        wait_for(lambda: [m for m in flying.peer.of(ESTIMATE) if m.reset_counter == 1])
        os.kill(flying.watchdog, signal.SIGKILL)
        killed_s = time.monotonic()
        wait_for(lambda: len(flying.peer.of(ESTIMATE, killed_s + 1.0)) > 10)
        assert served_by(notes) == [first]
        started = notes.read_text().count("started")
        wait_for(lambda: notes.read_text().count("started") > started, 15.0)
        os.kill(first, signal.SIGSTOP)
        wait_for(lambda: len(served_by(notes)) == 2, 8.0)
        assert not lives(first)
    wait_for(lambda: not flying.all_watchdogs(), 10.0)
    wait_for(lambda: not any(map(lives, served_by(notes))), 10.0)


def served_by(notes: Path) -> list[int]:
    """Numbers of the processes that were woken, in their order."""
    lines = notes.read_text().splitlines()
    return [int(each.removeprefix("serves ")) for each in lines if each.startswith("serves")]


def test_a_navigator_started_again_gets_no_second_watchdog_while_the_first_one_lands():
    with flight() as flying:
        flying.signal(signal.SIGKILL)
        with pytest.raises(LinkError, match="another watchdog"):
            start_watchdog(flying.url)
    start_watchdog(flying.url).close()


def test_two_that_call_the_same_autopilot_do_not_share_it():
    url = f"udpout://127.0.0.1:{free_port()}"
    with start_watchdog(url), pytest.raises(LinkError, match="another watchdog"):
        start_watchdog(url)


HELD = """
import sys, time
if sys.stdin.readline():
    with open(sys.argv[1], "a") as notes:
        notes.write("woken\\n")
    time.sleep(60.0)
"""


def test_a_successor_that_is_killed_is_followed_though_the_system_still_holds_it(
    tmp_path, monkeypatch
):
    """As one does that waits for a camera, or a disk; nor is it waited for at the end."""
    notes, ours = tmp_path / "notes", []
    monkeypatch.setattr(subprocess.Popen, "kill", lambda each: ours.append(each))
    monkeypatch.setattr(subprocess.Popen, "terminate", lambda each: ours.append(each))
    successor = SuccessorProcess([sys.executable, "-c", HELD, str(notes)], "", "", 0)
    resume, t_s = Resume(None, (0.0, 0.0), None), 0.0
    for number in 1, 2:
        began_s = t_s
        while not notes.exists() or notes.read_text().count("woken") < number:
            successor.step(resume, t_s)
            t_s += 0.02
            time.sleep(0.002)
            assert t_s - began_s < 30.0
        successor.handle_beat()
    left_s = time.monotonic()
    successor.close()
    assert time.monotonic() - left_s < 10.0
    for each in set(ours):
        os.kill(each.pid, signal.SIGKILL)
        each.wait()
