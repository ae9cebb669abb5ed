"""What odometry keeps of images: reduced views, the keyframe, and where the camera went since."""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.types import Array, Gray
from vwnav.vision.matching import Points

_TEXTURED, _SAME = 25, 12  # gray values: across 3 px, and from image to image
_DRAWN_AFTER = 4  # looks in a row: less, and ground is like what was there before by chance
_NEAR_PX = 19  # the window within which a corner is followed, and one more to each side


@dataclass(frozen=True, slots=True, eq=False)
class ReducedView:
    """A reduced image and how it was taken: heading and height of the body, height of the camera.

    In its `normalized` image corners are followed, see `normalize_contrast`. `flow` (3, 3) is how
    what is seen moves while rows are read, see `continuous_homography`; zero if that is not known.
    """

    t_s: float
    gray: Gray
    normalized: Gray
    R_ned_camera: Array
    heading_rad: float
    agl_m: float
    height_m: float
    flow: Array


@dataclass(frozen=True, slots=True, eq=False)
class Keyframe:
    """A view with its corners uv (n, 2) and their directions rays (n, 3) in NED.

    `skew` (n, 3) is what is to be added to them per second of read-out.
    `turn` (2, 3) is by which its image and corners are turned in the image plane, see `turned`.
    """

    view: ReducedView
    uv: Points
    rays: Array
    skew: Array
    turn: Array | None = None


class Alike(NamedTuple):
    """A view that later ones hardly differ from: its keyframe's corners uv (n, 2) in it.

    Lost ones are NaN; `most_px` is how far they have moved since.
    """

    keyframe: Keyframe
    uv: Points
    view: ReducedView
    most_px: float


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """Where the camera is since the keyframe, to know where to look in the next image.

    Attributes:
        t_s: of the last image that could be followed.
        way: (3,) NED from the keyframe in units of its AGL. turn: (3, 3) as `Motion` has it.
        way_per_s: (3,) velocity in the same units.
    """

    t_s: float
    way: Array
    turn: Array
    way_per_s: Array


class Overlay:
    """What is drawn into the images of a video, or hangs before its lens: the ground goes by it.

    Where the ground shows nothing it is all that can be followed, and it says "at rest".
    """

    def __init__(self, width_px: int, height_px: int) -> None:
        self._still = np.zeros((height_px, width_px), np.uint8)  # looks in a row

    def look(self, gray0: Gray, gray1: Gray) -> None:
        """Learn from two images (h, w), between which the ground has gone by."""
        rough = cv2.morphologyEx(gray0, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > _TEXTURED
        same = rough & (cv2.absdiff(gray0, gray1) < _SAME)
        self._still[~same] = 0
        self._still[same] = np.minimum(self._still[same] + 1, _DRAWN_AFTER)

    def shows(self, uv: Points) -> NDArray[np.bool_]:
        """Which corners (n, 2) are of it, or so near that they are followed by it."""
        drawn = np.asarray(self._still >= _DRAWN_AFTER, np.uint8)
        near = cv2.dilate(drawn, np.ones((_NEAR_PX, _NEAR_PX), np.uint8))
        column, row = np.round(uv).astype(np.int64).T
        return np.asarray(near[row, column] > 0)


def turned(keyframe: Keyframe, turn_rad: float) -> Keyframe:
    """The keyframe as a camera would have taken it that hung turned by so much about its axis.

    Its corners keep their directions: what follows them sees the turn.
    """
    view, (h, w) = keyframe.view, keyframe.view.gray.shape
    middle = (w - 1) / 2.0, (h - 1) / 2.0
    M = np.asarray(cv2.getRotationMatrix2D(middle, math.degrees(turn_rad), 1.0), np.float64)
    gray, normalized = (
        np.asarray(cv2.warpAffine(image, M, (w, h)), np.uint8)
        for image in (view.gray, view.normalized)
    )
    uv = cv2.transform(keyframe.uv[None], M)[0]
    return replace(keyframe, view=replace(view, gray=gray, normalized=normalized), uv=uv, turn=M)
