"""Whether images come, fit the calibration, and are not the same ones again and again."""

import hashlib
from collections import deque

import numpy as np
from numpy.typing import NDArray

from vwnav.types import Frame

_COMPARED_EVERY_PX = 16
_REMEMBERED = 300  # images: a buffer that is stuck holds no more


class CameraWatch:
    """Looks at each image before it is used.

    Args:
        width_px, height_px: of the images that the calibration is for.

    Attributes:
        image_s: exposure of the newest image, None before the first.
        trouble: why that one cannot be used; empty when it can.
    """

    def __init__(self, width_px: int, height_px: int) -> None:
        self._size = (width_px, height_px)
        self._shown: deque[bytes] = deque(maxlen=_REMEMBERED)
        self.image_s: float | None = None
        self.trouble = ""

    def look(self, frame: Frame) -> str:
        """The trouble with an image, empty when there is none."""
        self.trouble = self._trouble(frame.image)
        self.image_s = frame.t_s
        return self.trouble

    def _trouble(self, image: NDArray[np.uint8]) -> str:
        size = (image.shape[1], image.shape[0])
        if size != self._size:
            return (
                f"the calibration is for pictures of {self._size[0]} x {self._size[1]} px but they "
                f"are {size[0]} x {size[1]} px; calibrate at that size"
            )
        return "the camera repeats its pictures" if self._is_repeated(image) else ""

    def _is_repeated(self, image: NDArray[np.uint8]) -> bool:
        """Noise makes no two images of a sensor the same, unless all of it is one shade."""
        sample = image[::_COMPARED_EVERY_PX, ::_COMPARED_EVERY_PX]
        digest = hashlib.blake2b(sample.tobytes(), digest_size=16).digest()
        repeated = digest in self._shown
        self._shown.append(digest)
        return repeated and bool(np.ptp(sample))
