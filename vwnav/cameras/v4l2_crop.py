"""The part of its sensor that a Video4Linux camera shows (linux/videodev2.h)."""

import fcntl
import os
import struct

# VIDIOC_G_SELECTION with struct v4l2_selection: type, target, flags, left, top, width, height.
SELECTION = struct.Struct("=IIIiiII36x")
GET_SELECTION = 0xC040565E
CAPTURE, CROP = 1, 0  # V4L2_BUF_TYPE_VIDEO_CAPTURE, V4L2_SEL_TGT_CROP


def seen_part(device: str) -> tuple[int, int, int, int] | None:
    """Left, top, width and height, in the sensor's pixels; None where the driver does not say."""
    asked = SELECTION.pack(CAPTURE, CROP, 0, 0, 0, 0, 0)
    try:
        fd = os.open(device, os.O_RDWR | os.O_NONBLOCK)
        try:
            answer = SELECTION.unpack(fcntl.ioctl(fd, GET_SELECTION, asked))
        finally:
            os.close(fd)
    except OSError:
        return None
    left, top, width, height = answer[3:]
    return (left, top, width, height) if min(left, top) >= 0 < min(width, height) else None
