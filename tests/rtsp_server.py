"""A small RTSP server: JPEG over RTP (RFC 2435), interleaved with RTSP (RFC 2326) on its TCP."""

import itertools
import socketserver
import struct
import time
from collections.abc import Callable, Iterable, Iterator

import cv2
import numpy as np

SDP = (
    "v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=-\r\nt=0 0\r\nm=video 0 RTP/AVP 26\r\na=control:track\r\n"
)
PACKET = 1400
FIRST_STAMP = 7000  # at 90 kHz; of zero FFmpeg makes the second one
FPS = 30


class RtspServer(socketserver.ThreadingTCPServer):
    """Serves `images()` to everybody who plays it, as they come.

    Each is the time in seconds that it says it was sent, and a JPEG file of baseline coding, 4:2:0.
    """

    allow_reuse_address, daemon_threads = True, True

    def __init__(
        self,
        images: Callable[[], Iterable[tuple[float, bytes]]],
        size_wh: tuple[int, int],
        port: int = 0,
    ) -> None:
        self.images, self.size_wh = images, size_wh
        super().__init__(("127.0.0.1", port), Session)

    @property
    def url(self) -> str:
        return f"rtsp://127.0.0.1:{self.server_address[1]}/camera"


class Session(socketserver.StreamRequestHandler):
    server: RtspServer

    def handle(self) -> None:
        while request := self._request():
            method, number = request
            extra, body = "", ""
            if method == "OPTIONS":
                extra = "Public: OPTIONS, DESCRIBE, SETUP, PLAY, TEARDOWN\r\n"
            elif method == "DESCRIBE":
                extra, body = "Content-Type: application/sdp\r\n", SDP
            elif method == "SETUP":
                extra = "Transport: RTP/AVP/TCP;unicast;interleaved=0-1\r\nSession: 7\r\n"
            length = f"Content-Length: {len(body)}\r\n" if body else ""
            head = f"RTSP/1.0 200 OK\r\nCSeq: {number}\r\n{extra}{length}\r\n"
            self.wfile.write((head + body).encode())
            if method == "PLAY":
                self._play()
                return

    def _request(self) -> tuple[str, str] | None:
        method = self.rfile.readline().decode().split(" ")[0].strip()
        number = ""
        while line := self.rfile.readline().decode().strip():
            if line.lower().startswith("cseq:"):
                number = line.split(":")[1].strip()
        return (method, number) if method else None

    def _play(self) -> None:
        sequence, first_s = 0, None
        for sent_s, jpeg in self.server.images():
            first_s = sent_s if first_s is None else first_s
            stamp = FIRST_STAMP + round(90_000 * (sent_s - first_s))
            tables, scan = parts_of(jpeg)
            for offset in range(0, len(scan), PACKET):
                piece = scan[offset : offset + PACKET]
                last = offset + PACKET >= len(scan)
                head = struct.pack(">BBHII", 0x80, 26 | last << 7, sequence, stamp, 1)
                width, height = (side // 8 for side in self.server.size_wh)
                head += struct.pack(">II", offset, 1 << 24 | 255 << 16 | width << 8 | height)
                head += struct.pack(">HH", 0, len(tables)) + tables if offset == 0 else b""
                packet = head + piece
                sequence = (sequence + 1) % 65536
                try:
                    self.connection.sendall(b"$\0" + struct.pack(">H", len(packet)) + packet)
                except (TimeoutError, OSError):
                    return


def parts_of(jpeg: bytes) -> tuple[bytes, bytes]:
    """Both quantisation tables of a JPEG file, and what follows its start of scan."""
    at, tables = 2, b""
    while True:
        marker, length = struct.unpack(">xBH", jpeg[at : at + 4])
        segment = jpeg[at + 4 : at + 2 + length]
        if marker == 0xDB:
            tables += b"".join(segment[i + 1 : i + 65] for i in range(0, len(segment), 65))
        at += 2 + length
        if marker == 0xDA:
            return tables, jpeg[at:-2]


def steadily(make: Callable[[int], np.ndarray]) -> Iterator[tuple[float, bytes]]:
    """What a camera of `FPS` images a second sends, numbered from 0."""
    begun_s = time.monotonic()
    for number in itertools.count():
        yield number / FPS, cv2.imencode(".jpg", make(number))[1].tobytes()
        time.sleep(max(0.0, begun_s + (number + 1) / FPS - time.monotonic()))


def bright(number: int) -> np.ndarray:
    """(120, 160, 3) of one brightness."""
    return np.full((120, 160, 3), 20 + 5 * (number % 40), np.uint8)
