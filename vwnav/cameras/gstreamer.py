"""Images of a GStreamer pipeline, through a pipe: OpenCV's wheels are built without GStreamer."""

import contextlib
import os
import select
import shlex
import shutil
import subprocess
import tempfile
import time

import numpy as np
from numpy.typing import NDArray

from vwnav.errors import SourceError

_LAUNCH = "gst-launch-1.0"
_CLOSE_S = 2.0
_SILENT_S = 10.0  # a pipeline that runs, and gives nothing for so long, has failed


class GstreamerGrabber:
    """Gray images of a pipeline that `gst-launch-1.0` runs; the end of it is ours.

    Images are stamped at arrival less one period, as those of a stream are.

    Raises:
        SourceError: GStreamer is not there, or the pipeline gives no image.
    """

    def __init__(self, pipeline: str, width_px: int, height_px: int, fps: float) -> None:
        if shutil.which(_LAUNCH) is None:
            raise SourceError(
                f"{_LAUNCH} is not there: `sudo apt install gstreamer1.0-tools "
                "gstreamer1.0-plugins-good gstreamer1.0-libcamera`"
            )
        self._size_wh, self._period_s = (width_px, height_px), 1.0 / fps
        self._stride = -(-width_px // 4) * 4  # GStreamer's rows begin at multiples of four
        gray = f"video/x-raw,format=GRAY8,width={width_px},height={height_px}"
        ours = f"videoconvert ! videoscale ! {gray} ! fdsink fd=1 sync=false"
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
        self._first = self._read()
        if self._first is None:
            why = self._complaint()
            self.close()
            raise SourceError(f"the GStreamer pipeline gives no picture: {why}")

    def grab(self) -> tuple[float, NDArray[np.uint8]] | None:
        """The next image."""
        image, self._first = self._first, None
        image = self._read() if image is None else image
        return None if image is None else (time.monotonic() - self._period_s, image)

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

    def _read(self) -> NDArray[np.uint8] | None:
        assert self._process.stdout is not None
        width_px, height_px = self._size_wh
        pipe, data = self._process.stdout.fileno(), bytearray()
        while (lacking := self._stride * height_px - len(data)) > 0:
            comes, _, _ = select.select([pipe], [], [], _SILENT_S)
            part = os.read(pipe, lacking) if comes else b""
            if not part:
                return None
            data += part
        rows = np.frombuffer(data, np.uint8).reshape(height_px, self._stride)
        return np.ascontiguousarray(rows[:, :width_px])

    def _complaint(self) -> str:
        """What GStreamer says of it, one line."""
        try:
            self._process.wait(_CLOSE_S)
        except subprocess.TimeoutExpired:
            return f"it runs, and gave none for {_SILENT_S:.0f} s"
        self._said.seek(0)
        lines = self._said.read().decode(errors="replace").splitlines()
        return next((line for line in lines if "ERROR" in line or "WARNING" in line), "it ended")
