"""Pictures from files, and one line of complaint where they cannot be read."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.errors import VwnavError


def read_picture(path: Path, flags: int, error: type[VwnavError]) -> NDArray[Any]:
    """A picture's pixels, (h, w) or (h, w, channels) in BGR.

    Args:
        path: of a JPEG, PNG, TIFF or the like.
        flags: how OpenCV decodes it (`cv2.IMREAD_...`).
        error: what is raised.

    Raises:
        VwnavError: an `error`; it cannot be read or decoded.
    """
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # what is wrong we say
    try:
        data = np.fromfile(path, np.uint8)
        image = cv2.imdecode(data, flags) if data.size else None
    except OSError as wrong:
        raise error(f"{path}: cannot be read ({wrong.strerror})") from wrong
    except cv2.error as wrong:  # raised, not returned, where the file's head says a size too large
        raise error(
            f"{path}: has more pixels than are decoded at once (2^30), or is damaged; make it "
            "smaller, or a GeoTIFF for a map"
        ) from wrong
    if image is None:
        raise error(f"{path} is not a picture that can be read, or it is damaged")
    return image
