"""Opens what delivers images: live cameras, streams, video files, folders of images."""

import re
from pathlib import Path

from vwnav.cameras.gstreamer import GstreamerGrabber
from vwnav.cameras.image_folder import ImageFolder
from vwnav.cameras.live import (
    AskedImages,
    PixelFormat,
    RealTimeSource,
    StreamGrabber,
    V4l2Grabber,
)
from vwnav.cameras.picamera import PicameraGrabber
from vwnav.cameras.video_file import VideoFile
from vwnav.errors import SourceError
from vwnav.geometry.sensor_mode import SensorMode
from vwnav.recording.reader import RecordedFrames
from vwnav.seams import FrameSource

_PICAMERA = re.compile(r"picamera2(?::(\d+)x(\d+)(?:@(\d+))?)?")
_SIZE = r"(\d+)x(\d+)(?:@(\d+(?:\.\d+)?))?"
_DEVICE = re.compile(rf"(/dev/.+?)(?::{_SIZE})?(?::(MJPG|YUYV|GREY))?")
_GSTREAMER = re.compile(rf"gst:{_SIZE}:(.+)", re.DOTALL)
_STREAM_SCHEMES = ("rtsp://", "rtsps://", "http://", "https://", "udp://", "rtp://", "tcp://")
DEFAULT_FOLDER_FPS = 1.0


def open_source(
    text: str, fps: float | None = None, mode: SensorMode | None = None, at_once: bool = True
) -> FrameSource:
    """Open the images that `text` names.

    Args:
        text: a video file, a folder of images, a recording of vwnav (`.mcap`),
            `/dev/video0[:WIDTHxHEIGHT[@FPS]][:MJPG|YUYV|GREY]`, `picamera2[:WIDTHxHEIGHT[@FPS]]`,
            `gst:WIDTHxHEIGHT[@FPS]:PIPELINE`, or the URL of a stream (`rtsp://...`).
        fps: rate of a folder's images where they carry no time of their own; the rate wanted of
            a live camera.
        mode: of its sensor that is wanted of a live camera, as far as it can be told.
        at_once: a live camera has to be there now; else it is waited for like one that has failed.

    Raises:
        SourceError: it is not there, cannot be opened, or is none of these.
    """
    picamera = _PICAMERA.fullmatch(text)
    if picamera is not None:
        size, rate = _asked(text, *picamera.groups())
        size, wanted_fps = size or (1920, 1080), fps or rate or 30.0
        return RealTimeSource(lambda: PicameraGrabber(*size, wanted_fps, mode), at_once=at_once)
    if text.startswith(_STREAM_SCHEMES):
        return RealTimeSource(lambda: StreamGrabber(text), at_once=at_once)
    if text.startswith("gst:"):
        return _gstreamer(text, fps, at_once)
    device = _DEVICE.fullmatch(text)
    if device is not None and (not at_once or Path(device[1]).is_char_device()):
        return _video4linux(device, fps, mode, at_once)
    path = Path(text)
    if path.is_dir():
        return ImageFolder(path, fps or DEFAULT_FOLDER_FPS)
    if path.suffix == ".mcap" and path.is_file():
        return RecordedFrames(path)
    if path.is_file():
        return VideoFile(path)
    raise SourceError(
        f"no pictures at {text!r}: give a video file, a folder of pictures, "
        "/dev/videoN[:640x480[@30]][:MJPG|YUYV|GREY], picamera2, gst:640x480:PIPELINE or rtsp://..."
    )


def _video4linux(
    found: re.Match[str], fps: float | None, mode: SensorMode | None, at_once: bool
) -> FrameSource:
    name, *numbers, pixels = found.groups()
    size_wh, rate = _asked(found.string, *numbers)
    if pixels is None and mode is not None:
        pixels = mode.pixels
    known: dict[str | None, PixelFormat] = {"MJPG": "MJPG", "YUYV": "YUYV", "GREY": "GREY"}
    asked = AskedImages(size_wh, fps or rate, known.get(pixels))
    return RealTimeSource(lambda: V4l2Grabber(name, asked), at_once=at_once)


def _gstreamer(text: str, fps: float | None, at_once: bool) -> FrameSource:
    found = _GSTREAMER.fullmatch(text)
    if found is None:
        raise SourceError(
            f"{text!r} does not say its size: gst:640x480@30:libcamerasrc, for example"
        )
    *numbers, pipeline = found.groups()
    size_wh, rate = _asked(text, *numbers)
    assert size_wh is not None
    wanted_fps = fps or rate or 30.0
    return RealTimeSource(lambda: GstreamerGrabber(pipeline, *size_wh, wanted_fps), at_once=at_once)


def _asked(
    text: str, width: str | None, height: str | None, rate: str | None
) -> tuple[tuple[int, int] | None, float | None]:
    """Size and rate by the digits of a camera's name.

    Raises:
        SourceError: one of them is 0.
    """
    size_wh = (int(width), int(height)) if width and height else None
    fps = float(rate) if rate else None
    if fps == 0.0 or (size_wh is not None and min(size_wh) == 0):
        raise SourceError(f"{text!r} asks for 0: width, height and rate are 1 or more")
    return size_wh, fps
