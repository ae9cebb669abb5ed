"""What odometry keeps of images: reduced views, the keyframe, and where the camera went since."""

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from vwnav.types import Array, Gray
from vwnav.vision.matching import Points


@dataclass(frozen=True, slots=True, eq=False)
class ReducedView:
    """A reduced image and how it was taken: heading and height of the body, height of the camera.

    `flow` (3, 3) is how what is seen moves while rows are read, see `vwnav.vision.shutter`.
    """

    t_s: float
    gray: Gray
    R_ned_camera: Array
    heading_rad: float
    agl_m: float
    height_m: float
    flow: Array | None


@dataclass(frozen=True, slots=True, eq=False)
class Keyframe:
    """A view with its corners uv (n, 2) and their directions rays (n, 3) in NED.

    `turn` (2, 3) is by which its image and corners are turned in the image plane, see `turned`.
    """

    view: ReducedView
    uv: Points
    rays: Array
    turn: Array | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """Where the camera is since the keyframe, to know where to look in the next image.

    Attributes:
        t_s: of the last image that could be followed.
        way: (3,) NED from the keyframe in units of its AGL. turn_rad: (3,) as `Motion` has it.
        way_per_s: (3,) velocity in the same units.
    """

    t_s: float
    way: Array
    turn_rad: Array
    way_per_s: Array


def turned(keyframe: Keyframe, turn_rad: float) -> Keyframe:
    """The keyframe as a camera would have taken it that hung turned by so much about its axis.

    Its corners keep their directions: what follows them sees the turn.
    """
    view, (h, w) = keyframe.view, keyframe.view.gray.shape
    middle = (w - 1) / 2.0, (h - 1) / 2.0
    M = np.asarray(cv2.getRotationMatrix2D(middle, math.degrees(turn_rad), 1.0), np.float64)
    gray = np.asarray(cv2.warpAffine(view.gray, M, (w, h)), np.uint8)
    uv = cv2.transform(keyframe.uv[None], M)[0]
    return replace(keyframe, view=replace(view, gray=gray), uv=uv, turn=M)
