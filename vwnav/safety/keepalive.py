"""The sign of life between the control loop and the watchdog: one datagram each way.

MAVLink traffic is no sign of life: heartbeats, parameters and estimates may flow on from other
threads while the control loop hangs. So the loop itself says, at its own rate, that it lives and
whether it has the aircraft.
"""

import contextlib
import socket
import struct
import time
from dataclasses import dataclass
from enum import Enum

_BEAT = struct.Struct("<4sBIQ16s")  # magic, flags, sequence, epoch, phase
_BEAT_MAGIC = b"VWB1"
_REPORT = struct.Struct("<4sBIf")  # magic, state, sequence of the beat answered, heartbeat age
_REPORT_MAGIC = b"VWR1"
_ENGAGED, _GOODBYE = 0x01, 0x02
DATAGRAM_LIMIT_BYTES = 256


class GuardState(Enum):
    """What the watchdog does."""

    RELAY = 0  # hands bytes on, nothing else
    BRAKING = 1  # sends zero velocity in the navigator's place
    HOLDING = 2  # has asked for Hold
    LANDING = 3  # has asked for Land
    STOOD_DOWN = 4  # somebody else has the aircraft: the pilot, or the autopilot's own failsafe


@dataclass(frozen=True, slots=True)
class Beat:
    """What the control loop says of itself.

    Attributes:
        engaged: it has the aircraft and must not fall silent.
        epoch: grows with every new claim to the aircraft.
        goodbye: the navigator ends in good order.
    """

    engaged: bool
    sequence: int
    epoch: int
    phase: str = ""
    goodbye: bool = False

    def pack(self) -> bytes:
        """As a datagram."""
        flags = (_ENGAGED if self.engaged else 0) | (_GOODBYE if self.goodbye else 0)
        phase = self.phase.encode("ascii", "replace")[:16]
        return _BEAT.pack(_BEAT_MAGIC, flags, self.sequence & 0xFFFFFFFF, self.epoch, phase)

    @staticmethod
    def unpack(data: bytes) -> "Beat | None":
        """Of a datagram, None if it is no beat."""
        if len(data) != _BEAT.size or data[:4] != _BEAT_MAGIC:
            return None
        _, flags, sequence, epoch, phase = _BEAT.unpack(data)
        text = phase.rstrip(b"\0").decode("ascii", "replace")
        return Beat(bool(flags & _ENGAGED), sequence, epoch, text, bool(flags & _GOODBYE))


@dataclass(frozen=True, slots=True)
class WatchdogReport:
    """The watchdog's answer to a beat.

    Attributes:
        state: what it does; anything but RELAY means that setpoints are not handed on.
        sequence: of the beat answered.
        heartbeat_age_s: since the autopilot was last heard by the watchdog.
    """

    state: GuardState
    sequence: int
    heartbeat_age_s: float

    def pack(self) -> bytes:
        """As a datagram."""
        return _REPORT.pack(_REPORT_MAGIC, self.state.value, self.sequence, self.heartbeat_age_s)

    @staticmethod
    def unpack(data: bytes) -> "WatchdogReport | None":
        """Of a datagram, None if it is no report."""
        if len(data) != _REPORT.size or data[:4] != _REPORT_MAGIC:
            return None
        _, state, sequence, age_s = _REPORT.unpack(data)
        return WatchdogReport(GuardState(state), sequence, age_s)


class KeepAlive:
    """The control loop's side: call `beat` in every turn of the loop, from the loop's own thread.

    Args:
        port: the watchdog's keep-alive port on this machine.
    """

    def __init__(self, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect(("127.0.0.1", port))
        self._socket.setblocking(False)
        self._sequence = 0
        self._epoch = time.monotonic_ns()
        self._report: WatchdogReport | None = None
        self._report_t_s = time.monotonic()

    def beat(self, engaged: bool, phase: str = "") -> None:
        """Say that the loop lives; never waits.

        Args:
            engaged: the navigator has the aircraft; from then on silence of half a second makes
                the watchdog brake, hold and land.
            phase: what the loop does, for the watchdog's log (16 ASCII characters).
        """
        self._sequence += 1
        self._send(Beat(engaged, self._sequence, self._epoch, phase))
        self._read_reports()

    def rejoin(self) -> None:
        """Claim the aircraft again after the watchdog took it; holds from the next beat on."""
        self._epoch = time.monotonic_ns()

    @property
    def report(self) -> WatchdogReport | None:
        """The watchdog's newest answer, None before the first."""
        return self._report

    @property
    def silence_s(self) -> float:
        """Time since the watchdog last answered (since the start, before its first answer)."""
        return time.monotonic() - self._report_t_s

    def close(self) -> None:
        """Tell the watchdog that the navigator ends in good order."""
        self._send(Beat(False, self._sequence + 1, self._epoch, "goodbye", goodbye=True))
        self._socket.close()

    def _send(self, beat: Beat) -> None:
        # A watchdog that is gone shows as refused connection: `silence_s` tells, nothing is raised.
        with contextlib.suppress(OSError):
            self._socket.send(beat.pack())

    def _read_reports(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                report = WatchdogReport.unpack(self._socket.recv(DATAGRAM_LIMIT_BYTES))
                if report is not None:
                    self._report, self._report_t_s = report, time.monotonic()
