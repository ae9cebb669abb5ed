"""A video file as a source of images, with the container's own time stamps."""

import logging
import os
from collections import deque
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.cameras.video_container import is_bare_stream, is_cut_off, what_is_counted
from vwnav.errors import SourceError
from vwnav.types import Frame

_log = logging.getLogger(__name__)
# A cut-off file may yield a half decoded last image; with B-frames it is not the last in time.
_HELD_BACK = 3
# Containers may count a few that are not shown.
_COUNT_TOLERANCE = 3
# A picture that cannot be decoded, and those that are coded on it, until a key picture comes.
_MOST_BROKEN = 300


def quieten_decoder() -> None:
    """Keep OpenCV's and FFmpeg's own lines off stderr: what is wrong is said once, by us.

    OpenCV reads the variable when it first uses FFmpeg; a value that is already set stays.
    """
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # AV_LOG_QUIET
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_ERROR)


def for_opencv(name: str) -> str:
    """The name of a file, device or stream, as it is.

    Raises:
        SourceError: it is not written in UTF-8: OpenCV ends the process at one.
    """
    try:
        name.encode()
    except UnicodeEncodeError as error:
        raise SourceError(
            f"{name}: a name that is not UTF-8 cannot be opened; rename it"
        ) from error
    return name


class VideoFile:
    """A `FrameSource` over a video file; `t_s` is the video's own time, from 0.

    Images are as the camera took them, not turned as a player is asked to show them.

    Raises:
        SourceError: the file is no video that can be opened.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._cut_off, self._counted = is_cut_off(path), what_is_counted(path)
        quieten_decoder()
        # What stands before a colon FFmpeg takes for a protocol: a date and time, say.
        self._video = cv2.VideoCapture(for_opencv(str(path.absolute())), cv2.CAP_FFMPEG)
        if not self._video.isOpened():
            why = "the file ends too early" if self._cut_off else "unknown format, or damaged"
            raise SourceError(f"{path} is not a video that can be opened: {why}")
        self._video.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
        if turned_deg := self._video.get(cv2.CAP_PROP_ORIENTATION_META):
            _log.warning("%s asks to be shown turned by %.0f degrees: its pictures are taken as "
                         "the camera took them", path, turned_deg)  # fmt: skip
        self._fps = self._video.get(cv2.CAP_PROP_FPS) or 30.0
        self._expected = int(self._video.get(cv2.CAP_PROP_FRAME_COUNT))
        if is_bare_stream(path):
            self._say_its_rate()
        self._index, self._goes_on = 0, False  # after damage
        self._last_t_s = -1.0
        self._ahead: deque[Frame] = deque()
        self._coming = self._decoded()

    def next_frame(self) -> Frame | None:
        """The next image, None after the last.

        Raises:
            SourceError: there is none at all, or the file ends in the middle of an image; every
                image before it has been handed out.
        """
        wanted = 1 + (_HELD_BACK if self._cut_off else 0)
        while len(self._ahead) < wanted:
            frame = self._read()
            if frame is None:
                self._check_end()
                return None
            self._ahead.append(frame)
        return self._ahead.popleft()

    def close(self) -> None:
        """Close the file."""
        self._video.release()

    def _say_its_rate(self) -> None:
        _log.warning("%s holds no times, and is taken as %g pictures a second; if that is not so: "
                     "`ffmpeg -r RATE -i %s -c copy other.mp4`",
                     self._path, self._fps, self._path.name)  # fmt: skip

    def _read(self) -> Frame | None:
        now, self._coming = self._coming, None
        if now is None:
            return None
        self._coming = self._decoded()
        self._last_t_s, index = self._time_of(now[0]), self._index
        self._index += 1
        return Frame(self._last_t_s, now[1], index)

    def _decoded(self) -> tuple[float, NDArray[np.uint8]] | None:
        """The next image that can be decoded, and its stamp, s; None after the last."""
        for broken in range(_MOST_BROKEN):
            good, image = self._video.read()
            if good:
                stamp_s = self._video.get(cv2.CAP_PROP_POS_MSEC) / 1e3
                if broken:
                    self._goes_on = True
                    _log.warning("%s is damaged about %.1f s: pictures are missing there",
                                 self._path, stamp_s)  # fmt: skip
                return stamp_s, np.asarray(image, dtype=np.uint8)
        return None

    def _time_of(self, stamp_s: float) -> float:
        """A stamp as it is, but where it does not go on, or the next one does and it does not.

        A container may have no stamps, or broken ones; one in the far future dates that image
        alone wrongly, not all that follow.
        """
        ahead = self._coming is not None and self._last_t_s < self._coming[0] <= stamp_s
        if stamp_s > self._last_t_s and not ahead:
            return stamp_s
        return self._last_t_s + 1.0 / self._fps if self._index else 0.0

    def _check_end(self) -> None:
        if self._index == 0:
            fourcc = int(self._video.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little")
            coding = fourcc.decode("latin-1").strip()
            raise SourceError(
                f"{self._path} holds no picture that can be read: it is damaged, or of a coding "
                f"that is not known here ({coding}); where a player shows it, "
                f"`ffmpeg -i {self._path.name} -c:v libx264 other.mp4` makes one that is"
            )
        missing = self._missing()
        if self._cut_off or missing > _COUNT_TOLERANCE:
            at = max(0, self._index - len(self._ahead))
            of = f" of {self._index + missing}" if missing > 0 else ""
            raise SourceError(
                f"{self._path} ends in the middle of picture {at + 1}{of}: it is damaged, or its "
                "recording or copy was not finished; copy it again or cut it before that picture"
            )

    def _missing(self) -> int:
        """How many more pictures the container says there are; 0 where it does not say."""
        if self._counted == "pictures" and not self._goes_on:
            return self._expected - self._index
        if self._counted is not None:  # periods before the last picture may be empty
            period_s = self._last_t_s / (self._index - 1) if self._index > 1 else 1.0 / self._fps
            return round((self._expected / self._fps - self._last_t_s) / period_s) - 1
        return 0
