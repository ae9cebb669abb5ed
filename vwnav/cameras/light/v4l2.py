"""Exposure and gain of a Video4Linux camera, by its controls (linux/v4l2-controls.h).

The descriptor that images come by is OpenCV's. Another one is opened for each exchange alone: a
camera that is pulled out while somebody holds it open comes back under another name.
"""

import errno
import fcntl
import os
import struct
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from vwnav.cameras.light.control import Light, LightRange
from vwnav.errors import SourceError

EXPOSURE_UNIT_S = 1e-4  # V4L2_CID_EXPOSURE_ABSOLUTE counts 100 us
# V4L2_CID_EXPOSURE_AUTO, V4L2_CID_EXPOSURE_ABSOLUTE, V4L2_CID_GAIN
AUTO, EXPOSURE, GAIN = 0x009A0901, 0x009A0902, 0x00980913
MANUAL = 1  # V4L2_EXPOSURE_MANUAL
# VIDIOC_QUERYCTRL, VIDIOC_G_CTRL, VIDIOC_S_CTRL of linux/videodev2.h, and what they carry:
# id, type, name, minimum, maximum, step, default, flags; id, value.
QUERY, GET, SET = 0xC0445624, 0xC008561B, 0xC008561C
QUERIED, CONTROL = struct.Struct("=II32siiiiI8x"), struct.Struct("=Ii")
_UNUSABLE = 0x0001 | 0x0004  # V4L2_CTRL_FLAG_DISABLED, V4L2_CTRL_FLAG_READ_ONLY
# What a gain's number does is the camera's own affair: from its least to its most it is taken to
# amplify so many times, evenly. The controller bears it where that is not so.
_MOST_GAIN = 16.0


class V4l2LightControls:
    """A camera's exposure and gain; without a gain the exposure alone.

    Attributes:
        exposure_s: of the newest image, for whoever must not wait for the camera; None while the
            camera is left to itself.

    Raises:
        SourceError: it has no exposure that can be set.
    """

    def __init__(self, device: str, period_s: float) -> None:
        self._device = device
        self.exposure_s: float | None = None
        self._found: dict[int, int] = {}  # before anything was set
        try:
            with self._opened() as fd:
                _query(fd, AUTO)
                low, high, step = _query(fd, EXPOSURE)
                self._gains = _range_or_none(fd, GAIN)
        except OSError as error:
            raise SourceError(f"it has no control for that ({error.strerror})") from error
        self.span = LightRange(
            shortest_s=max(low, 1) * EXPOSURE_UNIT_S,
            longest_s=min(high * EXPOSURE_UNIT_S, period_s),
            step_s=max(step, 1) * EXPOSURE_UNIT_S,
            least_gain=1.0,
            most_gain=1.0 if self._gains is None else _MOST_GAIN,
        )

    def now(self) -> Light:
        """What is set; in its own automatic, what the camera has chosen."""
        with self._opened() as fd:
            self.exposure_s = _get(fd, EXPOSURE) * EXPOSURE_UNIT_S
            if self._gains is None:
                return Light(self.exposure_s, 1.0)
            low, high, _ = self._gains
            share = (_get(fd, GAIN) - low) / (high - low)
            return Light(self.exposure_s, 1.0 + share * (_MOST_GAIN - 1.0))

    def set(self, light: Light) -> None:
        """Expose by hand, with this; the camera rounds it."""
        wanted = {AUTO: MANUAL, EXPOSURE: round(light.exposure_s / EXPOSURE_UNIT_S)}
        if self._gains is not None:
            low, high, step = self._gains
            share = (light.gain - 1.0) / (_MOST_GAIN - 1.0)
            wanted[GAIN] = low + step * round(share * (high - low) / step)
        with self._opened() as fd:
            self._found = self._found or {number: _get(fd, number) for number in wanted}
            for number, value in wanted.items():
                _set(fd, number, value)

    def release(self) -> None:
        """As it was found: what is set by hand first, which its automatic forbids."""
        self.exposure_s = None
        with self._opened() as fd:
            for number, value in reversed(self._found.items()):
                with suppress(OSError):
                    _set(fd, number, value)

    @contextmanager
    def _opened(self) -> Iterator[int]:
        fd = os.open(self._device, os.O_RDWR | os.O_NONBLOCK)
        try:
            yield fd
        finally:
            os.close(fd)


def _range_or_none(fd: int, number: int) -> tuple[int, int, int] | None:
    try:
        low, high, step = _query(fd, number)
    except OSError:
        return None
    return (low, high, max(step, 1)) if high > low else None


def _query(fd: int, number: int) -> tuple[int, int, int]:
    """(least, most, step) of a control that can be set."""
    answer = QUERIED.unpack(fcntl.ioctl(fd, QUERY, QUERIED.pack(number, 0, b"", 0, 0, 0, 0, 0)))
    if answer[7] & _UNUSABLE:
        raise OSError(errno.EACCES, "it can only be read")
    return answer[3], answer[4], answer[5]


def _get(fd: int, number: int) -> int:
    return int(CONTROL.unpack(fcntl.ioctl(fd, GET, CONTROL.pack(number, 0)))[1])


def _set(fd: int, number: int, value: int) -> None:
    fcntl.ioctl(fd, SET, CONTROL.pack(number, value))
