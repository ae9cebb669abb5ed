"""While its link is opened the watchdog goes on: names, connections and devices take seconds."""

import contextlib
import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from link_peer import PX4, PX4_OFFBOARD, wait_for
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from vwnav.watchdog.keepalive import KeepAlive, UdpChannel
from vwnav.watchdog.launch import WatchdogProcess, start_watchdog

HERE = Path(__file__).parent
AUTOPILOT = mavlink.MAVLink(None, srcSystem=7, srcComponent=1)
ANSWERS_S = 0.2  # a busy machine's slack included


@contextlib.contextmanager
def slow(url: str, free: int = 1, seconds: float = 3.0) -> Iterator[KeepAlive]:
    """A watchdog on `url`, and its navigator's sign of life; later openings take `seconds`."""
    script = [sys.executable, str(HERE / "slow_opening.py"), str(free), str(seconds)]
    arguments = ["--connection", url, "--starts-left", "0"]  # nobody follows who is killed
    with subprocess.Popen([*script, *arguments], stdout=subprocess.PIPE) as process:
        ports = json.loads(process.stdout.readline())["ready"]
        keepalive = KeepAlive(UdpChannel(ports["keepalive_port"], False), time.monotonic)
        try:
            answered_after_s(keepalive)
            yield keepalive
        finally:
            process.kill()
            keepalive.close()


def answered_after_s(keepalive: KeepAlive) -> float:
    """From a beat to its answer."""
    last, beaten_s = keepalive.report, time.monotonic()
    keepalive.beat(True, "on route")
    wait_for(lambda: keepalive.report is not last, 10.0)
    return time.monotonic() - beaten_s


def longest_answer_s(keepalive: KeepAlive, seconds: float) -> float:
    until_s, longest_s = time.monotonic() + seconds, 0.0
    while time.monotonic() < until_s:
        longest_s = max(longest_s, answered_after_s(keepalive))
        time.sleep(0.02)
    return longest_s


def test_a_name_that_is_looked_up_for_long_keeps_nobody_waiting():
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        slow(f"tcpout://localhost:{server.getsockname()[1]}") as keepalive,
    ):
        server.accept()[0].close()
        assert longest_answer_s(keepalive, 3.0) < ANSWERS_S


def test_a_far_end_that_does_not_answer_keeps_nobody_waiting():
    with (
        socket.create_server(("127.0.0.1", 0), backlog=0) as server,
        slow(f"tcpout://127.0.0.1:{server.getsockname()[1]}", 99) as keepalive,
        contextlib.ExitStack() as stack,
    ):
        first, _ = server.accept()
        for _ in range(4):  # more than may wait there: the watchdog's call is dropped
            other = stack.enter_context(socket.socket())
            other.setblocking(False)
            other.connect_ex(server.getsockname())
        first.close()
        assert longest_answer_s(keepalive, 3.0) < ANSWERS_S


def test_a_device_that_is_opened_for_long_keeps_nobody_waiting(tmp_path):
    master, slave = os.openpty()
    (tmp_path / "tty").symlink_to(os.ttyname(slave))
    with slow(f"serial://{tmp_path}/tty:57600") as keepalive:
        os.close(master)
        assert longest_answer_s(keepalive, 3.0) < ANSWERS_S


class Bridge:
    """A TCP server with an autopilot in Offboard behind it, that can be away."""

    def __init__(self) -> None:
        self.server = socket.create_server(("127.0.0.1", 0))
        self.port = self.server.getsockname()[1]
        self.client, _ = None, None

    def come_back(self) -> None:
        self.server = socket.create_server(("127.0.0.1", self.port))

    def let_in(self) -> None:
        self.server.settimeout(10.0)
        self.client, _ = self.server.accept()

    def go_away(self) -> None:
        self.server.close()
        self.client.close()

    def speak(self) -> None:
        beat = mavlink.MAVLink_heartbeat_message(2, PX4, 129, PX4_OFFBOARD, 4, 3)
        self.client.sendall(bytes(beat.pack(AUTOPILOT)))


def beats_until(watchdog: WatchdogProcess, condition: Callable[[], bool]) -> None:
    def look() -> bool:
        watchdog.keepalive.beat(True, "on route")
        time.sleep(0.02)
        return condition()

    wait_for(look, 10.0)


def test_a_spare_one_comes_up_while_its_link_cannot_be_opened_and_opens_it_later():
    bridge, said = Bridge(), []
    with start_watchdog(f"tcpout://127.0.0.1:{bridge.port}", say=said.append) as watchdog:
        bridge.let_in()
        beats_until(watchdog, lambda: watchdog.keepalive.report is not None)
        time.sleep(3.0)  # the spare one has loaded
        first = watchdog.pid
        bridge.go_away()
        watchdog.process.kill()
        beats_until(watchdog, lambda: watchdog.pid != first)
        second = watchdog.pid
        bridge.come_back()
        bridge.let_in()
        bridge.speak()
        bridge.client.settimeout(5.0)
        assert bridge.client.recv(4096)
        beats_until(watchdog, lambda: watchdog.keepalive.report is not None)
        assert watchdog.pid == second
        wait_for(lambda: said)
    assert len(said) == 1
