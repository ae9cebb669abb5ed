"""What systemd hears of a flight, and what it is told to do about it."""

import configparser
import os
import shutil
import socket
import subprocess
from pathlib import Path

import pytest

from vwnav.onboard import service
from vwnav.onboard.service import ServiceHandle, ServiceManager

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"


class Handle:
    """A dead man's handle that remembers."""

    report = None

    def __init__(self) -> None:
        self.beats: list[tuple[bool, str]] = []
        self.rejoins = 0

    def beat(self, engaged: bool, phase: str, learned: object) -> None:
        self.beats.append((engaged, phase))

    def rejoin(self) -> None:
        self.rejoins += 1


def listener(address: str) -> socket.socket:
    channel = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    channel.bind(address)
    channel.setblocking(False)
    return channel


def heard(channel: socket.socket) -> list[str]:
    told = []
    while True:
        try:
            told.append(channel.recv(4096).decode())
        except BlockingIOError:
            return told


def test_the_control_loops_beats_reach_systemd_once_a_second_and_with_each_phase(
    tmp_path, monkeypatch
):
    now_s = [100.0]
    monkeypatch.setattr(service, "monotonic", lambda: now_s[0])
    path, inner = str(tmp_path / "notify"), Handle()
    with listener(path) as channel:
        handle = ServiceHandle(inner, ServiceManager({"NOTIFY_SOCKET": path}))
        assert heard(channel) == []  # not ready before the loop runs
        for _ in range(40):
            handle.beat(False, "getting ready")
            now_s[0] += 0.05
        assert heard(channel) == ["READY=1\nWATCHDOG=1\nSTATUS=getting ready"] * 2
        handle.beat(True, "climbing")
        assert heard(channel) == ["READY=1\nWATCHDOG=1\nSTATUS=climbing"]
        handle.end()
        assert heard(channel) == ["STOPPING=1\nWATCHDOG_USEC=180000000\nWATCHDOG=1"]
    handle.beat(True, "landing")  # systemd is gone: the flight goes on
    handle.rejoin()
    assert inner.beats[-2:] == [(True, "climbing"), (True, "landing")]
    assert (len(inner.beats), inner.rejoins) == (42, 1)


def test_an_abstract_socket_is_found():
    name = f"vwnav test {os.getpid()}"
    with listener("\0" + name) as channel:
        ServiceHandle(Handle(), ServiceManager({"NOTIFY_SOCKET": "@" + name})).beat(False, "x")
        assert len(heard(channel)) == 1


def test_without_a_service_manager_nothing_is_told():
    inner = Handle()
    handle = ServiceHandle(inner, ServiceManager({}))
    handle.beat(True, "climbing")
    handle.end()
    assert inner.beats == [(True, "climbing")]


def test_the_unit_never_ends_the_watchdog_and_leaves_time_to_land():
    unit = configparser.ConfigParser(strict=False, interpolation=None)
    unit.optionxform = str
    unit.read(DEPLOY / "vwnav.service")
    flying = unit["Service"]
    assert (flying["KillMode"], flying["Type"], flying["User"]) == ("process", "notify", "vwnav")
    assert int(flying["TimeoutStopSec"]) >= 180  # docs/flying.md, section 6
    assert flying["Restart"] == "on-abnormal"  # what ended with a reason is not flown again


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="needs systemd-analyze")
def test_systemd_understands_the_unit(tmp_path):
    text = (DEPLOY / "vwnav.service").read_text().replace("/opt/vwnav/bin/vwnav", "/bin/true")
    (tmp_path / "vwnav.service").write_text(text)
    done = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", str(tmp_path / "vwnav.service")],
        capture_output=True, text=True,
    )  # fmt: skip
    complaints = [line for line in done.stderr.splitlines() if "vwnav.service" in line]
    assert complaints == []
