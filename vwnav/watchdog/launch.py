"""The dead-man watchdog: a process of its own that owns the link to the autopilot.

    python -m vwnav.watchdog --connection serial:///dev/ttyAMA0:921600 --navigator-port 14999

It relays between the autopilot and the navigator, which connects to
`udpout://127.0.0.1:NAVIGATOR_PORT`, and acts by `dead_man` when the navigator's control loop falls
silent (`keepalive`) or its process ends. On stdout one JSON line says that it is ready and which
ports it took. This module is the navigator's side of it, and the command line.
"""

import argparse
import contextlib
import json
import logging
import os
import selectors
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import IO

from vwnav.clock import Clock, WallClock
from vwnav.errors import LinkError
from vwnav.machine.never_waits import stderr_that_never_waits
from vwnav.machine.priority import go_first
from vwnav.watchdog.keepalive import HANGS_S, KeepAlive, UdpChannel

_log = logging.getLogger(__name__)
_READY_TIMEOUT_S = 60.0  # a busy machine takes 20; one that ends is noticed at once
_LEAVE_TIMEOUT_S = 4.0  # it waits for a heartbeat that says disarmed
_MOST_DEATHS = 5
_COMES_UP_S = 5.0  # until then it is not expected to answer
_LOOKS_EVERY_S = 0.25


class WatchdogProcess:
    """A running watchdog, and a spare one that takes its place at once should it die or hang.

    A second of silence on the link is what an autopilot flies its failsafe for, and a process takes
    that long to start: so the spare has loaded what it needs and waits.

    Args:
        command: its command line.
        log: file for what it has to say; None leaves it on this process' stderr.
        clock: of the control loop.
        say: takes a line when it had to be replaced.

    Attributes:
        process: the present one.
        navigator_url: what the navigator's MAVSDK connects to instead of the autopilot.
        observer_url: where a second reader may listen along, a simulator's truth for one: a serial
            port, a TCP port and a UDP port that listens have one owner each.
        keepalive: to be beaten by the control loop.

    Raises:
        LinkError: the link cannot be opened, or the process does not come up.
    """

    def __init__(
        self, command: Sequence[str], log: Path | None, clock: Clock, say: Callable[[str], None]
    ) -> None:
        self._command = list(command)
        # Once: while the disk stalls, opening it again would keep the next spare one from starting.
        self._log = log.open("ab") if log is not None else None
        self._say = say
        self._closing = False
        self.process = self._start([])
        assert self.process.stdout is not None
        self._ports = _wait_for_ports(self.process, self.process.stdout)
        self.navigator_url = f"udpout://127.0.0.1:{self._ports['navigator_port']}"
        self.observer_url = f"udpout://127.0.0.1:{self._ports['observer_port']}"
        channel = UdpChannel(self._ports["keepalive_port"], listens=False)
        self.keepalive = KeepAlive(channel, clock)
        self._spare, self._spares_left = self._start(["--spare"]), _MOST_DEATHS
        threading.Thread(target=self._replace_the_dead, name="watchdog", daemon=True).start()

    def __enter__(self) -> "WatchdogProcess":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Say that the navigator ends, and wait a moment.

        Whether the aircraft may be left alone is the watchdog's to judge: one that flies it lands
        it, and goes on by itself.
        """
        self._closing = True
        self.keepalive.close()
        _end_spare(self._spare)
        if self._log is not None:
            self._log.close()
        try:
            self.process.wait(_LEAVE_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            _log.warning("the watchdog (process %d) has the aircraft, it goes on", self.process.pid)

    def _start(self, more: Sequence[str]) -> subprocess.Popen[bytes]:
        # A session of its own: signals of the navigator's terminal are not for the watchdog.
        return subprocess.Popen(
            [*self._command, *more], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=self._log, start_new_session=True,
        )  # fmt: skip

    def _replace_the_dead(self) -> None:
        for _ in range(_MOST_DEATHS):
            code = self._wait_for_its_end()
            if self._closing or code == 0:  # it was told to end, has landed what flew, and left
                return
            self._say(f"the watchdog has died (code {code}): another one takes its place")
            self.process, spare = self._spare, self._spare
            assert spare.stdin is not None
            with contextlib.suppress(OSError):  # it has died too: the next turn sees it
                spare.stdin.write(self._handover().encode() + b"\n")
                spare.stdin.flush()
            if not self._start_spare():
                return
        self._say("watchdogs die again and again: nobody guards the aircraft any more")

    def _start_spare(self) -> bool:
        try:
            self._spare = self._start(["--spare"])
        except OSError as error:
            self._say(f"no spare watchdog can be started, the present one is the last: {error}")
            return False
        return True

    def _keep_a_spare(self) -> None:
        """One may be ended while it waits, where memory is short."""
        if self._spare.poll() is None or self._closing or not self._spares_left:
            return
        self._spares_left -= 1
        if not self._spares_left:
            self._say("spare watchdogs die again and again: none waits any more")
            return
        self._say("the spare watchdog has died: another one is started")
        if not self._start_spare():
            self._spares_left = 0

    def _handover(self) -> str:
        """The line with which the spare one takes over: `WatchdogOptions` that it has not got."""
        told = self.keepalive.handed_on
        goes_on = "" if told is None else told.pack().hex()
        known = {"goes_on": goes_on, "silent_s": self.keepalive.unanswered_s}
        return json.dumps({**self._ports, "takes_over": True, **known})

    def _wait_for_its_end(self) -> int:
        """Its exit status. One that lives and does not answer guards nobody: it is killed."""
        due_s = time.monotonic() + _COMES_UP_S
        while True:
            try:
                return self.process.wait(_LOOKS_EVERY_S)
            except subprocess.TimeoutExpired:
                self._keep_a_spare()
                hangs = self.keepalive.unanswered_s > HANGS_S and time.monotonic() > due_s
                if hangs and not self._closing:
                    self._say(f"the watchdog has not answered for {HANGS_S:.0f} s: it is ended")
                    self.process.kill()
                    return self.process.wait()


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
    arguments = [sys.executable, "-m", "vwnav.watchdog", "--connection", connection]
    arguments += ["--parent", str(os.getpid()), "--standby", json.dumps(list(standby))]
    clock = clock if clock is not None else WallClock()
    if clock.file is not None:
        arguments += ["--clock-file", str(clock.file)]
    return WatchdogProcess(arguments, log, clock, say)


def _wait_for_ports(process: subprocess.Popen[bytes], stdout: IO[bytes]) -> dict[str, int]:
    line = _first_line(stdout)
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


def _end_spare(spare: subprocess.Popen[bytes]) -> None:
    assert spare.stdin is not None
    with contextlib.suppress(OSError):
        spare.stdin.close()
    with contextlib.suppress(subprocess.TimeoutExpired):
        spare.wait(_LEAVE_TIMEOUT_S)


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
    parser.add_argument("--spare", action="store_true", help="waits for its ports on stdin")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the process; the exit code is 1 when the link cannot be opened."""
    from vwnav.watchdog import process as watchdog_process

    # Ctrl-C in the navigator's terminal is for the navigator: this process has to outlive it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    goes_first = go_first()
    logging.getLogger().setLevel(logging.INFO)
    # The log is on a disk, and while that one stalls nobody else lands the aircraft.
    with stderr_that_never_waits("vwnav watchdog: %(message)s"):
        if not goes_first:
            _log.info("no right to go before other processes: a busy machine holds the flight up")
        found = vars(_parse_arguments(sys.argv[1:] if arguments is None else arguments))
        if found.pop("spare"):
            line = sys.stdin.readline()
            if not line:
                return 0  # the navigator has ended and the first one is still there
            found |= json.loads(line)
        try:
            watchdog = watchdog_process.WatchdogPorts(watchdog_process.WatchdogOptions(**found))
        except LinkError as error:
            print(json.dumps({"error": str(error)}), flush=True)
            return 1
        print(json.dumps({"ready": watchdog.ports}), flush=True)
        try:
            watchdog.run()
        finally:
            watchdog.close()
        return 0
