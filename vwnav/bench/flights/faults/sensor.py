"""What cheap cameras do: they vibrate, look for their focus, compress, and have bad pixels."""

import math
from dataclasses import replace

import cv2
import numpy as np

from vwnav.bench.flights.faults.camera import Image, Trouble, each_image
from vwnav.types import Frame

_JELLO_PX, _JELLO_WAVES = 2.5, (2.0, 4.0)  # displacement of a row; vibrations while one is read out
_FOCUS_S, _FOCUS_BLUR_PX, _BREATHES = 1.5, 4.0, 0.02  # period; blur, and how the view grows by it
_JPEG_QUALITY = 8
_PIXELS, _COLUMNS, _READ_NOISE = 3.0, 2.0, 2.0  # grey levels: each its own, and what changes
_DARK_SHARE, _DARK_GREY = 0.15, 12.0  # of the light, and what the gain adds


def jello() -> Trouble:
    """A mount that vibrates while rows are read one after the other: straight roads are waves."""
    rng = np.random.default_rng(7)

    def shake(image: Image) -> Image:
        h, w = image.shape[:2]
        v, u = np.indices((h, w), np.float32)
        waves, along, across = rng.uniform(*_JELLO_WAVES), *rng.uniform(0.0, math.tau, 2)
        phase = math.tau * waves * v / h
        u += np.float32(_JELLO_PX) * np.sin(phase + along)
        v += np.float32(_JELLO_PX) * np.sin(phase + across)
        border = cv2.BORDER_REPLICATE
        return np.asarray(cv2.remap(image, u, v, cv2.INTER_LINEAR, borderMode=border), np.uint8)

    return each_image(shake)


def focus_hunting() -> Trouble:
    """An autofocus that finds nothing to hold on to: blur comes and goes, and the view breathes."""

    def focus(frame: Frame) -> Frame | None:
        off = 0.5 - 0.5 * math.cos(math.tau * frame.t_s / _FOCUS_S)
        h, w = frame.image.shape[:2]
        M = cv2.getRotationMatrix2D(((w - 1) / 2.0, (h - 1) / 2.0), 0.0, 1.0 + _BREATHES * off)
        grown = cv2.warpAffine(frame.image, M, (w, h), borderMode=cv2.BORDER_REPLICATE)
        blurred = cv2.GaussianBlur(grown, (0, 0), 0.1 + _FOCUS_BLUR_PX * off)
        return replace(frame, image=np.asarray(blurred, np.uint8))

    return focus


def compressed() -> Trouble:
    """JPEG at a quality that a poor radio forces: blocks of eight pixels, most of them flat."""

    def compress(image: Image) -> Image:
        _, encoded = cv2.imencode(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY))
        flag = cv2.IMREAD_GRAYSCALE if image.ndim == 2 else cv2.IMREAD_COLOR
        return np.asarray(cv2.imdecode(encoded, flag), np.uint8)

    return each_image(compress)


def fixed_pattern() -> Trouble:
    """Little light and much gain: each pixel and column of the sensor is brighter in its own way.

    What the sensor shows of itself stands still whatever the ground does.
    """
    rng, own = np.random.default_rng(8), list[np.ndarray]()

    def gain(image: Image) -> Image:
        if not own:
            columns = rng.normal(0.0, _COLUMNS, image.shape[1])
            pixels = rng.normal(0.0, _PIXELS, image.shape[:2]) + columns
            own.append(pixels if image.ndim == 2 else pixels[..., None])
        light = _DARK_SHARE * image + _DARK_GREY + own[0]
        seen = light + rng.normal(0.0, _READ_NOISE, image.shape)
        return np.asarray(np.clip(seen, 0, 255), np.uint8)

    return each_image(gain)
