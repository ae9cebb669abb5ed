"""Opens what delivers pictures: live cameras, streams, video files, folders of pictures."""

import re
from pathlib import Path

from vwnav.cameras.image_folder import ImageFolder
from vwnav.cameras.live import PicameraGrabber, RealTimeSource, StreamGrabber, V4l2Grabber
from vwnav.cameras.video_file import VideoFile
from vwnav.errors import SourceError
from vwnav.recording.reader import RecordedFrames
from vwnav.types import FrameSource

_PICAMERA = re.compile(r"picamera2(?::(\d+)x(\d+)(?:@(\d+))?)?")
_STREAM_SCHEMES = ("rtsp://", "rtsps://", "http://", "https://", "udp://", "rtp://", "tcp://")
DEFAULT_FOLDER_FPS = 1.0


def open_source(text: str, fps: float | None = None) -> FrameSource:
    """Open the pictures that `text` names.

    Args:
        text: a video file, a folder of pictures, a recording of vwnav (`.mcap`), `/dev/video0`,
            `picamera2[:WIDTHxHEIGHT[@FPS]]`, or the URL of a stream (`rtsp://...`).
        fps: rate of a folder's pictures where they carry no time of their own; the rate wanted of
            a live camera.

    Raises:
        SourceError: it is not there, cannot be opened, or is none of these.
    """
    picamera = _PICAMERA.fullmatch(text)
    if picamera is not None:
        width, height, rate = (int(part) if part else None for part in picamera.groups())
        size, wanted_fps = (width or 1920, height or 1080), fps or rate or 30.0
        return RealTimeSource(lambda: PicameraGrabber(*size, wanted_fps))
    if text.startswith(_STREAM_SCHEMES):
        return RealTimeSource(lambda: StreamGrabber(text))
    path = Path(text)
    if path.is_dir():
        return ImageFolder(path, fps or DEFAULT_FOLDER_FPS)
    if path.is_char_device():
        return RealTimeSource(lambda: V4l2Grabber(text, fps or 30.0))
    if path.suffix == ".mcap" and path.is_file():
        return RecordedFrames(path)
    if path.is_file():
        return VideoFile(path)
    raise SourceError(
        f"no pictures at {text!r}: give a video file, a folder of pictures, /dev/videoN, "
        "picamera2 or rtsp://..."
    )
