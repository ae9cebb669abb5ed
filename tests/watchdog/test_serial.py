"""The watchdog's process on a serial line, here a pseudo-terminal: bytes both ways, and a pull."""

import contextlib
import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from link_peer import PX4, PX4_HOLD, wait_for
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from vwnav.mavlink.framing import Framer

ATTITUDE, QUESTION = mavlink.MAVLINK_MSG_ID_ATTITUDE, mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ
AUTOPILOT = mavlink.MAVLink(None, srcSystem=7, srcComponent=1)
NAVIGATOR = mavlink.MAVLink(None, srcSystem=245, srcComponent=191)


class Stand:
    """A navigator and an autopilot with a watchdog and a serial adapter between them."""

    def __init__(self, name: Path) -> None:
        self.name = name
        self.plug_in()
        command = [sys.executable, "-m", "vwnav.watchdog", "--connection", f"serial://{name}:57600"]
        command += ["--starts-left", "0"]  # nobody follows who is killed
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE)
        assert self.process.stdout is not None
        port = json.loads(self.process.stdout.readline())["ready"]["navigator_port"]
        self.navigator = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.navigator.connect(("127.0.0.1", port))
        self.navigator.setblocking(False)
        self.hears_down, self.hears_up = Framer(), Framer()

    def plug_in(self) -> None:
        self.far, slave = os.openpty()
        os.set_blocking(self.far, False)
        self.name.unlink(missing_ok=True)
        self.name.symlink_to(os.ttyname(slave))
        self.sent = self.down = self.up = 0

    def speak(self) -> bool:
        """Both say something, and hear what has come; whether anything has come both ways."""
        beat = mavlink.MAVLink_heartbeat_message(2, PX4, 1, PX4_HOLD, 4, 3)
        attitude = mavlink.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0)
        os.write(self.far, bytes(beat.pack(AUTOPILOT)) + bytes(attitude.pack(AUTOPILOT)))
        question = mavlink.MAVLink_param_request_read_message(7, 1, b"X", -1)
        self.navigator.send(bytes(question.pack(NAVIGATOR)))
        self.sent += 1
        time.sleep(0.02)
        self.down += count(self.hears_down, ATTITUDE, lambda: self.navigator.recv(4096))
        self.up += count(self.hears_up, QUESTION, lambda: os.read(self.far, 4096))
        return bool(self.down and self.up)

    def carries_all(self) -> bool:
        """Whether what is said for a second comes through; the last may be on its way."""
        wait_for(self.speak)
        self.sent = self.down = self.up = 0
        until_s = time.monotonic() + 1.0
        while time.monotonic() < until_s:
            self.speak()
        return min(self.down, self.up) >= self.sent - 3


def count(framer: Framer, number: int, receive: Callable[[], bytes]) -> int:
    found = 0
    with contextlib.suppress(BlockingIOError):
        while data := receive():
            found += sum(packet.message_id == number for packet in framer.split(data))
    return found


@pytest.fixture
def stand(tmp_path: Path) -> Iterator[Stand]:
    stand = Stand(tmp_path / "tty")
    yield stand
    stand.process.kill()
    stand.process.wait()
    stand.navigator.close()


def test_a_serial_line_carries_all_that_is_said_both_ways(stand):
    assert stand.carries_all()


def test_a_serial_adapter_that_is_pulled_out_and_put_back_carries_again(stand):
    assert stand.carries_all()
    os.close(stand.far)
    time.sleep(0.5)
    stand.plug_in()
    assert stand.carries_all()
