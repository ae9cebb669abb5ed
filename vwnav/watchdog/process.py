"""The watchdog's process around `Watchdog`: ports, the navigator's process, signals, the clock."""

import json
import logging
import os
import pickle
import selectors
import signal
import time
from collections.abc import Sequence
from dataclasses import dataclass
from types import FrameType

from vwnav.errors import LinkError
from vwnav.machine.process_watch import ProcessWatch
from vwnav.mavlink.links import LinkAddress, UdpLink, open_link, parse_link
from vwnav.pace import clock_of
from vwnav.watchdog.keepalive import UdpChannel
from vwnav.watchdog.loop import Known, Watchdog, WatchdogConfig, WatchdogLinks
from vwnav.watchdog.spare import MOST_STARTS, PROGRAM, Spare
from vwnav.watchdog.successor import SuccessorProcess
from vwnav.watchdog.visitors import Reception

_log = logging.getLogger(__name__)
_TICK_S = 0.02
_ACTING_TICK_S = 0.005
_LATE_S = 0.01  # of its tick: simulated time waits for it then


@dataclass(frozen=True, slots=True, kw_only=True)
class WatchdogOptions:
    """How the process runs.

    Attributes:
        connection: URL of the autopilot's link.
        navigator_port, keepalive_port, observer_port: UDP ports on 127.0.0.1; 0 lets the system
            choose.
        parent: process id of the navigator, whose end is noticed. None: only its silence is.
        standby: command line of the successor; none when empty.
        limit_s: longest time it goes on without the navigator.
        clock_file: of a simulated time; empty for the wall's.
        starts_left: of spare ones, by this one and those that follow it.
        took_over: what one knew that has died in flight, in whose place this one is; b"" where it
            is the first. It comes up whatever the link does.
    """

    connection: str
    navigator_port: int = 0
    keepalive_port: int = 0
    observer_port: int = 0
    parent: int | None = None
    standby: Sequence[str] = ()
    limit_s: float = 900.0
    clock_file: str = ""
    starts_left: int = MOST_STARTS
    took_over: bytes = b""

    def command_line(self, ports: dict[str, int]) -> list[str]:
        """Of another one in the place of this one, which has those `ports`."""
        told = {
            "connection": self.connection, "parent": self.parent, "clock-file": self.clock_file,
            "standby": json.dumps(list(self.standby)), "limit-s": self.limit_s,
        }  # fmt: skip
        told |= {name.replace("_", "-"): port for name, port in ports.items()}
        words = [(f"--{name}", str(value)) for name, value in told.items() if value is not None]
        return [*PROGRAM, *(word for pair in words for word in pair)]


class WatchdogPorts:
    """A `Watchdog` on real ports.

    Raises:
        LinkError: the link or a port cannot be opened.
    """

    def __init__(self, options: WatchdogOptions) -> None:
        address = parse_link(options.connection)
        self._reception = Reception(address)
        self._clock = clock_of(options.clock_file)
        self._navigator = _local_link(options.navigator_port)
        self._observer = _local_link(options.observer_port)
        self._beats = UdpChannel(options.keepalive_port, listens=True)
        self._link = open_link(address, at_once=not options.took_over)
        links = WatchdogLinks(self._link, self._navigator, self._observer, self._beats)
        config = WatchdogConfig(
            calls_first=address.kind != "udpin",
            limit_s=options.limit_s,
            process=os.getpid(),
        )
        known, serving = _unpacked(options.took_over)
        self._successor = None
        if options.standby:
            self._successor = SuccessorProcess(
                options.standby,
                f"udpout://127.0.0.1:{self._navigator.port}",
                f"udpout://127.0.0.1:{self._observer.port}",
                self._beats.port,
                serving,
            )
        self._parent = None
        if options.parent is not None and not (known is not None and known.useless.gone):
            self._parent = ProcessWatch(options.parent)
        known = None if known is None else known.pass_on(self._clock())
        self._watchdog = Watchdog(links, config, self._successor, self._parent, known)
        self._spare = Spare(options.command_line(self.ports), options.starts_left)
        self._told_to_end = False
        self._link_fd = -1
        self._selector = selectors.DefaultSelector()

    @property
    def ports(self) -> dict[str, int]:
        """The ports taken, for the ready line."""
        return {
            "navigator_port": self._navigator.port,
            "keepalive_port": self._beats.port,
            "observer_port": self._observer.port,
        }

    def run(self) -> None:
        """Relay and watch until there is nothing left to do.

        A signal to end (a service that is stopped) is taken for the navigator's end: an aircraft
        that flies is landed first.
        """
        for number in (signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, self._handle_signal)
        for link in (self._navigator, self._observer, self._beats):
            self._selector.register(link, selectors.EVENT_READ)
        if self._parent is not None and self._parent.fd is not None:
            self._selector.register(self._parent.fd, selectors.EVENT_READ, "parent")
        participant = self._clock.join("watchdog")
        while not self._watchdog.finished:
            self._follow_link()
            participant.until(self._clock() + _TICK_S + _LATE_S)
            self._wait()
            now_s = self._clock()
            if self._told_to_end or (self._parent is not None and self._parent.has_ended(now_s)):
                self._watchdog.handle_navigator_end(now_s)
            self._step(now_s)
        participant.leave()

    def close(self) -> None:
        """Nothing is left to do, for a spare one neither: give the link and the ports back."""
        self._spare.close()
        self._selector.close()
        self._watchdog.close()
        if self._parent is not None:
            self._parent.close()
        self._reception.close()

    def _step(self, now_s: float) -> None:
        """One that fails is said, and the guard goes on: nobody else would land the aircraft."""
        try:
            self._watchdog.step(now_s)
            guarding = self._watchdog.guarding(now_s)
            self._reception.step(guarding, now_s)
            self._spare.step(self._known, (guarding, self._serving), time.monotonic())
            self._watchdog.has_spare = self._spare.is_there
        except Exception:
            _log.exception("a step of the watchdog failed")
            time.sleep(_TICK_S)

    def _known(self) -> bytes:
        """For the spare one."""
        return pickle.dumps((self._watchdog.known, self._serving), pickle.HIGHEST_PROTOCOL)

    @property
    def _serving(self) -> int | None:
        """Number of the process that serves in the navigator's place."""
        return None if self._successor is None else self._successor.serving

    def _wait(self) -> None:
        """Until something arrives, or the next tick."""
        tick_s = _ACTING_TICK_S if self._watchdog.is_acting else _TICK_S
        for key, _ in self._selector.select(tick_s):
            if key.data == "parent" and self._parent is not None:
                self._selector.unregister(key.fd)  # stays readable
                self._parent.handle_readable()

    def _handle_signal(self, _: int, __: FrameType | None) -> None:
        self._told_to_end = True

    def _follow_link(self) -> None:
        """Keep the selector on the link's present descriptor: a stream link may come and go."""
        fd = self._link.fileno()
        if fd == self._link_fd:
            return
        if self._link_fd >= 0:
            self._selector.unregister(self._link_fd)
        if fd >= 0:
            self._selector.register(fd, selectors.EVENT_READ)
        self._link_fd = fd


def _unpacked(took_over: bytes) -> tuple[Known | None, int | None]:
    """What was known, and the number of the successor that serves. A broken word is none."""
    if not took_over:
        return None, None
    try:
        known, serving = pickle.loads(took_over)  # of our own code, by our own parent
    except Exception:
        _log.exception("what the watchdog knew that died cannot be read: begun anew")
        return None, None
    return known, serving


def _local_link(port: int) -> UdpLink:
    try:
        return UdpLink(LinkAddress("udpin", "127.0.0.1", port))
    except OSError as error:
        raise LinkError(f"cannot use port {port} of this machine: {error.strerror}") from error
