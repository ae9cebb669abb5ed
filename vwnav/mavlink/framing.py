"""Finds MAVLink packets in bytes by their header alone, as a relay needs it.

Nothing is decoded and no checksum is verified: the relay hands bytes on untouched whatever they
are. What the watchdog acts upon it decodes, checksum included, from the packets found here.
Layout: https://mavlink.io/en/guide/serialization.html
"""

from collections.abc import Iterator
from dataclasses import dataclass

_MAVLINK1, _MAVLINK2 = 0xFE, 0xFD
_MAVLINK1_OVERHEAD, _MAVLINK2_OVERHEAD, _SIGNATURE = 8, 12, 13
_INCOMPAT_SIGNED = 0x01
MARKERS = (_MAVLINK1, _MAVLINK2)  # the bytes that a packet begins with


@dataclass(frozen=True, slots=True)
class Packet:
    """One packet, or bytes that are none (`message_id` None)."""

    data: bytes
    message_id: int | None
    system_id: int = 0
    component_id: int = 0


class Framer:
    """Cuts a stream of bytes into packets; keeps an unfinished one for the next call."""

    def __init__(self) -> None:
        self._pending = b""

    def split(self, data: bytes) -> list[Packet]:
        """Packets and, in their place, the bytes between them that belong to none.

        Joined, the `data` of all packets ever returned is the stream, but for an unfinished end.
        """
        return list(self._split(self._pending + data))

    def _split(self, data: bytes) -> Iterator[Packet]:
        at = 0
        while at < len(data):
            start = _next_start(data, at)
            if start > at:
                yield Packet(data[at:start], None)
                at = start
                continue
            packet = packet_at(data, at)
            if packet is None:
                break
            end = at + len(packet.data)
            # A start byte inside garbage would swallow the packets after it; so where the next
            # byte is there and starts no packet, this one is taken for garbage too.
            if end < len(data) and data[end] not in MARKERS:
                packet = Packet(data[at : at + 1], None)
            yield packet
            at += len(packet.data)
        self._pending = data[at:]


def _next_start(data: bytes, at: int) -> int:
    if data[at] in MARKERS:
        return at
    starts = [i for i in (data.find(_MAVLINK2, at), data.find(_MAVLINK1, at)) if i >= 0]
    return min(starts, default=len(data))


def packet_at(data: bytes, at: int) -> Packet | None:
    """The packet whose start byte is at `at`, None while its end has not arrived."""
    if len(data) - at < _MAVLINK1_OVERHEAD:
        return None
    if data[at] == _MAVLINK1:
        end = at + _MAVLINK1_OVERHEAD + data[at + 1]
        header = (data[at + 5], data[at + 3], data[at + 4])
    else:
        if len(data) - at < _MAVLINK2_OVERHEAD:
            return None
        signature = _SIGNATURE if data[at + 2] & _INCOMPAT_SIGNED else 0
        end = at + _MAVLINK2_OVERHEAD + data[at + 1] + signature
        number = int.from_bytes(data[at + 7 : at + 10], "little")
        header = (number, data[at + 5], data[at + 6])
    return Packet(data[at:end], *header) if end <= len(data) else None
