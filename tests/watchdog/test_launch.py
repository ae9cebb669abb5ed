"""The watchdog as a process: real UDP on both sides, a peer that answers like an autopilot."""

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from link_peer import (
    DENIED,
    IN_AIR,
    PX4_HOLD,
    PX4_LAND,
    PX4_OFFBOARD,
    PX4_POSITION,
    Peer,
    free_port,
    is_still,
    wait_for,
)
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from tests.quick import first_quick
from vwnav.errors import LinkError
from vwnav.watchdog.keepalive import GuardState
from vwnav.watchdog.launch import WatchdogProcess, start_watchdog
from vwnav.watchdog.spare import MOST_STARTS

MAV = mavlink.MAVLink(None, srcSystem=7, srcComponent=191)


def setpoint(north_m_s: float) -> bytes:
    message = mavlink.MAVLink_set_position_target_local_ned_message(
        0, 7, 1, 1, 2503, 0, 0, 0, north_m_s, *[0] * 7
    )
    return bytes(message.pack(MAV))


class Flown:
    """An engaged flight in Offboard: peer, watchdog, and the navigator's socket."""

    def __init__(self, peer: Peer, watchdog: WatchdogProcess) -> None:
        self.peer, self.watchdog, self.keepalive = peer, watchdog, watchdog.keepalive
        port = int(watchdog.navigator_url.rpartition(":")[2])
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect(("127.0.0.1", port))
        self.socket.settimeout(2.0)
        self.estimates, self.jump_m, self.sigma_m = False, 0.0, 20.0
        self.begun_s = time.monotonic()

    def engage(self) -> None:
        self.peer.armed, self.peer.custom_mode, self.peer.landed_state = True, PX4_OFFBOARD, IN_AIR
        self.fly(0.4)

    def fly(self, seconds: float) -> None:
        until_s = time.monotonic() + seconds
        while time.monotonic() < until_s:
            self.keepalive.beat(True, "on route")
            with contextlib.suppress(ConnectionRefusedError):  # while one takes another's place
                self.socket.send(setpoint(3.0))
                if self.estimates:
                    self.socket.send(self.estimate())
            time.sleep(0.02)

    def estimate(self) -> bytes:
        """At 8 m/s north."""
        now_s = time.monotonic()
        place = (8.0 * (now_s - self.begun_s) + self.jump_m, 0.0, -50.0, 0.0, 0.0, 0.0)
        message = mavlink.MAVLink_vision_position_estimate_message(
            int(now_s * 1e6), *place, [self.sigma_m**2] * 21, 0
        )
        return bytes(message.pack(MAV))

    def state(self) -> GuardState:
        report = self.keepalive.report
        return GuardState.RELAY if report is None else report.state

    def setpoints(self, since_s: float = 0.0):
        return self.peer.of("SET_POSITION_TARGET_LOCAL_NED", since_s)


@pytest.fixture
def flown():
    port = free_port()
    with start_watchdog(f"udpin://127.0.0.1:{port}") as watchdog, Peer(port) as peer:
        flown = Flown(peer, watchdog)
        flown.socket.send(b"hello")
        yield flown
        flown.socket.close()
        peer.armed = False
        time.sleep(0.2)


def asked_modes(peer: Peer) -> list[int]:
    commands = peer.commands(mavlink.MAV_CMD_DO_SET_MODE)
    return [int(c.param2) << 16 | int(c.param3) << 24 for c in commands]


def muted(flown: Flown) -> socket.socket:
    """The navigator's end, after the last of the autopilot's own messages."""
    flown.peer.speaks = False
    flown.socket.settimeout(0.2)
    with contextlib.suppress(TimeoutError):
        while flown.socket.recv(4096):
            pass
    flown.socket.settimeout(2.0)
    return flown.socket


def test_bytes_go_both_ways_untouched_even_garbage_and_within_2_ms(flown):
    navigator, times_ms = muted(flown), []
    for i in range(200):
        data = os.urandom(1 + i % 200) if i % 2 else setpoint(1.0)
        start_s = time.perf_counter()
        flown.peer.socket.sendto(data, flown.peer.to)
        assert navigator.recv(4096) == data
        times_ms.append((time.perf_counter() - start_s) * 1e3)
    assert sorted(times_ms)[100] < 2.0
    navigator.send(setpoint(2.0))
    assert wait_for(lambda: [s for s in flown.setpoints() if s.vx == 2.0])


def test_an_observer_listens_along_and_may_ask_but_not_fly(flown):
    port = int(flown.watchdog.observer_url.rpartition(":")[2])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as observer:
        observer.connect(("127.0.0.1", port))
        observer.settimeout(2.0)
        ask = mavlink.MAVLink_command_long_message(7, 1, 511, 0, 115.0, 10000.0, *[0.0] * 5)
        observer.send(setpoint(9.0))
        assert observer.recv(4096)  # so the autopilot has been heard: it has an address now
        observer.send(setpoint(9.0) + bytes(ask.pack(MAV)))
        assert wait_for(lambda: flown.peer.commands(511))
    assert not [s for s in flown.setpoints() if s.vx == 9.0]
    assert flown.socket.recv(4096)


def test_a_silent_navigator_is_braked_held_and_landed_and_then_left(flown):
    flown.engage()
    silent_s = time.monotonic()
    while asked_modes(flown.peer)[-1:] != [PX4_LAND]:
        flown.socket.send(setpoint(3.0))  # MAVSDK would go on like this
        time.sleep(0.02)
        assert time.monotonic() - silent_s < 6.0
    assert asked_modes(flown.peer) == [PX4_HOLD, PX4_LAND]
    taken_over = flown.setpoints(silent_s + 0.7)
    assert len(taken_over) >= 10
    assert all(is_still(s) for s in taken_over)
    assert flown.peer.of("COMMAND_LONG")[0].get_srcComponent() == 192
    quiet_s = time.monotonic() + 0.3
    time.sleep(0.8)
    assert not [m for m in flown.setpoints(quiet_s) + flown.peer.of("COMMAND_LONG", quiet_s)]


def test_a_navigator_that_wakes_up_regains_the_aircraft_only_by_saying_so(flown):
    flown.engage()
    time.sleep(0.8)
    flown.fly(0.3)
    assert flown.state() is GuardState.BRAKING
    assert not [s for s in flown.setpoints(time.monotonic() - 0.2) if s.vx]
    flown.keepalive.rejoin()
    rejoined_s = time.monotonic()
    flown.fly(0.3)
    assert flown.state() is GuardState.RELAY
    assert wait_for(lambda: [s for s in flown.setpoints(rejoined_s) if s.vx])


def test_a_pilot_who_took_over_is_never_disturbed(flown):
    flown.engage()
    flown.peer.custom_mode = PX4_POSITION
    time.sleep(2.5)
    assert asked_modes(flown.peer) == []
    assert all(s.vx == 3.0 for s in flown.setpoints())


def test_offboard_and_arming_are_refused_to_a_navigator_that_lost_the_aircraft(flown):
    flown.engage()
    time.sleep(0.7)
    offboard, land = (
        bytes(mavlink.MAVLink_command_long_message(7, 1, 176, 0, 1, *p, *[0] * 4).pack(MAV))
        for p in ((6, 0), (4, 6))
    )
    flown.socket.send(offboard)
    flown.socket.send(land)
    wait_for(lambda: PX4_LAND in asked_modes(flown.peer))
    assert PX4_OFFBOARD not in asked_modes(flown.peer)


def test_a_hold_that_is_refused_becomes_a_landing(flown):
    flown.peer.refuse = {mavlink.MAV_CMD_DO_SET_MODE: DENIED}
    flown.engage()
    wait_for(lambda: PX4_LAND in asked_modes(flown.peer))
    assert asked_modes(flown.peer)[:2] == [PX4_HOLD, PX4_LAND]


NAVIGATOR = """
import sys, time
from vwnav.watchdog.launch import start_watchdog
watchdog = start_watchdog(sys.argv[1])
print(watchdog.process.pid, flush=True)
while True:
    watchdog.keepalive.beat(True, "on route")
    time.sleep(0.05)
"""


def test_a_killed_navigator_leaves_a_watchdog_that_lands_and_ends_by_itself():
    port = free_port()
    command = [sys.executable, "-c", NAVIGATOR, f"udpin://127.0.0.1:{port}"]
    with Peer(port) as peer, subprocess.Popen(command, stdout=subprocess.PIPE) as navigator:
        peer.armed, peer.custom_mode, peer.landed_state = True, PX4_OFFBOARD, IN_AIR
        watchdog = int(navigator.stdout.readline())
        time.sleep(0.5)
        navigator.send_signal(signal.SIGKILL)
        wait_for(lambda: peer.custom_mode == PX4_LAND, 8.0)
        assert Path(f"/proc/{watchdog}").exists()
        peer.armed = False
        wait_for(lambda: not Path(f"/proc/{watchdog}").exists(), 4.0)


def spares() -> dict[int, str]:
    """Watchdogs of ours that wait behind one, and the processor time that each has used."""
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            words = (folder / "cmdline").read_bytes().split(b"\0")
            behind = int(words[words.index(b"--spare") + 1]) if b"--spare" in words else 0
            if behind and b"--parent" in words and str(os.getpid()).encode() in words:
                stat = (folder / "stat").read_text().rsplit(")", 1)[1].split()
                if int(stat[1]) == behind:  # one that has taken over has lost its parent
                    found[int(folder.name)] = f"{stat[11]} {stat[12]}"
    return found


def loaded_spares(wait: Callable[[float], None] = time.sleep) -> list[int]:
    """Those that have loaded what they need: idle for half a second, or nearly."""
    before = spares()
    wait(0.5)
    after = spares()

    def used(ticks: str) -> int:
        return sum(map(int, ticks.split()))

    both = [pid for pid in before if pid in after and used(before[pid]) > 0]
    return [pid for pid in both if used(after[pid]) - used(before[pid]) <= 1]


def test_a_watchdog_that_died_is_replaced_within_a_second_and_it_flies_on(flown):
    wait_for(loaded_spares, 20.0)
    flown.engage()
    dead = flown.watchdog.pid
    flown.watchdog.process.kill()
    began_s = time.monotonic()

    def guarded() -> bool:
        flown.keepalive.beat(True, "on route")
        return flown.watchdog.pid != dead

    wait_for(guarded)
    assert time.monotonic() - began_s < 1.0
    assert flown.keepalive.report.state is GuardState.RELAY
    replaced_s = time.monotonic()
    flown.fly(0.6)
    assert flown.state() is GuardState.RELAY
    assert len(flown.setpoints(replaced_s)) > 10


def killed_while_estimates_go(flown):
    wait_for(loaded_spares, 20.0)
    flown.estimates = True
    flown.fly(0.5)
    flown.engage()
    flown.fly(1.0)
    flown.watchdog.process.kill()


@pytest.mark.long
def test_a_spare_one_hands_on_estimates_that_are_unsure_but_go_on(flown):
    """The autopilot was given them all the time; they would not do as new ones."""
    killed_while_estimates_go(flown)
    flown.fly(1.0)
    again_s = time.monotonic()
    flown.fly(1.0)
    assert len(flown.peer.of("VISION_POSITION_ESTIMATE", again_s)) > 20


@pytest.mark.long
def test_a_spare_one_hands_no_estimate_on_that_has_jumped_meanwhile(flown):
    killed_while_estimates_go(flown)
    flown.jump_m = 30.0
    again_s = time.monotonic() + 0.1
    flown.fly(2.0)
    assert flown.peer.of("SET_POSITION_TARGET_LOCAL_NED", again_s)
    assert not flown.peer.of("VISION_POSITION_ESTIMATE", again_s)


def test_a_spare_one_is_started_though_the_log_cannot_be_opened_again(tmp_path):
    """As on a disk that stalls, where opening it waits."""
    folder, said = tmp_path / "card", []
    folder.mkdir()
    url = f"udpin://127.0.0.1:{free_port()}"
    with start_watchdog(url, folder / "watchdog.log", say=said.append) as watchdog:
        shutil.rmtree(folder)
        wait_for(loaded_spares, 20.0)
        watchdog.process.kill()

        def told() -> bool:
            watchdog.keepalive.beat(False)
            return bool(said)

        wait_for(told)
        wait_for(loaded_spares, 20.0)
    died = f"the watchdog (process {watchdog.process.pid}) has died"
    assert said == [f"{died}: another one has taken its place"]


def test_a_spare_one_that_was_ended_while_it_waited_is_followed_by_another(flown):
    """For want of memory, say; it is needed when the first one dies."""
    (ended,) = wait_for(loaded_spares, 20.0)
    os.kill(ended, signal.SIGKILL)
    wait_for(lambda: [each for each in loaded_spares() if each != ended], 20.0)
    flown.engage()
    flown.watchdog.process.kill()
    killed_s = time.monotonic()
    flown.fly(2.0)
    assert flown.state() is GuardState.RELAY
    assert len(flown.setpoints(killed_s + 1.0)) > 10


@pytest.mark.long
def test_one_after_the_other_may_die_while_it_flies_on(flown):
    for number in range(3):
        if not number:
            flown.engage()
        wait_for(lambda: loaded_spares(flown.fly), 20.0)
        os.kill(flown.watchdog.pid, signal.SIGKILL)
        flown.fly(1.5)
    assert flown.state() is GuardState.RELAY
    assert len(flown.setpoints(time.monotonic() - 0.5)) > 10


@pytest.mark.parametrize("number", first_quick([signal.SIGKILL, signal.SIGSTOP]))
def test_where_guard_and_spare_one_fail_together_the_navigator_starts_another(flown, number):
    """With estimates too, and with a spare one again."""
    flown.estimates, flown.sigma_m = True, 1.0
    waiting = wait_for(lambda: loaded_spares(flown.fly), 20.0)
    flown.engage()
    dead, failed_s = flown.watchdog.pid, time.monotonic()
    for each in (*waiting, dead):
        os.kill(each, number)
    while flown.watchdog.pid == dead and time.monotonic() < failed_s + 20.0:
        flown.fly(0.1)
    assert time.monotonic() - failed_s < 12.0
    flown.fly(2.0)
    assert flown.state() is GuardState.RELAY
    assert flown.keepalive.report.relays_estimates
    assert len(flown.setpoints(time.monotonic() - 0.5)) > 10
    assert wait_for(lambda: loaded_spares(flown.fly), 20.0)
    for each in waiting:
        with contextlib.suppress(ProcessLookupError):
            os.kill(each, signal.SIGKILL)


def test_spare_ones_that_die_again_and_again_are_no_longer_started_and_it_is_said():
    """Whoever flies knows then that the present one has nobody behind it."""
    said = []
    with start_watchdog(f"udpin://127.0.0.1:{free_port()}", say=said.append) as watchdog:
        killed = set()

        def none_waits() -> bool:
            watchdog.keepalive.beat(False)
            for each in spares():
                killed.add(each)
                with contextlib.suppress(ProcessLookupError):
                    os.kill(each, signal.SIGKILL)
            return bool(said)

        wait_for(none_waits, 30.0)
        assert len(killed) == MOST_STARTS
        assert said == [
            "spare watchdogs die again and again: the present watchdog is the last, land soon"
        ]
        watchdog.process.kill()

        def nobody_answers() -> bool:
            watchdog.keepalive.beat(False)
            return len(said) == 2

        wait_for(nobody_answers, 10.0)
        assert said[1].endswith("nobody guards the aircraft, be ready to take it over")

        def another_answers() -> bool:
            watchdog.keepalive.beat(False)
            return len(said) == 3

        wait_for(another_answers, 20.0)
    assert said[2].endswith("another one has taken its place")


def test_a_watchdog_that_hangs_is_ended_and_replaced(flown):
    wait_for(loaded_spares, 20.0)
    flown.engage()
    hung = flown.watchdog.pid
    flown.watchdog.process.send_signal(signal.SIGSTOP)
    flown.fly(5.0)
    assert flown.watchdog.process.poll() == -signal.SIGKILL
    assert flown.watchdog.pid != hung
    assert flown.state() is GuardState.RELAY
    assert len(flown.setpoints(time.monotonic() - 1.0)) > 10


@pytest.mark.long
def test_a_loop_that_slept_has_not_been_left_without_an_answer(flown):
    wait_for(loaded_spares, 20.0)
    flown.engage()
    process = flown.watchdog.pid
    time.sleep(6.0)
    flown.fly(1.0)
    assert flown.watchdog.pid == process


def test_a_watchdog_that_was_told_to_end_and_has_left_leaves_no_spare_one(flown):
    wait_for(lambda: flown.socket.recv(4096))  # the aircraft has been heard, on the ground
    told = flown.watchdog.process
    told.send_signal(signal.SIGTERM)
    wait_for(lambda: told.poll() is not None, 10.0)
    assert told.returncode == 0
    assert not spares()


def test_a_link_that_cannot_be_opened_is_one_clear_line():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        with pytest.raises(LinkError, match="another program"):
            start_watchdog(f"udpin://127.0.0.1:{taken.getsockname()[1]}")


@pytest.mark.long  # a busy machine's processor time is longer
@pytest.mark.alone
def test_the_relay_costs_little_at_the_rate_of_a_px4_link(flown):
    muted(flown)
    packet = bytes(mavlink.MAVLink_attitude_message(1, *[0.1] * 6).pack(MAV))
    used_s, start_s = cpu_s(flown.watchdog.process.pid), time.monotonic()
    for i in range(1300):  # 26 kB/s for two seconds
        flown.peer.socket.sendto(packet, flown.peer.to)
        time.sleep(max(0.0, start_s + i / 650 - time.monotonic()))
    assert cpu_s(flown.watchdog.process.pid) - used_s < 0.1 * (time.monotonic() - start_s)


def cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
