"""The vehicle's MAVLink 2 links: UDP with several peers, or bytes of any other kind with one.

A parser for each peer; garbage is counted and dropped.
"""

import logging
import math
import socket
import time
from typing import Any, Protocol

from pymavlink.dialects.v20 import development as mavlink

from vwnav.errors import ConfigError, LinkError

_log = logging.getLogger(__name__)
_PEER_TIMEOUT_S = 5.0
_MAX_PEERS = 8
_DATAGRAM = 65536
_MAGIC = (b"\xfd", b"\xfe")  # first byte of a MAVLink 2 or 1 packet
_READ_AT_ONCE = 256
GCS_TYPE = 6  # MAV_TYPE_GCS

Address = tuple[str, int]
Message = Any  # pymavlink's generated classes have no common typed base


class MavlinkLink(Protocol):
    """What a conversation needs of a link.

    Attributes:
        gcs_heard_s: when a ground station was last heard, -inf before.
    """

    gcs_heard_s: float

    def receive(self, t_s: float) -> list[Message]:
        """Every valid message that has arrived; `t_s` is the time of arrival."""
        ...

    def send(self, message: Message) -> None:
        """Send to whoever is there."""
        ...


class ByteEnd(Protocol):
    """Bytes to and from one peer, as `vwnav.sim.memory_link.MemoryEnd` has them."""

    def read(self) -> bytes:
        """What has arrived; empty when nothing has."""
        ...

    def write(self, data: bytes) -> None:
        """Send."""
        ...


def parse_url(url: str) -> tuple[bool, Address]:
    """("udpin" or not, (host, port)) of "udpin:HOST:PORT" or "udpout://HOST:PORT"."""
    kind, _, rest = url.partition(":")
    host, _, port = rest.removeprefix("//").rpartition(":")
    if kind not in ("udpin", "udpout") or not host or not port.isdigit() or int(port) > 65535:
        raise ConfigError(f"{url!r} is no link: write udpin:HOST:PORT or udpout:HOST:PORT")
    return kind == "udpin", (host, int(port))


class VehicleUdpLink:
    """A socket with whoever speaks valid MAVLink on it.

    Args:
        url: "udpout:HOST:PORT" sends to that port until somebody speaks, "udpin:HOST:PORT" waits.
        system_id: MAVLink system of the sender.
    """

    def __init__(self, url: str, system_id: int) -> None:
        waits, address = parse_url(url)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setblocking(False)
        try:
            self.socket.bind(address if waits else ("0.0.0.0", 0))
        except OSError as error:
            self.socket.close()
            raise LinkError(f"cannot open {url}: {error}; is another vehicle running?") from error
        self._default = None if waits else address
        self._peers: dict[Address, float] = {}
        self._parsers: dict[Address, Message] = {}
        self._packer = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=1)
        self.gcs_heard_s = -math.inf
        self.dropped = 0

    @property
    def address(self) -> Address:
        """Where the socket is bound."""
        host, port = self.socket.getsockname()
        return str(host), int(port)

    def receive(self, t_s: float) -> list[Message]:
        """Every valid message that has arrived; `t_s` is the time of arrival."""
        messages: list[Message] = []
        for _ in range(_READ_AT_ONCE):
            try:
                data, address = self.socket.recvfrom(_DATAGRAM)
            except BlockingIOError:
                break
            except OSError as error:
                _log.debug("read from %s: %s", address_text(self.address), error)
                break
            messages += self._parse(data, address, t_s)
        return messages

    def _parse(self, data: bytes, address: Address, t_s: float) -> list[Message]:
        parser = datagram_parser(self._parsers.get(address), data)
        parsed = parser.parse_buffer(data) or []
        good = [message for message in parsed if message.get_msgId() >= 0]
        self.dropped += len(parsed) - len(good)
        if good or address in self._parsers:
            self._remember(address, parser)
        if any(map(is_ground_station, good)):
            self.gcs_heard_s = t_s
        return good

    def _remember(self, address: Address, parser: Message) -> None:
        if address not in self._parsers and len(self._parsers) >= _MAX_PEERS:
            oldest = min(self._peers, key=lambda peer: self._peers[peer])
            del self._peers[oldest], self._parsers[oldest]
        self._peers[address], self._parsers[address] = time.monotonic(), parser

    def send(self, message: Message) -> None:
        """Send to every peer heard lately, or where the link was told to."""
        packet = packed(message, self._packer)
        now_s = time.monotonic()
        targets = [peer for peer, heard in self._peers.items() if now_s - heard < _PEER_TIMEOUT_S]
        if not targets and self._default is not None:
            targets = [self._default]
        for target in targets:
            try:
                self.socket.sendto(packet, target)
            except OSError as error:
                self.dropped += 1
                _log.debug("to %s: %s", address_text(target), error)

    def close(self) -> None:
        """Free the port."""
        self.socket.close()


class ByteLink:
    """One peer behind bytes that come and go.

    Args:
        end: this side of the line.
        system_id: MAVLink system of the sender.
    """

    def __init__(self, end: ByteEnd, system_id: int) -> None:
        self._end = end
        self._packer = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=1)
        self._parser: Message = None
        self.gcs_heard_s = -math.inf

    def receive(self, t_s: float) -> list[Message]:
        """Every valid message that has arrived; `t_s` is the time of arrival."""
        messages: list[Message] = []
        while data := self._end.read():
            self._parser = datagram_parser(self._parser, data)
            parsed = self._parser.parse_buffer(data) or []
            messages += [message for message in parsed if message.get_msgId() >= 0]
        if any(map(is_ground_station, messages)):
            self.gcs_heard_s = t_s
        return messages

    def send(self, message: Message) -> None:
        """Send to the peer."""
        self._end.write(packed(message, self._packer))


def packed(message: Message, packer: Message) -> bytes:
    """The bytes of a message, with the sender's next sequence number."""
    packet = bytes(message.pack(packer))
    packer.seq = (packer.seq + 1) % 256
    return packet


def is_ground_station(message: Message) -> bool:
    """Whether it is the heartbeat of one."""
    return bool(message.get_msgId() == 0 and message.type == GCS_TYPE)


def datagram_parser(parser: Message, data: bytes) -> Message:
    """The parser for a datagram: a new one when it starts a packet and the last one was cut.

    Otherwise the rest of a damaged packet would swallow the good ones behind it.
    """
    if parser is None or (parser.buf_len() > 0 and data[:1] in _MAGIC):
        parser = mavlink.MAVLink(None)
        parser.robust_parsing = True  # garbage comes back as BAD_DATA messages
    return parser


def address_text(address: Address) -> str:
    """HOST:PORT."""
    return f"{address[0]}:{address[1]}"
