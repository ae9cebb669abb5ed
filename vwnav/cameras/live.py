"""Live cameras and streams: a thread takes every image, the newest one is handed out."""

import logging
import os
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.cameras import SILENT_S
from vwnav.cameras.light.keeper import LightKeeper
from vwnav.cameras.light.v4l2 import EXPOSURE_UNIT_S, V4l2LightControls
from vwnav.cameras.modes import mode_of
from vwnav.cameras.stream_times import StreamTimes
from vwnav.cameras.v4l2_crop import seen_part
from vwnav.cameras.video_file import for_opencv, quieten_decoder
from vwnav.errors import SourceError
from vwnav.geometry.sensor_mode import SensorMode
from vwnav.types import Frame

_log = logging.getLogger(__name__)
_NO_IMAGE_TIMEOUT_S = 5.0
_AGAIN_S = 0.3  # between attempts to open a camera that is not there
_STOP_TIMEOUT_S = 2.0
_OPEN_TIMEOUT_MS = 5000
# OpenCV waits for 10 s otherwise; read, in whole seconds, when it first waits for an image.
_V4L2_TIMEOUT = "OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT"
_DRIVER_STAMP_LIMIT_S = 1.0
_BAD_IN_A_ROW = 30  # pictures that no decoder takes: a second of them is a camera that has failed


class Grabber(Protocol):
    """A camera as the grabbing thread sees it."""

    def grab(self) -> tuple[float, NDArray[np.uint8]] | None:
        """(exposure time on the monotonic clock, image), waiting for it; None when it failed."""
        ...

    def close(self) -> None:
        """Give the camera back; called from the grabbing thread."""
        ...


class RealTimeSource:
    """A `FrameSource` that never queues: an image not fetched in time is replaced by the next.

    A camera that fails is opened again until it is there: who asks meanwhile is told that it fails,
    and asks again.

    Args:
        open_camera: opens it, now and whenever it has failed.
        timeout_s: to wait for an image.
        at_once: it has to be there now; else it is waited for like one that has failed.

    Attributes:
        dropped: images that were replaced before anybody fetched them.
        sensor_mode: of the newest image; None where the camera's driver does not say.
    """

    def __init__(
        self,
        open_camera: Callable[[], Grabber],
        timeout_s: float = _NO_IMAGE_TIMEOUT_S,
        at_once: bool = True,
    ) -> None:
        self._open_camera = open_camera
        grabber = open_camera() if at_once else None
        self._timeout_s = timeout_s
        self._newest: Frame | None = None
        self._count = 0
        self._closed = False
        self._failed = grabber is None
        self._arrived = threading.Condition()
        self.dropped = 0
        self.sensor_mode: SensorMode | None = None
        self._keeper: LightKeeper | None = None
        self._thread = threading.Thread(
            target=self._run, args=(grabber,), name="camera", daemon=True
        )
        self._thread.start()

    def next_frame(self) -> Frame | None:
        """The newest image that was not handed out yet; waits for one. None once closed.

        Raises:
            SourceError: the camera delivers nothing any more.
        """
        with self._arrived:
            self._arrived.wait_for(self._has_news, self._timeout_s)
            if self._closed:
                return None
            frame, self._newest = self._newest, None
            if frame is None:
                raise SourceError(
                    "the camera delivers no pictures any more: check its cable, and that no other "
                    "program uses it"
                )
            return frame

    def hold_exposure(self, most_s: Callable[[], float], say: Callable[[str], None]) -> LightKeeper:
        """From now on, and after each time it is opened anew, see `LightKeeper`."""
        self._keeper = LightKeeper(most_s, say)
        return self._keeper

    def close(self) -> None:
        """Stop grabbing and give the camera back."""
        if self._keeper is not None:
            self._keeper.close()
        with self._arrived:
            self._closed = True
            self._arrived.notify_all()
        self._thread.join(_STOP_TIMEOUT_S)

    def _has_news(self) -> bool:
        return self._newest is not None or self._closed or self._failed

    def _run(self, grabber: Grabber | None) -> None:
        grabber = grabber or self._opened()
        while grabber is not None:
            self._grab_until_it_fails(grabber)
            self._fail()
            grabber = None if self._is_closed_within(_AGAIN_S) else self._opened()

    def _grab_until_it_fails(self, grabber: Grabber) -> None:
        try:
            while not self._closed:
                grabbed = grabber.grab()
                if grabbed is None:
                    return
                self.sensor_mode = mode_of(grabber)
                self._hand_over(*grabbed)
                if self._keeper is not None:
                    self._keeper.saw(grabber, grabbed[1])
        except Exception as error:  # whatever a driver raises when its camera is pulled out
            _log.warning("the camera failed: %r", error)
            _log.debug("it failed here", exc_info=True)
        finally:
            with suppress(Exception):
                grabber.close()

    def _fail(self) -> None:
        with self._arrived:
            self._failed = True
            self._arrived.notify_all()

    def _opened(self) -> Grabber | None:
        """The camera once it is there; None when the source is closed before."""
        while True:
            try:
                return self._open_camera()
            except Exception as error:
                _log.debug("the camera is not there yet: %s", error)
            if self._is_closed_within(_AGAIN_S):
                return None

    def _is_closed_within(self, seconds: float) -> bool:
        with self._arrived:
            return self._arrived.wait_for(lambda: self._closed, seconds)

    def _hand_over(self, t_s: float, image: NDArray[np.uint8]) -> None:
        with self._arrived:
            self.dropped += self._newest is not None
            self._newest, self._failed = Frame(t_s, image, self._count), False
            self._count += 1
            self._arrived.notify_all()


PixelFormat = Literal["MJPG", "YUYV", "GREY"]


@dataclass(frozen=True, slots=True)
class AskedImages:
    """What is asked of a camera; None is left to it, or to what most cameras do well."""

    size_wh: tuple[int, int] | None = None
    fps: float | None = None
    pixels: PixelFormat | None = None


class V4l2Grabber:
    """A USB or CSI camera by Video4Linux: MJPG 1920x1080 at 30 a second where nothing is asked.

    Of YUYV the luminance is taken as it comes, and GREY as it is: gray images without a
    conversion.

    Raises:
        SourceError: it cannot be opened, or gives another size or format than what is asked.
    """

    def __init__(self, device: str, asked: AskedImages) -> None:
        quieten_decoder()
        self._device = device
        self._light: V4l2LightControls | None = None
        os.environ.setdefault(_V4L2_TIMEOUT, f"{SILENT_S:.0f}")
        self._video = cv2.VideoCapture(for_opencv(device), cv2.CAP_V4L2)
        if not self._video.isOpened():
            raise SourceError(
                f"cannot open the camera {device}: is it plugged in, free, and are you in the "
                "group video?"
            )
        width_px, height_px = asked.size_wh or (1920, 1080)
        self._video.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*(asked.pixels or "MJPG")))
        self._video.set(cv2.CAP_PROP_FRAME_WIDTH, width_px)
        self._video.set(cv2.CAP_PROP_FRAME_HEIGHT, height_px)
        self._video.set(cv2.CAP_PROP_FPS, asked.fps or 30.0)
        self._video.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        self._raw = asked.pixels in ("YUYV", "GREY")
        if self._raw:
            self._video.set(cv2.CAP_PROP_CONVERT_RGB, 0)
        self._period_s = 1.0 / (self._video.get(cv2.CAP_PROP_FPS) or asked.fps or 30.0)
        self._pixels, self._seen_px = self._compare(device, asked), seen_part(device)

    def grab(self) -> tuple[float, NDArray[np.uint8]] | None:
        """The next image; one cut off on its way, as a bad cable does, is passed over.

        To open the camera again for it would cost a second and more without images.
        """
        for _ in range(_BAD_IN_A_ROW):
            if not self._video.grab():
                return None
            arrival_s = time.monotonic()
            stamp_s = self._video.get(cv2.CAP_PROP_POS_MSEC) / 1e3
            good, image = self._video.retrieve()
            if good:
                return self._exposure_time(stamp_s, arrival_s), self._luminance(image)
        return None

    @property
    def sensor_mode(self) -> SensorMode:
        """Format of its images, and what they show of the sensor where the driver tells that."""
        known = self._pixels if self._pixels.isprintable() else None
        return SensorMode(pixels=known, seen_px=self._seen_px)

    def _luminance(self, image: NDArray[Any]) -> NDArray[np.uint8]:
        """Of YUYV; any other image as it is."""
        if self._raw and image.ndim == 3:  # YUYV: luminance first, then a colour by turns
            image = np.ascontiguousarray(image[..., 0])
        return np.asarray(image, dtype=np.uint8)

    def light_controls(self) -> V4l2LightControls:
        """Its exposure and gain.

        Raises:
            SourceError: it has no exposure that can be set.
        """
        self._light = V4l2LightControls(self._device, self._period_s)
        return self._light

    def _compare(self, device: str, asked: AskedImages) -> str:
        """Refuse another size or format than what was asked; of another rate only tell.

        Returns the format.
        """
        number = int(self._video.get(cv2.CAP_PROP_FOURCC))
        pixels = number.to_bytes(4, "little").decode("ascii", errors="replace")
        size_wh = tuple(
            int(self._video.get(side))
            for side in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
        )
        given = f"{size_wh[0]}x{size_wh[1]}@{1.0 / self._period_s:g}:{pixels}"
        other_size = asked.size_wh is not None and size_wh != asked.size_wh
        if other_size or (asked.pixels is not None and pixels != asked.pixels):
            self._video.release()
            raise SourceError(
                f"the camera {device} gives {given}, which is not what is asked or calibrated: "
                f"`v4l2-ctl -d {device} --list-formats-ext` shows what it has"
            )
        _log.info("the camera %s gives %s", device, given)
        if asked.fps is not None and abs(1.0 / self._period_s - asked.fps) > 0.5:
            _log.warning("the camera %s gives %s, not %g pictures a second", device, given,
                         asked.fps)  # fmt: skip
        return pixels

    def close(self) -> None:
        """Give the device back."""
        self._video.release()

    def _exposure_time(self, stamp_s: float, arrival_s: float) -> float:
        """Middle of the exposure.

        UVC cameras stamp the start of the transfer on the monotonic clock, which follows the end
        of the exposure; without such a stamp an image is one period old when it arrives.
        """
        if 0.0 <= arrival_s - stamp_s < _DRIVER_STAMP_LIMIT_S:
            return stamp_s - 0.5 * min(max(self._exposure_s(), 0.0), self._period_s)
        return arrival_s - self._period_s

    def _exposure_s(self) -> float:
        """Of the newest image. Where it is held it is known: a camera that is asked may hang."""
        if self._light is not None and self._light.exposure_s is not None:
            return self._light.exposure_s
        return float(self._video.get(cv2.CAP_PROP_EXPOSURE)) * EXPOSURE_UNIT_S


class StreamGrabber:
    """A network stream (RTSP, HTTP); images are stamped one period before they were sent.

    RTSP tells when an image was sent, on the camera's clock (RTP's time stamp, RFC 3550): one that
    is read late, on a busy machine, was not exposed late. What another protocol tells is counted
    from a rate by FFmpeg and says nothing: their arrival counts.

    The latency of the network and the coder (100 to 500 ms for RTSP) is for the camera's set-up to
    keep small, and for its calibration to find.

    Raises:
        SourceError: it cannot be opened.
    """

    def __init__(self, url: str) -> None:
        quieten_decoder()
        limits = [
            cv2.CAP_PROP_OPEN_TIMEOUT_MSEC,
            _OPEN_TIMEOUT_MS,
            cv2.CAP_PROP_READ_TIMEOUT_MSEC,
            round(1e3 * SILENT_S),
        ]
        self._video = cv2.VideoCapture(for_opencv(url), cv2.CAP_FFMPEG, limits)
        if not self._video.isOpened():
            raise SourceError(f"cannot open the stream {url}: is the camera on and reachable?")
        self._video.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
        self._period_s = 1.0 / (self._video.get(cv2.CAP_PROP_FPS) or 30.0)
        self._tells_time = url.lower().startswith("rtsp")
        self._times = StreamTimes()

    def grab(self) -> tuple[float, NDArray[np.uint8]] | None:
        """The next image whose age is known."""
        sent_s = None
        while sent_s is None:
            good, image = self._video.read()
            if not good:
                return None
            sent_s = arrival_s = time.monotonic()
            if self._tells_time:
                stamp_s = self._video.get(cv2.CAP_PROP_POS_MSEC) / 1e3
                sent_s = self._times.sent_s(stamp_s, arrival_s)
        return sent_s - self._period_s, np.asarray(image, dtype=np.uint8)

    def close(self) -> None:
        """Hang up."""
        self._video.release()
