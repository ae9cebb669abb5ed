"""The dead-man watchdog: a process of its own that owns the link to the autopilot.

    python -m vwnav.safety.watchdog --connection serial:///dev/ttyAMA0:921600 --navigator-port 14999

It relays between the autopilot and the navigator, which connects to
`udpout://127.0.0.1:NAVIGATOR_PORT`, and acts by `dead_man` when the navigator's control loop falls
silent (`keepalive`) or its process ends. On stdout one JSON line says that it is ready and which
ports it took. This module is the navigator's side of it, and the command line.
"""

import argparse
import json
import logging
import os
import selectors
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO

from vwnav.clock import Clock, WallClock
from vwnav.errors import LinkError
from vwnav.safety.keepalive import KeepAlive, UdpChannel

_log = logging.getLogger(__name__)
_READY_TIMEOUT_S = 60.0  # a busy machine takes 20; one that ends is noticed at once
_LEAVE_TIMEOUT_S = 4.0  # it waits for a heartbeat that says disarmed
_ANSWERS_WITHIN_S = 2.0


@dataclass
class WatchdogProcess:
    """A running watchdog.

    Attributes:
        navigator_url: what the navigator's MAVSDK connects to instead of the autopilot.
        observer_url: where a second reader may listen along, a simulator's truth for one: a serial
            port, a TCP port and a UDP port that listens have one owner each.
        keepalive: to be beaten by the control loop.
    """

    process: subprocess.Popen[bytes]
    navigator_url: str
    observer_url: str
    keepalive: KeepAlive

    def is_running(self) -> bool:
        """It lives and answers: a process that is stopped or hangs guards nobody."""
        return self.process.poll() is None and self.keepalive.silence_s < _ANSWERS_WITHIN_S

    def __enter__(self) -> "WatchdogProcess":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Say that the navigator ends, and wait a moment.

        Whether the aircraft may be left alone is the watchdog's to judge: one that flies it lands
        it, and goes on by itself.
        """
        self.keepalive.close()
        try:
            self.process.wait(_LEAVE_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            _log.warning("the watchdog (process %d) has the aircraft, it goes on", self.process.pid)


def start_watchdog(
    connection: str,
    log: Path | None = None,
    standby: Sequence[str] = (),
    clock: Clock | None = None,
) -> WatchdogProcess:
    """Start the watchdog on the link `connection` and wait until it is ready.

    Args:
        connection: `udpin://`, `udpout://`, `tcpout://` or `serial://` URL of the autopilot.
        log: file for what it has to say; None leaves it on this process' stderr.
        standby: command line of a second navigator, for estimates alone, that takes over when
            this process ends in flight (see `watchdog_successor`); none when empty.
        clock: of the navigator, and of the watchdog; the wall's when None.

    Raises:
        LinkError: the link cannot be opened, or the process does not come up.
    """
    arguments = [sys.executable, "-m", "vwnav.safety.watchdog", "--connection", connection]
    arguments += ["--parent", str(os.getpid()), "--standby", json.dumps(list(standby))]
    clock = clock if clock is not None else WallClock()
    if clock.file is not None:
        arguments += ["--clock-file", str(clock.file)]
    stderr = log.open("ab") if log is not None else None
    try:
        # A session of its own: signals of the navigator's terminal are not for the watchdog.
        process = subprocess.Popen(
            arguments, stdout=subprocess.PIPE, stderr=stderr, start_new_session=True
        )
    finally:
        if stderr is not None:
            stderr.close()
    assert process.stdout is not None
    with process.stdout as stdout:
        ports = _wait_for_ports(process, stdout)
    navigator_url = f"udpout://127.0.0.1:{ports['navigator_port']}"
    observer_url = f"udpout://127.0.0.1:{ports['observer_port']}"
    keepalive = KeepAlive(UdpChannel(ports["keepalive_port"], listens=False), clock)
    return WatchdogProcess(process, navigator_url, observer_url, keepalive)


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


def _parse_arguments(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m vwnav.safety.watchdog", description=__doc__)
    parser.add_argument("--connection", required=True, help="link to the autopilot")
    parser.add_argument("--navigator-port", type=int, default=0, help="0: any free port")
    parser.add_argument("--keepalive-port", type=int, default=0, help="0: any free port")
    parser.add_argument("--parent", type=int, help="process id of the navigator")
    parser.add_argument(
        "--standby", type=json.loads, default=[], help="JSON list: command line of the successor"
    )
    parser.add_argument("--limit-s", type=float, default=900.0)
    parser.add_argument("--clock-file", default="", help="of a simulated time (vwnav.pace)")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the process; the exit code is 1 when the link cannot be opened."""
    from vwnav.safety import watchdog_process  # pymavlink: not for the navigator

    logging.basicConfig(level=logging.INFO, format="vwnav watchdog: %(message)s")
    # Ctrl-C in the navigator's terminal is for the navigator: this process has to outlive it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        found = _parse_arguments(sys.argv[1:] if arguments is None else arguments)
        options = watchdog_process.WatchdogOptions(**vars(found))
        watchdog = watchdog_process.WatchdogPorts(options)
    except LinkError as error:
        print(json.dumps({"error": str(error)}), flush=True)
        return 1
    print(json.dumps({"ready": watchdog.ports}), flush=True)
    try:
        watchdog.run()
    finally:
        watchdog.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
