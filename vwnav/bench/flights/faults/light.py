"""Faults of the light that images are taken in, and of the exposure that answers it."""

import math
from dataclasses import replace
from itertools import cycle

import numpy as np

from vwnav.bench.flights.faults.camera import Image, Trouble, each_image, faded
from vwnav.types import Frame

_SUN_PX, _VEIL = 0.35, 90.0  # radius of the glare as a share of the height; grey levels about it
_DUSK, _DUSK_GREY, _DUSK_NOISE = 0.1, 4.0, 2.5  # of the light, and what the sensor adds
_HUNTS = (0.4, 1.7)  # exposures by turns
_FOG, _FOG_GREY, _FOG_NOISE = 0.15, 150.0, 1.5  # of the contrast, and what fog and sensor add
_CLOUD_PX, _CLOUD_PX_S, _IN_SHADE = 260.0, 110.0, 0.45  # length, speed over the image, light left
_FOLLOWS_OCTAVES, _FOLLOWS_S = 0.5, 4.0  # how far an exposure goes to either side, and its period


def overexposed() -> Trouble:
    """White: exposure that has lost its control."""
    return each_image(lambda image: np.full_like(image, 255))


def sun_glare() -> Trouble:
    """The sun's reflection: a white disc, and a veil that fades away from it."""

    def dazzle(image: Image) -> Image:
        h, w = image.shape[:2]
        v, u = np.indices((h, w), np.float32)
        away = np.hypot(v - 0.3 * h, u - 0.65 * w) / (_SUN_PX * h)
        light = np.where(away < 1.0, 255.0, _VEIL / np.maximum(away, 1.0))
        return np.clip(image + light, 0, 255).astype(np.uint8)

    return each_image(dazzle)


def dusk() -> Trouble:
    """A tenth of the light is left, and the sensor's noise."""
    return faded(_DUSK, _DUSK_GREY, _DUSK_NOISE)


def exposure_hunting() -> Trouble:
    """Too dark and too bright by turns."""
    gains = cycle(_HUNTS)
    return each_image(lambda image: np.clip(next(gains) * image, 0, 255).astype(np.uint8))


def exposure_following() -> Trouble:
    """An exposure that follows the light, over an octave and back: by up to 5 % an image."""

    def expose(frame: Frame) -> Frame | None:
        octaves = _FOLLOWS_OCTAVES * math.sin(math.tau * frame.t_s / _FOLLOWS_S)
        return replace(frame, image=np.clip(2.0**octaves * frame.image, 0, 255).astype(np.uint8))

    return expose


def fog() -> Trouble:
    """A seventh of the contrast is left, and the sensor's noise."""
    return faded(_FOG, _FOG_GREY, _FOG_NOISE)


def cloud_shadows() -> Trouble:
    """Shadows of clouds pass from the left to the right, whatever the ground does below them."""

    def shade(frame: Frame) -> Frame | None:
        h, w = frame.image.shape[:2]
        along = (np.arange(w) + 0.3 * np.arange(h)[:, None] - _CLOUD_PX_S * frame.t_s) / _CLOUD_PX
        edge = np.clip(3.0 * np.sin(math.tau * along), -1.0, 1.0)
        light = _IN_SHADE + (1.0 - _IN_SHADE) * (0.5 + 0.5 * edge)
        return replace(frame, image=np.asarray(light * frame.image, np.uint8))

    return shade
