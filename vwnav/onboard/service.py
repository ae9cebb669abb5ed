"""What systemd is told where it has started us: that we are ready, live, do what, and end.

The protocol of sd_notify: a datagram of lines to the socket that NOTIFY_SOCKET names.
"""

import os
import shutil
import socket
import traceback
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from time import monotonic

from vwnav.errors import FlightError, VwnavError
from vwnav.mission.mission import DeadMansHandle
from vwnav.recording.disk.budget import flights_in
from vwnav.screen import say
from vwnav.vehicle import Learned
from vwnav.watchdog.keepalive import WatchdogReport

_EVERY_S = 1.0
_ENDING_S = 180.0  # for the files; the control loop beats no more
_BROKE = "traceback.txt"  # in the folder of a try that broke


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


class FlightFolder:
    """A flight's folder; what is tried anew every few seconds may not fill the disk.

    A service's try that never began leaves nothing where it says why in a line. One that broke
    otherwise leaves its folder with the traceback, in the place of the one before it.

    Args:
        folder: of the run.
        is_tried_again: by the service manager, if it does not begin (`deploy/vwnav.service`).

    Attributes:
        began: whether motors may have run.
    """

    def __init__(self, folder: Path, is_tried_again: bool) -> None:
        self.folder, self.is_tried_again = folder, is_tried_again
        self.began = False

    def leave(self, _kind: object, error: BaseException | None, _traceback: object) -> None:
        """For a stack, as its outermost: what is left in the end."""
        if self.began or not self.is_tried_again or not isinstance(error, Exception):
            return
        if isinstance(error, FlightError):
            return
        if isinstance(error, VwnavError):
            shutil.rmtree(self.folder, ignore_errors=True)
            return
        for each in flights_in(self.folder.parent):
            if each.name != self.folder.name and (each / _BROKE).exists():
                shutil.rmtree(each, ignore_errors=True)
        with suppress(OSError):
            (self.folder / _BROKE).write_text("".join(traceback.format_exception(error)))
        say(f"it broke before the flight: {self.folder} keeps why, of the last such try alone")
