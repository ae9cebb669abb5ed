"""Faults of the camera: what becomes of its images, and when they come."""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import cycle

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.bench.flights.stage import FlightStage
from vwnav.errors import SourceError
from vwnav.geometry.rotations import rotation_from_euler
from vwnav.types import Frame

Image = NDArray[np.uint8]
Trouble = Callable[[Frame], Frame | None]
_DARK, _DARK_NOISE = 3.0, 1.5
_BLUR_PX = 4.0
_BURST, _AFTER = 8, 12  # images lost, images that come
_LOOP, _PATCH_PX = 10, 40  # images of a buffer that is shown again and again; ground that repeats
_GEAR = ((0.08, 0.0, 0.09, 1.0), (0.84, 0.0, 0.09, 1.0), (0.0, 0.9, 1.0, 0.1))  # u, v, w, h: shares
_DROPS, _DROP_PX, _DROP_BLUR_PX, _DROP_GREY = 25, (0.02, 0.06), 15.0, 110.0
_TORN, _SMEARED = 0.5, 0.4  # share of the images that a bad cable does it to
_FALSE_TIMES_S = (math.nan, 3600.0, -3600.0, math.inf)  # off by


@dataclass(frozen=True)
class CameraTrouble:
    """Images are not what they should be: see the functions below."""

    make: Callable[[], Trouble]

    def begin(self, world: FlightStage) -> None:
        """Trouble."""
        world.camera.troubles[id(self)] = self.make()

    def end(self, world: FlightStage) -> None:
        """None."""
        del world.camera.troubles[id(self)]

    def __str__(self) -> str:
        return f"camera: {self.make.__name__.replace('_', ' ')}"


@dataclass(frozen=True)
class ImagesLate:
    """Images arrive later; `stamped` says whether they still tell when they were exposed."""

    seconds: float
    stamped: bool = True

    def begin(self, world: FlightStage) -> None:
        """Late."""
        world.camera.latency_s += self.seconds
        if not self.stamped:
            world.camera.troubles[id(self)] = lambda f: replace(f, t_s=f.t_s + self.seconds)

    def end(self, world: FlightStage) -> None:
        """As before."""
        world.camera.latency_s -= self.seconds
        world.camera.troubles.pop(id(self), None)


@dataclass(frozen=True)
class CameraKnocked:
    """A screw gives way: from then on it hangs otherwise by roll, pitch and yaw."""

    off_deg: tuple[float, float, float]

    def begin(self, world: FlightStage) -> None:
        """It hangs loose."""
        world.camera.R_body_mount = rotation_from_euler(*map(math.radians, self.off_deg))

    def end(self, world: FlightStage) -> None:
        """As it was mounted."""
        world.camera.R_body_mount = np.eye(3)


def no_images() -> Trouble:
    """Nothing comes."""
    return lambda frame: None


def raising() -> Trouble:
    """The driver raises."""

    def fail(frame: Frame) -> Frame | None:
        raise SourceError("cannot read from /dev/video0: No such device")

    return fail


def black() -> Trouble:
    """Lens covered: the sensor's noise is all there is."""
    rng = np.random.default_rng(5)

    def cover(frame: Frame) -> Frame | None:
        dark = rng.normal(_DARK, _DARK_NOISE, frame.image.shape)
        return replace(frame, image=np.clip(np.round(dark), 0, 255).astype(np.uint8))

    return cover


def frozen() -> Trouble:
    """The same image again and again, with new times."""
    kept: list[Frame] = []

    def freeze(frame: Frame) -> Frame | None:
        kept.append(frame)
        return replace(frame, image=kept[0].image)

    return freeze


def frozen_in_a_stream() -> Trouble:
    """The same image again and again, encoded anew each time: no two are the same."""
    freeze, encode = frozen(), faded(1.0, 0.0, _DARK_NOISE)
    return lambda frame: (same := freeze(frame)) and encode(same)


def looping() -> Trouble:
    """The images of a second again and again, with new times: a buffer that is stuck."""
    kept: deque[Image] = deque()

    def loop(frame: Frame) -> Frame | None:
        if len(kept) < _LOOP:
            kept.append(frame.image)
            return frame
        kept.rotate(-1)
        return replace(frame, image=kept[-1])

    return loop


def repeating_ground() -> Trouble:
    """Ground that looks the same every few metres: a patch of it, laid side by side."""

    def lay(image: Image) -> Image:
        h, w = image.shape[:2]
        v, u = h // 2, w // 2
        patch = image[v : v + _PATCH_PX, u : u + _PATCH_PX]
        return np.tile(patch, (h // _PATCH_PX, w // _PATCH_PX))

    return each_image(lay)


def half_covered() -> Trouble:
    """A strap over the left half of the lens."""

    def cover(image: Image) -> Image:
        covered = image.copy()
        covered[:, : image.shape[1] // 2] = round(_DARK)
        return covered

    return each_image(cover)


def out_of_focus() -> Trouble:
    """Blurred by four pixels."""
    return each_image(lambda image: np.asarray(cv2.GaussianBlur(image, (0, 0), _BLUR_PX), np.uint8))


def mirrored() -> Trouble:
    """Left is right: a driver that flips along one axis alone."""
    return lambda frame: replace(frame, image=np.ascontiguousarray(frame.image[:, ::-1]))


def upside_down() -> Trouble:
    """The camera is mounted the other way round."""
    return each_image(lambda image: np.ascontiguousarray(image[::-1, ::-1]))


def cropped() -> Trouble:
    """A mode that reads the middle of the sensor: 1.7 times the focal length."""
    return _zoomed(1.7)


def stabilised() -> Trouble:
    """A driver's stabiliser keeps a margin: 1.1 times the focal length."""
    return _zoomed(1.1)


def zoomed_in() -> Trouble:
    """Somebody at its remote control: 1.3 times the focal length."""
    return _zoomed(1.3)


def _zoomed(ratio: float) -> Trouble:
    def zoom(image: Image) -> Image:
        h, w = image.shape[:2]
        grows = cv2.getRotationMatrix2D((0.5 * (w - 1), 0.5 * (h - 1)), 0.0, ratio)
        return np.asarray(cv2.warpAffine(image, grows, (w, h)), np.uint8)

    return each_image(zoom)


def another_size() -> Trouble:
    """Half of the calibrated size."""
    return each_image(lambda image: np.ascontiguousarray(image[::2, ::2]))


def bursts_dropped() -> Trouble:
    """Eight images in a row are lost, twelve come."""
    return lambda frame: None if frame.index % (_BURST + _AFTER) < _BURST else frame


def landing_gear() -> Trouble:
    """Two skids and a bar, which stand still while the ground passes: a quarter of the image."""
    grain = np.random.default_rng(6).integers(0, 120, (2048, 2048), np.uint8)

    def cover(image: Image) -> Image:
        covered, (h, w) = image.copy(), image.shape[:2]
        for u, v, wide, high in _GEAR:
            part = covered[round(v * h) :, round(u * w) :][: round(high * h), : round(wide * w)]
            part[:] = grain[: part.shape[0], : part.shape[1]]
        return covered

    return each_image(cover)


def drops() -> Trouble:
    """Rain on the lens: blurred discs."""
    rng = np.random.default_rng(6)
    places, radii = rng.uniform(0.0, 1.0, (_DROPS, 2)), rng.uniform(*_DROP_PX, _DROPS)

    def wet(image: Image) -> Image:
        drop, (h, w) = np.zeros(image.shape[:2], np.float32), image.shape[:2]
        for (u, v), radius in zip(places.tolist(), radii.tolist(), strict=True):
            cv2.circle(drop, (round(u * w), round(v * h)), round(radius * h), 1.0, -1)
        drop = np.asarray(cv2.GaussianBlur(drop, (0, 0), 3.0))
        seen = 0.4 * cv2.GaussianBlur(image, (0, 0), _DROP_BLUR_PX).astype(np.float32) + _DROP_GREY
        return np.asarray((1.0 - drop) * image + drop * seen, np.uint8)

    return each_image(wet)


def torn() -> Trouble:
    """A cable that loses packets: below a row that changes it is still the image before."""
    rng, before = np.random.default_rng(6), list[Image]()

    def tear(image: Image) -> Image:
        made = image.copy()
        if before and rng.random() < _TORN:
            row = int(rng.integers(1, image.shape[0]))
            made[row:] = before[0][row:]
        before[:] = [image]
        return made

    return each_image(tear)


def smeared() -> Trouble:
    """A cut-off JPEG as decoders fill it: from a row that changes on, that row alone."""
    rng = np.random.default_rng(6)

    def smear(image: Image) -> Image:
        row = int(rng.integers(1, len(image))) if rng.random() < _SMEARED else len(image)
        return np.concatenate([image[:row], np.repeat(image[row - 1 : row], len(image) - row, 0)])

    return each_image(smear)


def each_twice() -> Trouble:
    """Every other image is the one before, with a new time: 10 a second from a camera of 5."""
    kept: list[Image] = []

    def repeat(frame: Frame) -> Frame | None:
        if frame.index % 2 == 0 or not kept:
            kept[:] = [frame.image]
        return replace(frame, image=kept[0])

    return repeat


def false_times() -> Trouble:
    """Every third image tells a time that cannot be."""
    off_s = cycle(_FALSE_TIMES_S)
    return lambda frame: frame if frame.index % 3 else replace(frame, t_s=frame.t_s + next(off_s))


def faded(share: float, grey: float, noise: float) -> Trouble:
    """So much of the contrast is left, about another grey level, with noise of one sigma."""
    rng = np.random.default_rng(6)

    def fade(image: Image) -> Image:
        seen = share * image + rng.normal(grey, noise, image.shape)
        return np.clip(np.round(seen), 0, 255).astype(np.uint8)

    return each_image(fade)


def each_image(change: Callable[[Image], Image]) -> Trouble:
    """A trouble that makes another image of every one."""
    return lambda frame: replace(frame, image=change(frame.image))
