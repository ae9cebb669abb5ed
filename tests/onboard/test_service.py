"""What systemd hears of a flight, and what it is told to do about it."""

import configparser
import os
import shutil
import socket
import subprocess
from contextlib import ExitStack
from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace

import pytest

import vwnav.__main__ as command
from vwnav.errors import FlightError, LinkError, PreflightError
from vwnav.mission.mission import FlightEnd, Phase
from vwnav.onboard import program, service
from vwnav.onboard.aboard import Aboard
from vwnav.onboard.options import FlyOptions
from vwnav.onboard.service import FlightFolder, ServiceHandle, ServiceManager

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


def unit() -> configparser.ConfigParser:
    read = configparser.ConfigParser(strict=False, interpolation=None)
    read.optionxform = str
    read.read(DEPLOY / "vwnav.service")
    return read


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
    flying = unit()["Service"]
    assert (flying["KillMode"], flying["Type"], flying["User"]) == ("process", "notify", "vwnav")
    assert int(flying["TimeoutStopSec"]) >= 180  # docs/flying.md, section 6


@pytest.mark.parametrize(
    ("ended", "restarts"),
    [
        (LinkError("no autopilot"), True),
        (PreflightError("not ready to fly after 90 s"), True),
        (FlightError("the aircraft was disarmed while on route"), False),
        (KeyboardInterrupt(), False),
        (SystemExit(2), False),  # a wrong command line
        (None, False),
    ],
)
def test_what_may_come_good_is_started_anew_and_no_flight_that_ended(monkeypatch, ended, restarts):
    def run() -> None:
        if ended is not None:
            raise ended

    monkeypatch.setattr(command, "_run", run)
    monkeypatch.setenv("NOTIFY_SOCKET", "/run/systemd/notify")
    code: int | str | None = 0
    try:
        command.main()
    except SystemExit as end:
        code = end.code
    flying = unit()["Service"]
    assert flying["Restart"] == "on-failure"  # or killed, or silent
    refused = map(int, flying["RestartPreventExitStatus"].split())
    assert (code != 0 and code not in refused) is restarts


def test_without_a_service_a_flight_that_ended_is_a_failure_as_any_other(monkeypatch):
    def run() -> None:
        raise FlightError("the aircraft was disarmed while on route")

    monkeypatch.setattr(command, "_run", run)
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    with pytest.raises(SystemExit) as end:
        command.main()
    assert end.value.code == 1


def test_it_is_started_anew_however_often_and_after_a_pause():
    assert unit()["Unit"]["StartLimitIntervalSec"] == "0"
    assert 1 <= int(unit()["Service"]["RestartSec"]) <= 10


@pytest.mark.parametrize(
    ("end", "error"),
    [
        (FlightEnd("not ready to fly after 90 s: no attitude", unsafe=True), PreflightError),
        (FlightEnd("the aircraft was disarmed before it took off"), FlightError),
        (FlightEnd("interrupted by the operator: landing"), FlightError),
    ],
)
def test_only_what_never_began_is_an_end_that_may_come_good(end, error):
    with pytest.raises(error, match=end.reason):
        program._raise_reason(end, "")


def test_a_service_never_arms_by_itself(monkeypatch):
    heard = []
    monkeypatch.setattr(program, "say", heard.append)
    wanted = {each.name: None for each in fields(FlyOptions)} | {"sim": False, "rejoined": False}
    options = FlyOptions(**{**wanted, "arm": True})
    service = ServiceManager({"NOTIFY_SOCKET": "/run/notify"})
    assert not program._left_to_a_person(options, service).arms
    assert heard == ["--arm is not heeded: a service never arms by itself, a person does"]
    assert program._left_to_a_person(options, ServiceManager({})).arms


@pytest.mark.parametrize(
    ("phase", "engaged", "ended"),
    [
        (Phase.GET_READY, False, False),
        (Phase.GET_READY, True, True),  # motors were asked to start
        (Phase.ROUTE, True, True),
        (Phase.LAND, False, True),
    ],
)
def test_what_breaks_once_motors_may_run_ends_the_flight(phase, engaged, ended):
    def run(_source, _clock):
        raise ZeroDivisionError

    aboard = Aboard(SimpleNamespace(phase=phase, engaged=engaged), SimpleNamespace(run=run))
    if ended:
        assert program._end_of(aboard, None, None).reason == "ZeroDivisionError()"
        return
    with pytest.raises(ZeroDivisionError):
        program._end_of(aboard, None, None)


def raised_in_a_stack(error, callback):
    with ExitStack() as stack:
        stack.push(callback)
        raise error


def test_what_follows_a_flight_that_broke_off_ends_for_good():
    with pytest.raises(FlightError, match="not heard"):
        raised_in_a_stack(LinkError("not heard"), program._ends_for_good)


@pytest.mark.parametrize(
    ("error", "left"),
    [(LinkError, False), (PreflightError, False), (FlightError, True), (MemoryError, True)],
)
def test_a_try_that_never_began_leaves_no_folder_behind(tmp_path, error, left):
    folder = tmp_path / "fly-20261127-120000"
    folder.mkdir()
    with pytest.raises(error):
        raised_in_a_stack(error("it ended"), FlightFolder(folder, True).leave)
    assert folder.exists() is left


def test_of_tries_that_break_again_and_again_the_last_one_is_kept_and_no_flight_goes(
    tmp_path, capsys
):
    flight, mine = tmp_path / "fly-20261127-110000", tmp_path / "broken"
    for each in (flight, mine):
        each.mkdir()
    (mine / "traceback.txt").touch()  # a person's own
    for second in range(3):
        folder = tmp_path / f"fly-20261127-12000{second}"
        folder.mkdir()
        with pytest.raises(ZeroDivisionError):
            raised_in_a_stack(ZeroDivisionError("of that"), FlightFolder(folder, True).leave)
    assert {each.name for each in tmp_path.iterdir()} == {flight.name, mine.name, folder.name}
    assert "ZeroDivisionError: of that" in (folder / "traceback.txt").read_text()
    assert f"{folder} keeps why" in capsys.readouterr().err


@pytest.mark.parametrize("error", [LinkError, ZeroDivisionError])
@pytest.mark.parametrize(("tried_again", "began"), [(True, True), (False, False)])
def test_a_flight_and_what_is_no_service_keep_what_they_left(tmp_path, error, tried_again, began):
    folder = tmp_path / "fly-20261127-120000"
    folder.mkdir()
    held = FlightFolder(folder, tried_again)
    held.began = began
    with pytest.raises(error):
        raised_in_a_stack(error("it ended"), held.leave)
    assert list(tmp_path.iterdir()) == [folder]
    assert list(folder.iterdir()) == []


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
