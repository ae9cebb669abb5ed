"""Real images for calibration and checks: of the training set only."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from export.export_onnx import ExportError
from models.network import SIZE_MULTIPLE_PX
from training.data import IMAGE_SUFFIXES, data_folder

Image = NDArray[np.uint8]


def training_images(data: str, count: int) -> list[Path]:
    """At most `count` images of `train/`, from all of its sources in turn; none without data."""
    folder = data_folder(data)
    if folder is None or count < 1:
        return []
    sources = sorted(p for p in (folder / "train").glob("*/*") if p.is_dir())
    lists = [_of_source(source) for source in sources]
    lists = [images for images in lists if images]
    share = -(-count // max(len(lists), 1))
    # Evenly over each source: neighbours in a folder resemble each other.
    chosen = [
        images[i * len(images) // min(share, len(images))]
        for images in lists
        for i in range(min(share, len(images)))
    ]
    step = max(1.0, len(chosen) / count)
    return [chosen[int(k * step)] for k in range(min(count, len(chosen)))]


def read_grey(path: Path, largest_px: int = 4096) -> Image:
    """Read an image as grey and cut its middle to a size that the network takes.

    Args:
        path: any image.
        largest_px: of each side.

    Raises:
        ExportError: it cannot be read, or is too small.
    """
    grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if grey is None or min(grey.shape) < SIZE_MULTIPLE_PX:
        raise ExportError(f"no readable picture of {SIZE_MULTIPLE_PX} px or more at {path}")
    h, w = (min(side, largest_px) // SIZE_MULTIPLE_PX * SIZE_MULTIPLE_PX for side in grey.shape)
    v0, u0 = (grey.shape[0] - h) // 2, (grey.shape[1] - w) // 2
    return np.ascontiguousarray(grey[v0 : v0 + h, u0 : u0 + w])


def _of_source(source: Path) -> list[Path]:
    return sorted(p for p in source.glob("*") if p.suffix.lower() in IMAGE_SUFFIXES)
