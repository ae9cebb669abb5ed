"""Whether images come, fit the calibration, show anything, and are not always the same ones."""

import hashlib
import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vwnav.errors import OtherSizeError
from vwnav.types import Frame

_COMPARED_EVERY_PX = 16
_REMEMBERED = 300  # images: a buffer that is stuck holds no more
OLDEST_S = 2.0  # of an exposure: the filter looks no further back
MOST_AHEAD_S = 0.1  # a time offset that was calibrated may be longer than an image's way to us
_DARK, _BRIGHT = 5, 250  # grey levels beyond which a pixel shows nothing
_NOTHING_SHARE = 0.99  # of the pixels
_RATE_OF, _RATE_OF_MOST = 8, 16  # images


@dataclass(frozen=True, slots=True)
class CameraSight:
    """What is known of the camera by the images that were looked at.

    Attributes:
        image_s: when the newest was looked at, None before the first.
        trouble: why that one cannot be used; empty when it can.
        shade: "black" or "white" where it is nothing else.
        rate_hz: of the newest exposures; None before there are enough of them.
    """

    image_s: float | None
    trouble: str = ""
    shade: str = ""
    rate_hz: float | None = None


class CameraWatch:
    """Looks at each image before it is used.

    Args:
        width_px, height_px: of the images that the calibration is for.
        trouble_of_mode: why images of that size may yet show more or less than the calibrated
            ones; "" where nothing says so.

    Attributes:
        image_s: when the newest image was looked at, None before the first.
        trouble: why that one cannot be used; empty when it can.
    """

    def __init__(
        self, width_px: int, height_px: int, trouble_of_mode: Callable[[], str] = lambda: ""
    ) -> None:
        self._size = (width_px, height_px)
        self._trouble_of_mode = trouble_of_mode
        self._repeats = Repeats()
        self._exposed_s = -math.inf
        self._exposures_s: deque[float] = deque(maxlen=_RATE_OF_MOST)
        self._rate_hz: float | None = None
        self._shade = ""
        self.image_s: float | None = None
        self.trouble = ""

    @property
    def sight(self) -> CameraSight:
        """What is known of the camera now."""
        return CameraSight(self.image_s, self.trouble, self._shade, self._rate_hz)

    def look(self, frame: Frame, t_s: float) -> str:
        """The trouble with an image that is there at `t_s`, empty when there is none."""
        self.trouble = self._trouble_of_time(frame.t_s, t_s) or self._trouble(frame.image)
        self.image_s = t_s
        return self.trouble

    def _trouble_of_time(self, exposed_s: float, t_s: float) -> str:
        """One that cannot be is no exposure's: what was seen then would be held to be now."""
        if not -MOST_AHEAD_S <= t_s - exposed_s <= OLDEST_S:  # nor is what is not a number
            return (
                "the camera's times are not of now (more than "
                f"{OLDEST_S:g} s old, ahead, or no numbers): see its driver's clock"
            )
        if exposed_s <= self._exposed_s:
            return "the camera's times do not rise: see its driver's clock"
        self._exposed_s = exposed_s
        self._count(exposed_s)
        return ""

    def _count(self, exposed_s: float) -> None:
        exposures_s = self._exposures_s
        exposures_s.append(exposed_s)
        if len(exposures_s) >= _RATE_OF:
            self._rate_hz = (len(exposures_s) - 1) / (exposures_s[-1] - exposures_s[0])

    def _trouble(self, image: NDArray[np.uint8]) -> str:
        size = (image.shape[1], image.shape[0])
        if size != self._size:
            return str(OtherSizeError(self._size, size))
        if trouble := self._trouble_of_mode():
            return trouble
        self._shade = _shade_of(_sampled(image))
        return "the camera repeats its pictures" if self._repeats.look(image) else ""


class Repeats:
    """Images that were there before: noise makes no two of a sensor the same."""

    def __init__(self) -> None:
        self._shown: deque[bytes] = deque(maxlen=_REMEMBERED)

    def look(self, image: NDArray[np.uint8]) -> bool:
        """Whether this one was, unless all of it is one shade."""
        sample = _sampled(image)
        digest = hashlib.blake2b(sample.tobytes(), digest_size=16).digest()
        repeated = digest in self._shown
        self._shown.append(digest)
        return repeated and bool(np.ptp(sample))


def _sampled(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return image[::_COMPARED_EVERY_PX, ::_COMPARED_EVERY_PX]


def _shade_of(sample: NDArray[np.uint8]) -> str:
    if np.mean(sample <= _DARK) >= _NOTHING_SHARE:
        return "black"
    return "white" if np.mean(sample >= _BRIGHT) >= _NOTHING_SHARE else ""
