"""The dead-man watchdog: a process of its own that owns the link to the autopilot.

    python -m vwnav.watchdog --connection serial:///dev/ttyAMA0:921600 --navigator-port 14999

It relays between the autopilot and the navigator, which connects to
`udpout://127.0.0.1:NAVIGATOR_PORT`, and acts by `dead_man` when the navigator's control loop falls
silent (`keepalive`) or its process ends. On stdout one JSON line says that it is ready and which
ports it took. This module is the navigator's side of it, and the command line.
"""

import argparse
import json
import logging
import math
import os
import selectors
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import IO, TYPE_CHECKING

from vwnav.clock import Clock, WallClock
from vwnav.errors import LinkError
from vwnav.machine.never_waits import stderr_that_never_waits
from vwnav.machine.priority import go_first
from vwnav.machine.process_watch import ProcessWatch
from vwnav.watchdog.keepalive import KeepAlive, UdpChannel
from vwnav.watchdog.spare import MOST_STARTS, PROGRAM, LastWord, wait_behind

if TYPE_CHECKING:
    from vwnav.watchdog.process import WatchdogPorts

_log = logging.getLogger(__name__)
_READY_TIMEOUT_S = 60.0  # a busy machine takes 20; one that ends is noticed at once
_LEAVE_TIMEOUT_S = 4.0  # it waits for a heartbeat that says disarmed
_SILENT_S = 5.0  # without an answer: a spare one has been there by then, if there was one
_LOOKS_EVERY_S = 0.1
_HELD_S, _HELD_AGAIN_S = 10.0, 0.02  # by one that has died
_APPENDS = os.O_WRONLY | os.O_APPEND | os.O_CREAT

_UNGUARDED = "the watchdog does not answer: nobody guards the aircraft, be ready to take it over"
_THE_LAST = "spare watchdogs die again and again: the present watchdog is the last, land soon"


class WatchdogProcess:
    """A running watchdog, and whichever takes its place should it die or hang (`watchdog.spare`).

    Args:
        command: its command line.
        log: file for what it has to say; None leaves it on this process' stderr.
        clock: of the control loop.
        say: the attribute, at first.

    Attributes:
        process: the one that was started last from here.
        navigator_url: what the navigator's MAVSDK connects to instead of the autopilot.
        observer_url: where a second reader may listen along, a simulator's truth for one: a serial
            port, a TCP port and a UDP port that listens have one owner each.
        keepalive: to be beaten by the control loop.
        say: takes a line when it was replaced, or guards no more.

    Raises:
        LinkError: the link cannot be opened, or the process does not come up.
    """

    def __init__(
        self, command: Sequence[str], log: Path | None, clock: Clock, say: Callable[[str], None]
    ) -> None:
        self._command = list(command)
        # Opened once: whoever is started in its place waits for no disk.
        self._log = None if log is None else os.open(log, _APPENDS, 0o666)
        self.process = self._start()
        ports = _wait_for_ports(self.process)
        for name, port in ports.items():  # for one that is started in its place
            self._command += [f"--{name.replace('_', '-')}", str(port)]
        self.navigator_url = f"udpout://127.0.0.1:{ports['navigator_port']}"
        self.observer_url = f"udpout://127.0.0.1:{ports['observer_port']}"
        channel = UdpChannel(ports["keepalive_port"], listens=False)
        self.keepalive = KeepAlive(channel, clock)
        self.say, self._closing = say, False
        threading.Thread(target=self._tell_of_changes, name="watchdog", daemon=True).start()

    def __enter__(self) -> "WatchdogProcess":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def pid(self) -> int:
        """Of the one that answered last."""
        report = self.keepalive.last_report
        return self.process.pid if report is None else report.process

    def close(self) -> None:
        """Say that the navigator ends, and wait a moment.

        Whether the aircraft may be left alone is the watchdog's to judge: one that flies it lands
        it, and goes on by itself.
        """
        self._closing = True
        self.keepalive.close()
        watch, until_s = ProcessWatch(self.pid), time.monotonic() + _LEAVE_TIMEOUT_S
        while not watch.has_ended(now_s := time.monotonic()):
            if now_s > until_s:
                _log.warning("the watchdog (process %d) has the aircraft, it goes on", self.pid)
                break
            time.sleep(_LOOKS_EVERY_S)
        watch.close()
        self.process.poll()
        if self._log is not None:
            os.close(self._log)
            self._log = None

    def _start(self) -> subprocess.Popen[bytes]:
        # A session of its own: signals of the navigator's terminal are not for the watchdog.
        return subprocess.Popen(
            self._command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
            stderr=self._log, start_new_session=True,
        )  # fmt: skip

    def _start_again(self, before: ProcessWatch) -> None:
        """None is left, not even a spare one: the next knows no more than it will be sent."""
        before.end()
        self.process.poll()
        try:
            self.process = self._start()
            _wait_for_ports(self.process)
        except (LinkError, OSError) as error:
            _log.error("no watchdog can be started: %s", error)

    def _tell_of_changes(self) -> None:
        """To whoever is at the screen, which the control loop does not wait for.

        Where nobody answers any more, another one is started.
        """
        pid, is_silent, has_spare, again_s = self.pid, False, True, -math.inf
        guarding = ProcessWatch(pid)
        while not self._closing:
            time.sleep(_LOOKS_EVERY_S)
            if self.pid != pid:
                self.say(f"the watchdog (process {pid}) has died: another one has taken its place")
                guarding.close()
                pid = self.pid
                guarding = ProcessWatch(pid)
            report, was_silent = self.keepalive.last_report, is_silent
            is_silent = self.keepalive.unanswered_s > _SILENT_S
            if is_silent and not was_silent:
                self.say(_UNGUARDED)
            if is_silent and time.monotonic() >= again_s:
                self._start_again(guarding)
                again_s = time.monotonic() + _SILENT_S
            if report is not None and report.has_spare is not has_spare:
                has_spare = report.has_spare
                if not has_spare:
                    self.say(_THE_LAST)


def start_watchdog(
    connection: str,
    log: Path | None = None,
    standby: Sequence[str] = (),
    clock: Clock | None = None,
    say: Callable[[str], None] = _log.warning,
) -> WatchdogProcess:
    """Start the watchdog on the link `connection` and wait until it is ready.

    Args:
        connection: `udpin://`, `udpout://`, `tcpout://` or `serial://` URL of the autopilot.
        log: file for what it has to say; None leaves it on this process' stderr.
        standby: command line of a second navigator, for estimates alone, that takes over when
            this process ends in flight (see `watchdog.successor`); none when empty.
        clock: of the navigator, and of the watchdog; the wall's when None.
        say: takes a line when it had to be replaced.

    Raises:
        LinkError: the link cannot be opened, or the process does not come up.
    """
    arguments = [*PROGRAM, "--connection", connection]
    arguments += ["--parent", str(os.getpid()), "--standby", json.dumps(list(standby))]
    clock = clock if clock is not None else WallClock()
    if clock.file is not None:
        arguments += ["--clock-file", str(clock.file)]
    return WatchdogProcess(arguments, log, clock, say)


def _wait_for_ports(process: subprocess.Popen[bytes]) -> dict[str, int]:
    assert process.stdout is not None
    line = _first_line(process.stdout)
    try:
        answer = json.loads(line)
    except json.JSONDecodeError as error:
        process.kill()
        raise LinkError("the watchdog process does not start; its log says why") from error
    if "error" in answer:
        process.wait()
        raise LinkError(answer["error"])
    ports: dict[str, int] = answer["ready"]
    return ports


def _first_line(stdout: IO[bytes]) -> bytes:
    line, end_s = b"", time.monotonic() + _READY_TIMEOUT_S
    with selectors.DefaultSelector() as selector:
        selector.register(stdout, selectors.EVENT_READ)
        while not line.endswith(b"\n") and selector.select(end_s - time.monotonic()):
            data = os.read(stdout.fileno(), 4096)
            if not data:
                break
            line += data
    return line


def _parse_arguments(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m vwnav.watchdog", description=__doc__)
    parser.add_argument("--connection", required=True, help="link to the autopilot")
    parser.add_argument("--navigator-port", type=int, default=0, help="0: any free port")
    parser.add_argument("--keepalive-port", type=int, default=0, help="0: any free port")
    parser.add_argument("--observer-port", type=int, default=0, help="0: any free port")
    parser.add_argument("--parent", type=int, help="process id of the navigator")
    parser.add_argument(
        "--standby", type=json.loads, default=[], help="JSON list: command line of the successor"
    )
    parser.add_argument("--limit-s", type=float, default=900.0)
    parser.add_argument("--clock-file", default="", help="of a simulated time (vwnav.pace)")
    parser.add_argument("--spare", type=int, help="wait behind the one with this process id")
    parser.add_argument("--last-word", type=int, help="descriptor that it writes to what it knows")
    parser.add_argument("--starts-left", type=int, default=MOST_STARTS, help="of spare ones")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the process; the exit code is 1 when the link cannot be opened."""
    from vwnav.watchdog.process import WatchdogOptions, WatchdogPorts

    # Ctrl-C in the navigator's terminal is for the navigator: this process has to outlive it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    goes_first = go_first()
    logging.getLogger().setLevel(logging.INFO)
    # The log is on a disk, and while that one stalls nobody else lands the aircraft.
    with stderr_that_never_waits("vwnav watchdog: %(message)s"):
        if not goes_first:
            _log.info("no right to go before other processes: a busy machine holds the flight up")
        found = vars(_parse_arguments(sys.argv[1:] if arguments is None else arguments))
        spare, descriptor = found.pop("spare"), found.pop("last_word")
        if spare is not None:
            found["took_over"] = wait_behind(spare, LastWord(descriptor))
        try:
            watchdog = _opened(lambda: WatchdogPorts(WatchdogOptions(**found)), spare is not None)
        except LinkError as error:
            _log.error("%s", error)
            print(json.dumps({"error": str(error)}), flush=True)
            return 1
        print(json.dumps({"ready": watchdog.ports}), flush=True)
        watchdog.run()
        watchdog.close()  # not by one that raises: its spare one goes on with all that it had
        return 0


def _opened(opening: Callable[[], "WatchdogPorts"], again: bool) -> "WatchdogPorts":
    """One that has died may hold its ports for a moment longer, for a disk that it waits for.

    Raises:
        LinkError: the link or a port cannot be opened.
    """
    until_s = time.monotonic() + (_HELD_S if again else 0.0)
    while True:
        try:
            return opening()
        except LinkError:
            if time.monotonic() >= until_s:
                raise
            time.sleep(_HELD_AGAIN_S)
