"""The way to a simulator that tells its truth: UDP either way round, or TCP."""

import contextlib
import logging
import socket
import time

from vwnav.errors import ConfigError, LinkError

_log = logging.getLogger(__name__)
_WAIT_S = 0.2
_CONNECT_S, _CONNECT_AGAIN_S = 5.0, 1.0
_DATAGRAM = 65536

Address = tuple[str, int]
Source = Address | int  # who spoke: an address, or the number of a connection


class TruthLine:
    """Bytes to and from whoever is there; a connection that ends is made anew until it stands.

    A simulator that is started anew closes its ports and opens them again. ArduPilot's opens those
    of its other links only when somebody has connected to the first, so one is waited for.

    Args:
        url: udpin:HOST:PORT, udpout:HOST:PORT or tcpout:HOST:PORT, or as MAVSDK writes them: "//"
            after the colon, udp for udpin, no host to listen everywhere, tcp for tcpout.

    Attributes:
        is_stream: bytes come in an order, not in datagrams.

    Raises:
        ConfigError: the URL is none of these.
        LinkError: the port is taken, or nobody has come to listen at a tcpout URL.
    """

    def __init__(self, url: str) -> None:
        kind, self._address = _parsed(url)
        self.is_stream = kind == "tcpout"
        self._connections = 0
        self._peer = self._address if kind == "udpout" else None
        self._socket: socket.socket | None
        try:
            if self.is_stream:
                self._socket = self._awaited()
            else:
                self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
                self._socket.settimeout(_WAIT_S)
                self._socket.bind(self._address if kind == "udpin" else ("0.0.0.0", 0))
        except OSError as error:
            raise LinkError(f"cannot open {url} for the truth: {error}") from error

    def read(self) -> tuple[bytes, Source]:
        """What arrived within 0.2 s, and from whom."""
        if self._socket is None and not self._reconnect():
            return b"", self._connections
        assert self._socket is not None
        try:
            if not self.is_stream:
                return self._socket.recvfrom(_DATAGRAM)
            data = self._socket.recv(_DATAGRAM)
        except TimeoutError:
            return b"", self._connections
        except OSError as error:  # a UDP peer that is not there yet, a reset TCP connection
            _log.debug("truth: %s", error)
            time.sleep(_WAIT_S)
            data = b""
        if self.is_stream and not data:
            self._socket.close()
            self._socket = None
        return data, self._connections

    def talk_to(self, source: Source) -> None:
        """Who said something of sense is who hears what is sent."""
        if isinstance(source, tuple):
            self._peer = source

    def send(self, packet: bytes) -> None:
        """To who is there; lost where nobody is."""
        try:
            if self._socket is not None and self.is_stream:
                self._socket.sendall(packet)
            elif self._socket is not None and self._peer is not None:
                self._socket.sendto(packet, self._peer)
        except OSError as error:
            _log.debug("truth: %s", error)

    def close(self) -> None:
        """Free the port."""
        if self._socket is not None:
            self._socket.close()

    def _awaited(self) -> socket.socket:
        """The first connection, as soon as somebody listens."""
        until_s = time.monotonic() + _CONNECT_S
        while True:
            try:
                return self._connected(max(until_s - time.monotonic(), _WAIT_S))
            except ConnectionRefusedError:
                if time.monotonic() >= until_s:
                    raise
            time.sleep(_WAIT_S)

    def _connected(self, timeout_s: float) -> socket.socket:
        connection = socket.create_connection(self._address, timeout_s)
        connection.settimeout(_WAIT_S)
        self._connections += 1
        return connection

    def _reconnect(self) -> bool:
        with contextlib.suppress(OSError):
            self._socket = self._connected(_CONNECT_AGAIN_S)
            return True
        time.sleep(_WAIT_S)
        return False


def _parsed(url: str) -> tuple[str, Address]:
    """udpin, udpout or tcpout, and where."""
    kind, _, rest = url.partition(":")
    host, _, port = rest.removeprefix("//").rpartition(":")
    if kind in ("udp", "udpin"):
        kind, host = "udpin", host or "0.0.0.0"
    kind = "tcpout" if kind == "tcp" else kind
    if kind not in ("udpin", "udpout", "tcpout") or not host or not port.isdigit():
        raise ConfigError(f"{url!r} is no link to the truth: write udpout:HOST:PORT or tcpout:...")
    return kind, (host, int(port))
