"""A link in memory: bytes that arrive late, are lost or cut off, by a simulated clock.

Both ends are what `vwnav.mavlink.links.Link` asks for, so that the watchdog, the navigator's driver
and the simulated vehicle talk over it as they do over UDP or a serial line.
"""

import heapq
import random
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

_BITS_PER_BYTE = 10  # start bit, eight, stop bit
_SOON_S = 0.02
_UNSENT_LIMIT_BYTES = 65536  # more than a serial port's queue is dropped, as `StreamLink` does

Clock = Callable[[], float]
Tap = Callable[[bytes], Iterable[tuple[float, bytes]]]  # packet -> (delay in s, packet) of each


@dataclass(slots=True, kw_only=True)
class LineState:
    """What a line does to the bytes on it; a scenario changes it while it runs.

    Attributes:
        latency_s: one way.
        loss: share of the packets that never arrive.
        baud: bits per second of a serial line; None carries whatever comes.
        cut: nothing gets in.
        taps: what becomes of each packet: dropped, altered, delayed, doubled; one after the other,
            each by the `id` of who put it there.
    """

    latency_s: float = 0.0
    loss: float = 0.0
    baud: float | None = None
    cut: bool = False
    taps: dict[int, Tap] = field(default_factory=dict)

    def tapped(self, packet: bytes) -> list[tuple[float, bytes]]:
        """(delay in s, packet) of each that comes of one."""
        packets = [(0.0, packet)]
        for tap in list(self.taps.values()):
            packets = [
                (delay_s + more_s, made) for delay_s, each in packets for more_s, made in tap(each)
            ]
        return packets


class Line:
    """One direction: packets in the order of their arrival.

    Those that no tap delays arrive in the order in which they were sent, also where the line
    becomes faster meanwhile.
    """

    def __init__(self, clock: Clock, state: LineState, rng: random.Random) -> None:
        self._clock = clock
        self._state = state
        self._rng = rng
        self._flying: list[tuple[float, int, bytes]] = []  # (arrival, number, packet)
        self._order = 0
        self._free_s = 0.0  # when the last bit written so far has left
        self._arrives_s = 0.0  # the last packet that no tap delays

    def put(self, packet: bytes) -> None:
        """Send one packet."""
        for delay_s, each in self._state.tapped(packet):
            self._put(each, delay_s)

    def _put(self, packet: bytes, delay_s: float) -> None:
        state, now_s = self._state, self._clock()
        if state.cut or (state.loss > 0.0 and self._rng.random() < state.loss):
            return
        if state.baud is not None:
            waiting_s = max(0.0, self._free_s - now_s)
            if waiting_s * state.baud / _BITS_PER_BYTE > _UNSENT_LIMIT_BYTES:
                return
            self._free_s = now_s + waiting_s + _BITS_PER_BYTE * len(packet) / state.baud
            now_s = self._free_s
        self._order += 1
        self._arrives_s = arrives_s = max(self._arrives_s, now_s + state.latency_s)
        heapq.heappush(self._flying, (arrives_s + delay_s, self._order, packet))

    def has_room(self) -> bool:
        """Whether what is put now leaves soon, and does not wait behind what was before."""
        return self._free_s - self._clock() < _SOON_S

    def take(self) -> bytes:
        """The next packet that has arrived; empty when none has."""
        if not self._flying or self._flying[0][0] > self._clock():
            return b""
        return heapq.heappop(self._flying)[2]


class MemoryEnd:
    """One end of a link in memory: a `Link` without a descriptor, and a `keepalive.Channel`."""

    def __init__(self, incoming: Line, outgoing: Line) -> None:
        self._incoming = incoming
        self._outgoing = outgoing

    def fileno(self) -> int:
        """It has none."""
        return -1

    def read(self) -> bytes:
        """One packet that has arrived; empty when none has."""
        return self._incoming.take()

    def drop(self) -> None:
        """Lose all that has arrived, as with a port that was opened by another process."""
        while self._incoming.take():
            pass

    def has_room(self) -> bool:
        """Whether what is written now leaves soon."""
        return self._outgoing.has_room()

    def write(self, data: bytes) -> None:
        """One packet on its way, unless the line takes none."""
        if data:
            self._outgoing.put(data)

    def receive(self) -> bytes:
        """As `read`."""
        return self.read()

    def send(self, data: bytes) -> None:
        """As `write`."""
        self.write(data)

    def close(self) -> None:
        """Nothing is held."""


class MemoryLink:
    """Two ends, `a` and `b`, and the line each way.

    Attributes:
        a_to_b, b_to_a: what the lines do to the bytes; may be changed at any time.
    """

    def __init__(self, clock: Clock, rng: random.Random, latency_s: float = 0.0) -> None:
        self.a_to_b = LineState(latency_s=latency_s)
        self.b_to_a = LineState(latency_s=latency_s)
        there, back = Line(clock, self.a_to_b, rng), Line(clock, self.b_to_a, rng)
        self.a = MemoryEnd(back, there)
        self.b = MemoryEnd(there, back)

    def cut(self, is_cut: bool) -> None:
        """Cut both ways, or join them again."""
        self.a_to_b.cut = self.b_to_a.cut = is_cut
