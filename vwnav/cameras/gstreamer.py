"""Images of a GStreamer pipeline, through a pipe: OpenCV's wheels are built without GStreamer."""

import contextlib
import math
import os
import select
import shlex
import shutil
import struct
import subprocess
import tempfile
import time

import numpy as np
from numpy.typing import NDArray

from vwnav.cameras import SILENT_S
from vwnav.cameras.stream_times import StreamTimes
from vwnav.errors import SourceError

_LAUNCH = "gst-launch-1.0"
_NEEDED = (
    "sudo apt install gstreamer1.0-tools gstreamer1.0-plugins-good gstreamer1.0-plugins-bad "
    "gstreamer1.0-libcamera"
)
# GStreamer Data Protocol 1.0, before each packet: its kind, the length of what follows, and the
# time of a buffer in ns (gstdataprotocol, dp-private.h); big-endian, 62 bytes.
_HEADER = struct.Struct(">4xHIQ44x")
_BUFFER, _NO_TIME = 1, 2**64 - 1
_MOST_BYTES = 1 << 16  # of a packet that is no image: events and formats are a few hundred
_CLOSE_S = 2.0
_BEGINS_S = 10.0  # a pipeline that runs, and gives nothing for so long at first, has failed


class GstreamerGrabber:
    """Gray images of a pipeline that `gst-launch-1.0` runs; the end of it is ours.

    GStreamer Data Protocol (its `gdppay`) tells the time of each: an image that waited for us, on
    a busy machine, keeps the time that the pipeline gave it. As of a stream, one that comes as fast
    as any is taken to be one period old, and those that lay ready at first are left out.

    Raises:
        SourceError: GStreamer is not there, or the pipeline gives no image.
    """

    def __init__(self, pipeline: str, width_px: int, height_px: int, fps: float) -> None:
        if shutil.which(_LAUNCH) is None:
            raise SourceError(f"{_LAUNCH} is not there: `{_NEEDED}`")
        self._size_wh, self._period_s = (width_px, height_px), 1.0 / fps
        self._stride = -(-width_px // 4) * 4  # GStreamer's rows begin at multiples of four
        gray = f"video/x-raw,format=GRAY8,width={width_px},height={height_px}"
        ours = f"videoconvert ! videoscale ! {gray} ! gdppay ! fdsink fd=1 sync=false"
        try:
            command = [_LAUNCH, "-q", *shlex.split(f"{pipeline} ! {ours}")]
        except ValueError as error:
            raise SourceError(f"the GStreamer pipeline cannot be read: {error}") from error
        self._said = tempfile.TemporaryFile()  # noqa: SIM115  # as long as the process
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=self._said,
            bufsize=0,
        )
        self._times = StreamTimes()
        self._patience_s = _BEGINS_S
        self._first = self._read()
        if self._first is None:
            why = self._complaint()
            self.close()
            raise SourceError(f"the GStreamer pipeline gives no picture: {why}")
        self._patience_s = SILENT_S

    def grab(self) -> tuple[float, NDArray[np.uint8]] | None:
        """The next image."""
        first, self._first = self._first, None
        return self._read() if first is None else first

    def close(self) -> None:
        """End the pipeline."""
        self._process.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_CLOSE_S)
        self._process.kill()
        self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()
        self._said.close()

    def _read(self) -> tuple[float, NDArray[np.uint8]] | None:
        """The next image whose age is known, and its exposure; None when no more comes."""
        width_px, height_px = self._size_wh
        while (packet := self._packet()) is not None:
            kind, time_ns, data = packet
            if kind != _BUFFER:
                continue
            if len(data) != self._stride * height_px:
                return None
            stamp_s = math.nan if time_ns == _NO_TIME else time_ns * 1e-9
            sent_s = self._times.sent_s(stamp_s, time.monotonic())
            if sent_s is None:
                continue
            rows = np.frombuffer(data, np.uint8).reshape(height_px, self._stride)
            image = np.ascontiguousarray(rows[:, :width_px])
            return sent_s - self._period_s, image
        return None

    def _packet(self) -> tuple[int, int, bytearray] | None:
        """(kind, time in the pipeline in ns, what it carries)."""
        header = self._bytes(_HEADER.size)
        if header is None:
            return None
        kind, length, time_ns = _HEADER.unpack(header)
        if length > max(_MOST_BYTES, self._stride * self._size_wh[1]):
            return None
        data = self._bytes(length)
        return None if data is None else (kind, time_ns, data)

    def _bytes(self, count: int) -> bytearray | None:
        """So many of the pipe; None when it has ended, or gives nothing."""
        assert self._process.stdout is not None
        pipe, data = self._process.stdout.fileno(), bytearray()
        while (lacking := count - len(data)) > 0:
            comes, _, _ = select.select([pipe], [], [], self._patience_s)
            part = os.read(pipe, lacking) if comes else b""
            if not part:
                return None
            data += part
        return data

    def _complaint(self) -> str:
        """What GStreamer says of it, one line."""
        try:
            self._process.wait(_CLOSE_S)
        except subprocess.TimeoutExpired:
            return f"it runs, and gave none for {_BEGINS_S:.0f} s"
        self._said.seek(0)
        lines = self._said.read().decode(errors="replace").splitlines()
        why = next((line for line in lines if "ERROR" in line or "WARNING" in line), "it ended")
        return f"{why}: `{_NEEDED}`" if "gdppay" in why else why
