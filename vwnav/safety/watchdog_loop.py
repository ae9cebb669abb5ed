"""The watchdog's loop: sockets and clock around `DeadMan`. Runs in the watchdog's own process."""

import logging
import os
import selectors
import socket
import time
from dataclasses import dataclass, field

from vwnav.errors import LinkError
from vwnav.safety.dead_man import DeadMan, DeadManConfig
from vwnav.safety.keepalive import DATAGRAM_LIMIT_BYTES, Beat, GuardState, WatchdogReport
from vwnav.safety.links import Link, open_link, parse_link
from vwnav.safety.mavlink_framing import Framer
from vwnav.safety.watchdog_voice import AutopilotEar, Voice, without_control

_log = logging.getLogger(__name__)
_TICK_S = 0.02
_ACTING_TICK_S = 0.005
_READ_BYTES = 4096
_READS_IN_A_ROW = 32
_CALL_PERIOD_S = 1.0
_ORPHAN_CHECK_S = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class WatchdogOptions:
    """How the process runs.

    Attributes:
        connection: URL of the autopilot's link.
        navigator_port, keepalive_port: UDP ports on 127.0.0.1; 0 lets the system choose.
        parent: process id of the navigator; the watchdog ends when it is gone and nothing is
            left to watch over. None: it runs until it is stopped.
        limit_s: longest time it goes on without the navigator.
    """

    connection: str
    navigator_port: int = 0
    keepalive_port: int = 0
    parent: int | None = None
    limit_s: float = 900.0
    dead_man: DeadManConfig = field(default_factory=DeadManConfig)


def _local_socket(port: int) -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setblocking(False)
    try:
        sock.bind(("127.0.0.1", port))
    except OSError as error:
        sock.close()
        raise LinkError(f"cannot use port {port} of this machine: {error.strerror}") from error
    return sock


class Watchdog:
    """Sockets and clock around `DeadMan`.

    Raises:
        LinkError: the link or a port cannot be opened.
    """

    def __init__(self, options: WatchdogOptions) -> None:
        self._options = options
        address = parse_link(options.connection)
        self._calls_first = address.kind != "udpin"
        self._navigator = _local_socket(options.navigator_port)
        self._keepalive = _local_socket(options.keepalive_port)
        self._observer = _local_socket(0)
        self._link: Link = open_link(address)
        self._navigator_address: tuple[str, int] | None = None
        self._observer_address: tuple[str, int] | None = None
        self._from_navigator = Framer()
        self._from_observer = Framer()
        self._ear = AutopilotEar()
        self._voice = Voice()
        self._guard = DeadMan(options.dead_man)
        self._call_t_s = -_CALL_PERIOD_S
        self._goodbye = False
        self._selector = selectors.DefaultSelector()
        self._link_fd = -1
        self._selector.register(self._navigator, selectors.EVENT_READ, self._read_navigator)
        self._selector.register(self._observer, selectors.EVENT_READ, self._read_observer)
        self._selector.register(self._keepalive, selectors.EVENT_READ, self._read_keepalive)

    @property
    def ports(self) -> dict[str, int]:
        """The ports taken, for the ready line."""
        return {
            "navigator_port": self._navigator.getsockname()[1],
            "keepalive_port": self._keepalive.getsockname()[1],
            "observer_port": self._observer.getsockname()[1],
        }

    def run(self) -> None:
        """Relay and watch until there is nothing left to do."""
        while not self._finished(time.monotonic()):
            self._follow_link()
            tick_s = _ACTING_TICK_S if self._guard.blocks_setpoints else _TICK_S
            for key, _ in self._selector.select(tick_s):
                key.data()
            self._act(time.monotonic())

    def close(self) -> None:
        """Give the link and the ports back."""
        self._selector.close()
        self._link.close()
        self._navigator.close()
        self._observer.close()
        self._keepalive.close()

    def _follow_link(self) -> None:
        """Keep the selector on the link's present descriptor: a stream link may come and go."""
        fd = self._link.fileno()
        if fd == self._link_fd:
            return
        if self._link_fd >= 0:
            self._selector.unregister(self._link_fd)
        if fd >= 0:
            self._selector.register(fd, selectors.EVENT_READ, self._read_link)
        self._link_fd = fd

    def _read_link(self) -> None:
        for _ in range(_READS_IN_A_ROW):
            data = self._link.read()
            if not data:
                break
            if self._navigator_address is not None:
                self._send(self._navigator, data, self._navigator_address)
            if self._observer_address is not None:
                self._send(self._observer, data, self._observer_address)
            for answer in self._ear.listen(data, time.monotonic()):
                self._guard.handle_answer(answer, time.monotonic())
            self._guard.handle_vehicle(self._ear.vehicle)

    def _read_navigator(self) -> None:
        for _ in range(_READS_IN_A_ROW):
            try:
                data, self._navigator_address = self._navigator.recvfrom(_READ_BYTES)
            except (BlockingIOError, ConnectionError):
                return
            if self._guard.blocks_setpoints:
                data = without_control(self._from_navigator.split(data))
            self._link.write(data)

    def _read_observer(self) -> None:
        """Somebody who listens along; may ask for messages, never for anything that flies."""
        try:
            data, self._observer_address = self._observer.recvfrom(_READ_BYTES)
        except (BlockingIOError, ConnectionError):
            return
        self._link.write(without_control(self._from_observer.split(data)))

    def _read_keepalive(self) -> None:
        try:
            data, sender = self._keepalive.recvfrom(DATAGRAM_LIMIT_BYTES)
        except (BlockingIOError, ConnectionError):
            return
        beat = Beat.unpack(data)
        if beat is None:
            return
        now_s = time.monotonic()
        before = self._guard.state
        self._guard.handle_beat(beat, now_s)
        self._log_change(before)
        self._goodbye = beat.goodbye
        age_s = self._ear.heartbeat_age_s(now_s)
        report = WatchdogReport(self._guard.state, beat.sequence, age_s)
        self._send(self._keepalive, report.pack(), sender)

    def _act(self, now_s: float) -> None:
        before = self._guard.state
        action = self._guard.step(now_s)
        self._log_change(before)
        if action is not None:
            self._link.write(self._voice.say(action, self._ear, now_s))
        if self._calls_first and self._ear.heartbeat_age_s(now_s) > _CALL_PERIOD_S:
            self._call(now_s)

    def _call(self, now_s: float) -> None:
        """Show ourselves to an autopilot that waits to be spoken to."""
        if now_s - self._call_t_s >= _CALL_PERIOD_S:
            self._call_t_s = now_s
            self._link.write(self._voice.heartbeat())

    def _log_change(self, before: GuardState) -> None:
        state, beat = self._guard.state, self._guard.last_beat
        if state is not before:
            phase = beat.phase if beat is not None else ""
            silence_s = self._guard.silence_s(time.monotonic())
            _log.warning(
                "%s -> %s, mode %s, navigator silent for %.2f s (%s)",
                before.name,
                state.name,
                self._ear.vehicle.mode.name,
                silence_s,
                phase,
            )

    def _finished(self, now_s: float) -> bool:
        has_aircraft = self._guard.state is not GuardState.RELAY and self._ear.vehicle.armed
        if self._goodbye and not has_aircraft:
            return True
        parent = self._options.parent
        if parent is None or os.getppid() == parent:
            return False
        silence_s = self._guard.silence_s(now_s) if self._guard.last_beat else _ORPHAN_CHECK_S
        if silence_s < _ORPHAN_CHECK_S:
            return False
        return not self._ear.vehicle.armed or silence_s > self._options.limit_s

    @staticmethod
    def _send(sock: socket.socket, data: bytes, to: tuple[str, int]) -> None:
        try:
            sock.sendto(data, to)
        except OSError as error:  # a navigator that is gone or slow: it misses bytes, as on air
            _log.debug("dropped %d bytes for %s: %s", len(data), to, error)
