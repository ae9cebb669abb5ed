"""The ways to an autopilot: UDP both ways round, TCP, serial port; all without blocking."""

import array
import contextlib
import errno
import fcntl
import math
import os
import socket
import termios
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol
from urllib.parse import urlsplit

from vwnav.errors import LinkError
from vwnav.mavlink.opener import Opener

LinkKind = Literal["udpin", "udpout", "tcpout", "serial"]
_ALIASES: dict[str, LinkKind] = {
    "udpin": "udpin",
    "udp": "udpin",
    "udpout": "udpout",
    "tcpout": "tcpout",
    "tcp": "tcpout",
    "serial": "serial",
}
_EXAMPLES = (
    "udpin://0.0.0.0:14540, udpout://HOST:PORT, tcpout://HOST:PORT or serial:///dev/ttyAMA0:921600"
)
_READ_BYTES = 4096
_BITS_PER_BYTE = 10.0  # on a serial line: with start and stop bit
_QUEUE_S = 0.05  # what may wait in the system's queue: nothing overtakes it there
_SMALLEST_QUEUE_BYTES = 128
_TCP_QUEUE_BYTES = 2048
_CONNECT_TIMEOUT_S = 5.0
_TCP_DEAD_MS = 3000  # a far end that takes nothing for so long; the system tries for 15 min
_PEER_SILENT_S = 10.0
_MOST_PEERS = 4
_BUSY = frozenset({errno.EAGAIN, errno.EBUSY})  # a serial port that is locked


@dataclass(frozen=True, slots=True)
class LinkAddress:
    """Where the autopilot is: `place` is a host or a device, `number` a port or a baud rate."""

    kind: LinkKind
    place: str
    number: int

    @property
    def port_name(self) -> str:
        """What has one owner: listening, a port of this machine; a device; else the far end."""
        match self.kind:
            case "udpin":
                return f"udpin {self.number}"
            case "serial":
                return f"serial {self.place}"
        return f"{self.kind} {self.place}:{self.number}"

    def is_same_port(self, other: "LinkAddress") -> bool:
        """Whether both cannot be open at once, or would take each other's messages away."""
        return self.port_name == other.port_name


def parse_link(url: str) -> LinkAddress:
    """Read a connection URL as MAVSDK writes them.

    Raises:
        LinkError: it is none.
    """
    scheme, _, rest = url.partition("://")
    kind = _ALIASES.get(scheme)
    place, _, number = rest.rpartition(":")
    if kind is None or not number.isdecimal() or (kind != "udpin" and not place):
        raise LinkError(f"{url!r} is no connection: give {_EXAMPLES}")
    if kind != "serial":
        place = urlsplit(f"//{place}").hostname or "0.0.0.0"
        if not 0 < int(number) < 65536:
            raise LinkError(f"{url!r} has no port between 1 and 65535: give {_EXAMPLES}")
    return LinkAddress(kind, place, int(number))


class Link(Protocol):
    """A way to the autopilot."""

    def fileno(self) -> int:
        """Its descriptor, -1 while it is down."""
        ...

    def read(self) -> bytes:
        """What has arrived; empty when nothing has."""
        ...

    def has_room(self) -> bool:
        """Whether what is written now leaves soon, and does not wait behind what was before."""
        ...

    def write(self, data: bytes) -> None:
        """Send one packet, or drop it when the way is down."""
        ...

    def close(self) -> None:
        """Give it back."""
        ...


def open_link(address: LinkAddress, at_once: bool = True) -> Link:
    """Open the way.

    Args:
        address: of its far end.
        at_once: wait until it is open. Else what has a far end may come up later.

    Raises:
        LinkError: it cannot be opened; says which and why.
    """
    try:
        if address.kind in ("udpin", "udpout"):
            return UdpLink(address, at_once)
        return StreamLink(address, at_once)
    except (OSError, ValueError) as error:
        raise LinkError(_why_not_open(address, error)) from error


def _why_not_open(address: LinkAddress, error: Exception) -> str:
    where = f"{address.kind} {address.place}:{address.number}"
    reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    if isinstance(error, OSError) and error.errno in _BUSY:
        return f"cannot open {where}: another program has it; end that one (fuser names it)"
    hint = {
        "serial": "check the cable, the device name and that your user is in the group dialout",
        "udpin": "is another program (a ground station, a second vwnav) using that port?",
        "udpout": "check the address and the network",
        "tcpout": "is the autopilot or its bridge running there?",
    }[address.kind]
    return f"cannot open {where}: {reason}; {hint}"


class UdpLink:
    """Listens and answers everybody who speaks (udpin), or calls a fixed address (udpout)."""

    def __init__(self, address: LinkAddress, at_once: bool = True) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._peers: dict[tuple[str, int], float] = {}  # when each was heard
        self._looked_up: Opener[tuple[str, int]] | None = None
        try:
            if address.kind == "udpin":
                self._socket.bind((address.place, address.number))
            elif at_once:
                self._peers[_looked_up(address)] = -math.inf
            else:
                self._looked_up = Opener(lambda: _looked_up(address))
        except OSError:
            self._socket.close()
            raise

    @property
    def port(self) -> int:
        """Its own port."""
        return int(self._socket.getsockname()[1])

    def fileno(self) -> int:
        """Its descriptor."""
        return self._socket.fileno()

    def has_room(self) -> bool:
        """Always: what does not fit is lost, not kept."""
        return True

    def read(self) -> bytes:
        """One datagram."""
        try:
            data, peer = self._socket.recvfrom(_READ_BYTES)
        except (BlockingIOError, ConnectionError):
            return b""
        self._remember(peer, time.monotonic())
        return data

    def write(self, data: bytes) -> None:
        """One datagram; a full queue or a peer that is not up drops it, as the air would."""
        if self._looked_up is not None and (far := self._looked_up.take()) is not None:
            self._looked_up, self._peers[far] = None, -math.inf
        for peer in self._peers:
            with contextlib.suppress(OSError):
                self._socket.sendto(data, peer)

    def close(self) -> None:
        """Give the port back."""
        if self._looked_up is not None:
            self._looked_up.give_up()
        self._socket.close()

    def _remember(self, peer: tuple[str, int], t_s: float) -> None:
        """The one heard now, and others (a ground station's relay) that are not long silent."""
        self._peers.pop(peer, None)
        self._peers[peer] = t_s  # the dictionary keeps them in the order of their last word
        oldest = next(iter(self._peers))
        if len(self._peers) > _MOST_PEERS or t_s - self._peers[oldest] >= _PEER_SILENT_S:
            del self._peers[oldest]


class StreamLink:
    """TCP or a serial port: a stream that may break and is opened again every second.

    It is opened again, and what was lost of it closed, by a thread: either may take long.
    """

    def __init__(self, address: LinkAddress, at_once: bool = True) -> None:
        self._address = address
        self._unsent = b""
        self._queue_limit_bytes = _queue_limit_bytes(address)
        self._port: _StreamHandle | None = self._open() if at_once else None
        self._opener = None if at_once else self._begin_to_open()

    def fileno(self) -> int:
        """Its descriptor, -1 while it is down."""
        return -1 if self._port is None else self._port.fileno()

    def read(self) -> bytes:
        """What has arrived; an end of the stream takes the link down, a second later up again."""
        if self._port is None and self._opener is not None:
            self._port = self._opener.take()
        if self._port is None:
            return b""
        try:
            data = os.read(self._port.fileno(), _READ_BYTES)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._lose()
        return data

    def has_room(self) -> bool:
        """Whether the last packet is out and the system's own queue is short; pushes the rest."""
        self._push()
        if self._port is None or self._unsent:
            return False
        return _queued_bytes(self._port.fileno()) < self._queue_limit_bytes

    def write(self, data: bytes) -> None:
        """Send as much as fits now and the rest before anything else; drop it without room."""
        if self._port is None or self._unsent:
            return
        self._unsent = data
        self._push()

    def _push(self) -> None:
        if self._port is None or not self._unsent:
            return
        try:
            self._unsent = self._unsent[os.write(self._port.fileno(), self._unsent) :]
        except BlockingIOError:
            return
        except OSError:
            self._lose()

    def close(self) -> None:
        """Give the port back."""
        if self._opener is not None:
            self._opener.give_up()
        if self._port is not None:
            self._port.close()
        self._port = None

    def _lose(self) -> None:
        assert self._port is not None
        lost, self._port, self._unsent = self._port, None, b""
        self._opener = self._begin_to_open(lost.close)

    def _begin_to_open(
        self, close_lost: Callable[[], None] | None = None
    ) -> "Opener[_StreamHandle]":
        return Opener(self._open, close_lost, lambda port: port.close())

    def _open(self) -> "_StreamHandle":
        return _open_stream(self._address, _CONNECT_TIMEOUT_S)


class _StreamHandle(Protocol):
    def fileno(self) -> int: ...

    def close(self) -> None: ...


def _looked_up(address: LinkAddress) -> tuple[str, int]:
    return socket.gethostbyname(address.place), address.number


def _queue_limit_bytes(address: LinkAddress) -> int:
    """How much of its stream the system may hold: as much as leaves in `_QUEUE_S`."""
    if address.kind != "serial":
        return _TCP_QUEUE_BYTES
    return max(_SMALLEST_QUEUE_BYTES, int(address.number / _BITS_PER_BYTE * _QUEUE_S))


def _queued_bytes(fd: int) -> int:
    """What was written and has not left (TIOCOUTQ, for sockets SIOCOUTQ); 0 if it never says."""
    count = array.array("i", [0])
    try:
        fcntl.ioctl(fd, termios.TIOCOUTQ, count)
    except OSError:
        return 0
    return count[0]


def _open_stream(address: LinkAddress, timeout_s: float) -> _StreamHandle:
    if address.kind == "serial":
        return _open_serial(address)
    connection = socket.create_connection((address.place, address.number), timeout_s)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    if hasattr(socket, "TCP_USER_TIMEOUT"):  # Linux
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _TCP_DEAD_MS)
    connection.setblocking(False)
    return connection


def _open_serial(address: LinkAddress) -> _StreamHandle:
    """Set up by pyserial (raw, baud rate, exclusive); reading goes past it by os.read."""
    import serial

    try:
        # A time between bytes makes it set VMIN to 1: with 0 the system tells a line that is only
        # silent as it tells one that has ended, by no bytes.
        port: _StreamHandle = serial.Serial(
            address.place, address.number, inter_byte_timeout=0, exclusive=True
        )
    except termios.error as error:  # pulled out meanwhile; no OSError
        raise OSError(*error.args) from error
    os.set_blocking(port.fileno(), False)
    return port
