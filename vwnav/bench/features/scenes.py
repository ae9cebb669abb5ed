"""What is judged: an image, the map it lies on, and the place where it truly lies."""

import zlib
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.geometry.homography import jacobian_at
from vwnav.types import Array, Gray

BLOCK_PX = 640  # large maps are extracted in blocks of this side, as map packs are
MARGIN_PX = 64  # of a block that only lends its surroundings
EDGE_PX = 6  # keypoints nearer to the end of the ground see what is not there
MULTIPLE_PX = 32  # sides of all images: no feature set has to resize or pad
_SHRINK_AT_ONCE = 1.3  # a warp alone would alias below that

Mask = NDArray[np.bool_]
_DIRTY_BLACK = 4  # JPEG makes the black corners of a rotated image this bright
Unit = Literal["m", "px"]


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceMap:
    """The reference that images are matched to; its features are extracted once.

    Attributes:
        gray: (h, w), sides as `map_side` gives them.
        mask: (h, w), true where there are data.
        keypoints: budget over the whole of the mask.
        unit_per_px: what a pixel is worth: metres, or 1 for pixels.
        unit: of that.
    """

    gray: Gray
    mask: Mask
    keypoints: int
    unit_per_px: float
    unit: Unit


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Scene:
    """One image to be placed.

    Attributes:
        group: scenes of one group are averaged.
        name: for people.
        image: (h, w) the view, sides divisible by 32.
        mask: (h, w), true where the view shows ground.
        keypoints: budget of the image.
        map_: the reference.
        window: (u0, v0, u1, v1) of the map that the prior allows.
        point0_uv, point1_uv: (2,) one place in the image and in the map: the truth.
        H_1_0: (3, 3) from the image to the map, where the truth is that exact.
    """

    group: str
    name: str
    image: Gray
    mask: Mask
    keypoints: int
    map_: ReferenceMap
    window: tuple[float, float, float, float]
    point0_uv: Array
    point1_uv: Array
    H_1_0: Array | None = None


def generator(group: str, index: int, attempt: int = 0) -> np.random.Generator:
    """The random numbers of one scene, the same on every machine and for every feature set."""
    return np.random.default_rng([zlib.crc32(group.encode()), index, attempt])


def image_side(size_px: float) -> int:
    """The least side of an image that holds `size_px`."""
    return int(np.ceil(size_px / MULTIPLE_PX)) * MULTIPLE_PX


def map_side(size_px: float) -> int:
    """The least side of a map that holds `size_px`: of one image, or of whole blocks."""
    if size_px <= BLOCK_PX:
        return image_side(size_px)
    inner = BLOCK_PX - 2 * MARGIN_PX
    return int(np.ceil((size_px - 2 * MARGIN_PX) / inner)) * inner + 2 * MARGIN_PX


def look_at(
    source: NDArray[np.uint8], seen: Mask, H_source_view: Array, size_wh: tuple[int, int]
) -> tuple[Gray, Mask]:
    """Look at an image through a homography, without aliasing.

    Args:
        source: (h, w) gray or (h, w, 3) BGR.
        seen: (h, w), true where the source has data.
        H_source_view: (3, 3) from pixels of the view to pixels of the source.
        size_wh: width and height of the view.

    Returns:
        The gray view, its edges continued where the source ends, and the mask of what it shows.
    """
    gray = source if source.ndim == 2 else cv2.cvtColor(source, cv2.COLOR_BGR2GRAY)
    here = cv2.warpPerspective(
        seen.astype(np.uint8),
        H_source_view,
        size_wh,
        flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP,
    )
    middle = (np.array(size_wh, np.float64) - 1.0) / 2.0
    shrink = np.sqrt(abs(np.linalg.det(jacobian_at(H_source_view, middle))))
    if shrink > _SHRINK_AT_ONCE:
        h, w = gray.shape
        small_wh = (max(round(w / shrink), 1), max(round(h / shrink), 1))
        gray = cv2.resize(gray, small_wh, interpolation=cv2.INTER_AREA)
        su, sv = small_wh[0] / w, small_wh[1] / h
        # Half-pixel rule: (u + 0.5) s - 0.5.
        H_small_source = np.array(
            [[su, 0.0, 0.5 * su - 0.5], [0.0, sv, 0.5 * sv - 0.5], [0.0, 0.0, 1.0]]
        )
        H_source_view = H_small_source @ H_source_view
    view = cv2.warpPerspective(
        gray,
        H_source_view,
        size_wh,
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return np.asarray(view, np.uint8), np.asarray(here > 0)


def ground_mask(image: NDArray[np.uint8]) -> Mask:
    """True where an image shows ground, not the black corners that its registration left."""
    black = (image.max(axis=2) < _DIRTY_BLACK).astype(np.uint8)
    black = cv2.morphologyEx(black, cv2.MORPH_OPEN, np.ones((9, 9), np.uint8))
    return np.asarray(cv2.dilate(black, np.ones((7, 7), np.uint8)) == 0)
