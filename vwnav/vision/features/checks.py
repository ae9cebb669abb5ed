"""What every extractor checks and returns alike."""

from typing import cast

import numpy as np
from numpy.typing import NDArray

from vwnav.types import Features, Gray


def check_gray(gray: Gray) -> None:
    """Refuse what is not a gray image.

    Raises:
        ValueError: not (h, w) uint8, or empty.
    """
    if gray.ndim != 2 or gray.dtype != np.uint8 or gray.size == 0:
        raise ValueError(f"expected a gray picture (h, w) uint8, got {gray.shape} {gray.dtype}")


def no_features(descriptor_size: int, dtype: type[np.float32] | type[np.uint8]) -> Features:
    """Features of an image in which nothing was found."""
    descriptors = np.zeros((0, descriptor_size), dtype)
    return Features(
        np.zeros((0, 2), np.float32),
        cast("NDArray[np.float32] | NDArray[np.uint8]", descriptors),
        np.zeros(0, np.float32),
    )
