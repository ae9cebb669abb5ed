"""The sign of life between the control loop and the watchdog: one datagram each way.

MAVLink traffic is no sign of life: heartbeats, parameters and estimates may flow on from other
threads while the control loop hangs. So the loop itself says, at its own rate, that it lives and
whether it has the aircraft.

There is no word that sends the watchdog away: the navigator can only say that it ends. Whether
the aircraft may be left alone then, the watchdog judges by what it hears of it.
"""

import contextlib
import math
import socket
import struct
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from vwnav.errors import LinkError
from vwnav.vehicle import FoundCamera, Learned

_BEAT = struct.Struct("<4sBBIQ16s")  # magic, flags, system, sequence, epoch, phase; then learned
_BEAT_MAGIC = b"VWB5"
_CAMERA = 3 + 9  # numbers of a `FoundCamera`
_LEARNED_HEAD = struct.Struct("<dHHH")  # when, how many of means, of covariances, of the camera
_REPORT = struct.Struct("<4sBBIfI")  # magic, state, flags, of which beat, heartbeat age, process
_REPORT_MAGIC = b"VWR4"
_ENGAGED, _ENDED = 0x01, 0x02
_RELAYS_ESTIMATES, _HAS_SPARE = 0x01, 0x02
_OLD_S = 1.0  # of an answer: beats come at 20 Hz
_MANY_BEATS = 15  # unanswered: fewer may be those of a loop that slept
_DATAGRAM_LIMIT_BYTES = 2048


class GuardState(Enum):
    """What the watchdog does."""

    RELAY = 0  # hands bytes on, nothing else
    BRAKING = 1  # sends zero velocity in the navigator's place
    HOLDING = 2  # has asked for Hold
    LANDING = 3  # has asked for Land
    STOOD_DOWN = 4  # somebody else has the aircraft: the pilot, or the autopilot's own failsafe


_STATES = frozenset(state.value for state in GuardState)


@dataclass(frozen=True, slots=True)
class Beat:
    """What the control loop says of itself.

    Attributes:
        engaged: it has the aircraft and must not fall silent.
        epoch: grows with every new claim to the aircraft.
        ended: the navigator ends now, in whatever order: nothing comes after it.
        learned: for a successor; None where it is not known.
        system_id: of the autopilot that the navigator follows; 0 where it does not say.
    """

    engaged: bool
    sequence: int
    epoch: int
    phase: str = ""
    ended: bool = False
    learned: Learned | None = None
    system_id: int = 0

    def pack(self) -> bytes:
        """As a datagram."""
        flags = (_ENGAGED if self.engaged else 0) | (_ENDED if self.ended else 0)
        phase = self.phase.encode("ascii", "replace")[:16]
        sequence = self.sequence & 0xFFFFFFFF
        beat = _BEAT.pack(_BEAT_MAGIC, flags, self.system_id, sequence, self.epoch, phase)
        return beat + (b"" if self.learned is None else _packed(self.learned))

    @staticmethod
    def unpack(data: bytes) -> "Beat | None":
        """Of a datagram, None if it is no beat."""
        if len(data) < _BEAT.size or data[:4] != _BEAT_MAGIC or not _is_whole(data[_BEAT.size :]):
            return None
        _, flags, system_id, sequence, epoch, phase = _BEAT.unpack_from(data)
        text = phase.rstrip(b"\0").decode("ascii", "replace")
        engaged, ended = bool(flags & _ENGAGED), bool(flags & _ENDED)
        learned = _unpacked(data[_BEAT.size :])
        return Beat(engaged, sequence, epoch, text, ended, learned, system_id)


def _packed(learned: Learned) -> bytes:
    found = learned.camera
    camera = () if found is None else (*found[:2], found.time_offset_s, *found.R_mount)
    numbers = (*learned.mean, *learned.covariance, *camera)
    counts = len(learned.mean), len(learned.covariance), len(camera)
    return _LEARNED_HEAD.pack(learned.t_s, *counts) + struct.pack(f"<{len(numbers)}d", *numbers)


def _is_whole(data: bytes) -> bool:
    """Whether what follows a beat is nothing, or as long as it says."""
    if len(data) < _LEARNED_HEAD.size:
        return not data
    _, *counts = _LEARNED_HEAD.unpack_from(data)
    return len(data) == _LEARNED_HEAD.size + 8 * int(sum(counts)) and counts[-1] in (0, _CAMERA)


def _unpacked(data: bytes) -> Learned | None:
    """None where nothing was learned, or what is no number: the beat counts all the same."""
    if not data:
        return None
    t_s, means, covariances, camera = _LEARNED_HEAD.unpack_from(data)
    numbers = struct.unpack_from(f"<{means + covariances + camera}d", data, _LEARNED_HEAD.size)
    if not all(map(math.isfinite, (t_s, *numbers))):
        return None
    mean, covariance, found = numbers[:means], numbers[means:][:covariances], numbers[-camera:]
    told = FoundCamera(found[0], found[1], found[3:], found[2]) if camera else None
    return Learned(t_s, mean, covariance, told)


@dataclass(frozen=True, slots=True)
class WatchdogReport:
    """The watchdog's answer to a beat.

    Attributes:
        state: what it does; anything but RELAY means that setpoints are not handed on.
        sequence: of the beat answered.
        heartbeat_age_s: since the autopilot was last heard by the watchdog.
        relays_estimates: the last estimate was handed on. False: they are held back until they
            come as new ones, with another reset counter.
        process: of the watchdog that answers; 0 where it has none.
        has_spare: another one would take its place.
    """

    state: GuardState
    sequence: int
    heartbeat_age_s: float
    relays_estimates: bool = True
    process: int = 0
    has_spare: bool = True

    def pack(self) -> bytes:
        """As a datagram."""
        flags = _RELAYS_ESTIMATES if self.relays_estimates else 0
        flags |= _HAS_SPARE if self.has_spare else 0
        told = self.sequence, self.heartbeat_age_s, self.process
        return _REPORT.pack(_REPORT_MAGIC, self.state.value, flags, *told)

    @staticmethod
    def unpack(data: bytes) -> "WatchdogReport | None":
        """Of a datagram, None if it is no report."""
        if len(data) != _REPORT.size or data[:4] != _REPORT_MAGIC:
            return None
        _, state, flags, sequence, age_s, process = _REPORT.unpack(data)
        if state not in _STATES:
            return None
        relays, has_spare = bool(flags & _RELAYS_ESTIMATES), bool(flags & _HAS_SPARE)
        return WatchdogReport(GuardState(state), sequence, age_s, relays, process, has_spare)


class Channel(Protocol):
    """Carries datagrams between the control loop and the watchdog; may lose them, never waits."""

    def send(self, data: bytes) -> None:
        """One datagram to the other end, where there is one."""
        ...

    def receive(self) -> bytes:
        """The next datagram that has arrived; empty when none has."""
        ...

    def close(self) -> None:
        """Give it back."""
        ...


class UdpChannel:
    """A `Channel` within this machine.

    Args:
        port: of the watchdog; 0 lets the system choose.
        listens: the watchdog's end, which answers whoever spoke last.

    Raises:
        LinkError: the port is taken.
    """

    def __init__(self, port: int, listens: bool) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._peer: tuple[str, int] | None = None if listens else ("127.0.0.1", port)
        try:
            self._socket.bind(("127.0.0.1", port if listens else 0))
        except OSError as error:
            self._socket.close()
            raise LinkError(f"cannot use port {port} of this machine: {error.strerror}") from error

    @property
    def port(self) -> int:
        """Its own port."""
        return int(self._socket.getsockname()[1])

    def fileno(self) -> int:
        """Its descriptor."""
        return self._socket.fileno()

    def send(self, data: bytes) -> None:
        """One datagram to the other end, lost where that is gone."""
        if self._peer is not None:
            with contextlib.suppress(OSError):
                self._socket.sendto(data, self._peer)

    def receive(self) -> bytes:
        """The next datagram that has arrived; empty when none has."""
        try:
            data, self._peer = self._socket.recvfrom(_DATAGRAM_LIMIT_BYTES)
        except OSError:  # nothing there, or word that an earlier datagram found nobody
            return b""
        return data

    def close(self) -> None:
        """Give the port back."""
        self._socket.close()


class KeepAlive:
    """The control loop's side: call `beat` in every turn of the loop, from the loop's own thread.

    Args:
        channel: to the watchdog.
        clock: the loop's monotonic clock.

    Attributes:
        system_id: of the autopilot that is followed, for the watchdog to follow it too; 0 leaves
            it with the first that it hears.
    """

    def __init__(self, channel: Channel, clock: Callable[[], float]) -> None:
        self._channel = channel
        self._clock = clock
        self.system_id = 0
        self._sequence = 0
        self._epoch = 0
        self._report: WatchdogReport | None = None
        self._reported_s = -math.inf
        self._unanswered_since_s: float | None = None
        self._unanswered = 0
        self.rejoin()

    def beat(self, engaged: bool, phase: str = "", learned: Learned | None = None) -> None:
        """Say that the loop lives; never waits.

        Args:
            engaged: the navigator has the aircraft; from then on silence of half a second makes
                the watchdog brake, hold and land.
            phase: what the loop does, for the watchdog's log (16 ASCII characters).
            learned: for the navigator that goes on should this one end.
        """
        self._read_reports()
        self._sequence += 1
        if self._unanswered_since_s is None:
            self._unanswered_since_s = self._clock()
        self._unanswered += 1
        beat = Beat(engaged, self._sequence, self._epoch, phase, False, learned, self.system_id)
        self._channel.send(beat.pack())

    def rejoin(self) -> None:
        """Claim the aircraft again after the watchdog took it; holds from the next beat on."""
        self._epoch = max(self._epoch + 1, int(self._clock() * 1e9))

    @property
    def report(self) -> WatchdogReport | None:
        """The watchdog's newest answer; None before the first, and once it is old.

        It answers beats: who beats no more, because the mission broke, is told nothing more. That
        the estimates were held back then says nothing of now.
        """
        self._read_reports()
        return None if self._clock() - self._reported_s > _OLD_S else self._report

    @property
    def unanswered_s(self) -> float:
        """Since the first of the beats that nobody has answered; 0 while they are few."""
        since_s = self._unanswered_since_s
        if since_s is None or self._unanswered < _MANY_BEATS:
            return 0.0
        return self._clock() - since_s

    @property
    def last_report(self) -> WatchdogReport | None:
        """The watchdog's newest answer, however old."""
        return self._report

    def leave(self) -> None:
        """Say that the navigator ends. A watchdog that hears the aircraft fly acts at once."""
        self._sequence += 1
        self._channel.send(Beat(False, self._sequence, self._epoch, "ended", ended=True).pack())

    def close(self) -> None:
        """Say the same, and give the channel back."""
        self.leave()
        self._channel.close()

    def _read_reports(self) -> None:
        while data := self._channel.receive():
            report = WatchdogReport.unpack(data)
            if report is not None:
                self._report, self._reported_s = report, self._clock()
                self._unanswered_since_s, self._unanswered = None, 0
