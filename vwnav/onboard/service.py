"""What systemd is told where it has started us: that we are ready, live, do what, and end.

The protocol of sd_notify: a datagram of lines to the socket that NOTIFY_SOCKET names.
"""

import os
import socket
from collections.abc import Mapping
from contextlib import suppress
from time import monotonic

from vwnav.mission.mission import DeadMansHandle
from vwnav.vehicle import Learned
from vwnav.watchdog.keepalive import WatchdogReport

_EVERY_S = 1.0
_ENDING_S = 180.0  # for the files; the control loop beats no more


class ServiceManager:
    """What it is told; nothing where there is none.

    Args:
        environment: of the process.
    """

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        self._address = environment.get("NOTIFY_SOCKET", "")
        self._next_s = -1.0
        self._phase = ""

    @property
    def listens(self) -> bool:
        """Whether we are a service."""
        return bool(self._address)

    def live(self, phase: str) -> None:
        """Ready, alive, and doing this; said once a second and when it changes."""
        now_s = monotonic()
        if self._address and (now_s >= self._next_s or phase != self._phase):
            self._next_s, self._phase = now_s + _EVERY_S, phase
            self._tell(f"READY=1\nWATCHDOG=1\nSTATUS={phase}")

    def end(self) -> None:
        """It ends, and finishing the files may take its time."""
        if self._address:
            self._tell(f"STOPPING=1\nWATCHDOG_USEC={round(_ENDING_S * 1e6)}\nWATCHDOG=1")

    def _tell(self, lines: str) -> None:
        """Never waits, never fails: the control loop calls it."""
        address = "\0" + self._address[1:] if self._address[0] == "@" else self._address
        with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as channel:
            channel.setblocking(False)
            channel.sendto(lines.encode(), address)


class ServiceHandle:
    """A dead man's handle of which systemd feels each beat, too; the first says READY.

    Without a service manager it is the handle alone.

    Args:
        handle: the one to the watchdog.
        manager: of the services.
    """

    def __init__(self, handle: DeadMansHandle, manager: ServiceManager) -> None:
        self._handle = handle
        self._manager = manager

    @property
    def report(self) -> WatchdogReport | None:
        """The watchdog's newest answer."""
        return self._handle.report

    def beat(self, engaged: bool, phase: str, learned: Learned | None = None) -> None:
        """Say that the loop lives, whether it steers, and what a successor may begin with."""
        self._handle.beat(engaged, phase, learned)
        self._manager.live(phase)

    def rejoin(self) -> None:
        """Take the aircraft back from a watchdog that acts."""
        self._handle.rejoin()

    def leave(self) -> None:
        """Say that the navigator ends."""
        self._handle.leave()

    def end(self) -> None:
        """The control loop has ended; finishing the files may take its time."""
        self._manager.end()
