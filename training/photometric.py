"""What changes between map and flight besides the viewpoint: light, season, sensor, file.

These run in the loader's processes on single views, in the order light takes: surface, sun, lens,
sensor, file. A rough kornia tail (`batch_augmentation`) adds what is as well done on the whole
batch.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from torch import nn

Image = NDArray[Any]  # uint8
GREY_WEIGHTS_BGR = np.array([0.114, 0.587, 0.299])


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotometricConfig:
    """Probability of each change per view."""

    channel_mix: float = 0.35
    season: float = 0.25
    changed_things: float = 0.35
    recolour: float = 0.25
    snow: float = 0.06
    tone_curve: float = 0.5
    gamma: float = 0.5
    shading: float = 0.3
    shadow: float = 0.3
    cast_shadows: float = 0.2
    haze: float = 0.15
    resolution: float = 0.3
    blur: float = 0.25
    motion_blur: float = 0.15
    noise: float = 0.5
    jpeg: float = 0.4


def to_grey(bgr: Image, rng: np.random.Generator | None = None) -> Image:
    """Mix colours to grey, (H, W, 3) -> (H, W); with `rng` in random shares, like other sensors."""
    if bgr.ndim == 2:
        return bgr
    if rng is None:
        return cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY)
    weights = (
        rng.dirichlet([1.0, 1.0, 1.0]) * 1.4 - 0.4 / 3
        if rng.random() < 0.5
        else rng.dirichlet(2 * GREY_WEIGHTS_BGR + 0.7)
    )
    return cv2.transform(bgr, weights.reshape(1, 3).astype(np.float32)).reshape(bgr.shape[:2])


def random_tone_curve(rng: np.random.Generator, change: float = 35.0) -> Image:
    """Draw a smooth lookup table (256,), not always monotone: dry grass may be bright or dark."""
    knots = np.linspace(0, 255, 6)
    values = knots + rng.normal(0.0, change, 6)
    if rng.random() < 0.05:
        values = 255 - values
    bent = np.interp(np.arange(256), knots, values)
    curve = cv2.GaussianBlur(bent.reshape(1, -1), (0, 0), 12).ravel()
    return np.clip(curve, 0, 255).astype(np.uint8)


def smooth_field(
    rng: np.random.Generator, size_px: int, low: float, high: float
) -> NDArray[np.float32]:
    """Draw a slowly changing factor over the image, (size_px, size_px)."""
    coarse = rng.uniform(low, high, (3, 3)).astype(np.float32)
    field = cv2.resize(coarse, (size_px, size_px), interpolation=cv2.INTER_CUBIC)
    return np.asarray(field, np.float32)


def shadow_field(rng: np.random.Generator, size_px: int) -> NDArray[np.float32]:
    """Draw sharp or soft shadows of unseen things as a factor, (size_px, size_px)."""
    field = np.full((size_px, size_px), 1.0, np.float32)
    for _ in range(rng.integers(1, 4)):
        centre = rng.uniform(0, size_px, 2)
        corners = centre + rng.normal(
            0.0, rng.uniform(0.05, 0.3) * size_px, (rng.integers(3, 6), 2)
        )
        cv2.fillConvexPoly(
            field, cv2.convexHull(corners.astype(np.int32)), float(rng.uniform(0.35, 0.8))
        )
    return np.asarray(cv2.GaussianBlur(field, (0, 0), float(rng.uniform(0.5, 4.0))), np.float32)


def season(bgr: Image, grey: Image, rng: np.random.Generator) -> Image:
    """Make what grows brighter or darker than the rest: crops, leaves, dry grass, wet soil.

    By the excess of green over red and blue (Woebbecke et al. 1995), relative to the image.
    """
    if bgr.ndim == 2:
        return grey
    blue, green, red = cv2.split(cv2.GaussianBlur(bgr, (0, 0), 1.0).astype(np.float32))
    excess = (2.0 * green - red - blue) / (green + red + blue + 1.0)
    middle, width = np.quantile(excess[::4, ::4], rng.uniform(0.2, 0.8)), excess.std() + 0.01
    growing = 0.5 + 0.5 * np.tanh(1.5 / width * (excess - middle), dtype=np.float32)  # logistic
    of_growing, of_bare = np.exp(rng.normal(0.0, [0.4, 0.2]))
    return cv2.multiply(grey, of_bare + (of_growing - of_bare) * growing, dtype=cv2.CV_8U)


def cast_shadows(grey: Image, rng: np.random.Generator) -> Image:
    """Let what stands out, brighter or darker than around it, throw a shadow from some sun."""
    size = int(rng.integers(3, 13))
    blob = cv2.subtract(
        cv2.blur(grey, (size, size)), cv2.blur(grey, (6 * size, 6 * size)), dtype=cv2.CV_32F
    )
    blob *= rng.choice([-1.0, 1.0])
    stands = (blob > np.quantile(blob[::4, ::4], rng.uniform(0.85, 0.97))).astype(np.uint8)
    length, angle = int(rng.integers(3, 15)), rng.uniform(0.0, 2 * np.pi)
    away = np.zeros((2 * length + 1, 2 * length + 1), np.uint8)
    tip = np.rint(length * (1.0 + np.array([np.cos(angle), np.sin(angle)]))).astype(int)
    cv2.line(away, (length, length), (int(tip[0]), int(tip[1])), 1)
    shade = cv2.dilate(stands, away) * (1 - stands)
    shade = cv2.GaussianBlur(shade.astype(np.float32), (0, 0), float(rng.uniform(0.5, 1.2)))
    return (grey * (1.0 - float(rng.uniform(0.3, 0.65)) * shade)).astype(np.uint8)


def change_things(grey: Image, rng: np.random.Generator) -> Image:
    """Move patches of the image elsewhere in it: cars, heaps, new roofs."""
    changed = grey.copy()
    size = grey.shape[0]
    for _ in range(rng.integers(1, 5)):
        w, h = rng.integers(8, size // 5, 2)
        u0, u1 = rng.integers(0, size - w, 2)
        v0, v1 = rng.integers(0, size - h, 2)
        changed[v1 : v1 + h, u1 : u1 + w] = grey[v0 : v0 + h, u0 : u0 + w]
    return changed


def recolour(grey: Image, rng: np.random.Generator) -> Image:
    """Change the brightness of some covers and not of others: crops, mown grass, wet soil.

    A cover is a band of brightness of the blurred image; its texture stays.
    """
    smooth = cv2.GaussianBlur(grey, (0, 0), float(rng.uniform(2.0, 8.0))).astype(np.float32)
    middle, width = np.quantile(smooth, rng.uniform()), rng.uniform(6.0, 25.0)
    cover = np.exp(-0.5 * ((smooth - middle) / width) ** 2)
    return cv2.add(grey, cover * np.float32(rng.normal(0.0, 45.0)), dtype=cv2.CV_8U)


def snow(grey: Image, rng: np.random.Generator) -> Image:
    """Cover smooth ground with white and leave edges, walls and trees to look out of it."""
    change = cv2.absdiff(grey, cv2.GaussianBlur(grey, (0, 0), 2.0)).astype(np.float32)
    rough = cv2.GaussianBlur(change, (0, 0), 1.5)
    depth = rng.uniform(0.5, 0.95) / (1.0 + (rough / rng.uniform(3.0, 12.0)) ** 2)
    white = float(rng.uniform(190.0, 250.0))
    return (grey + depth * (white - grey)).clip(0, 255).astype(np.uint8)


def haze(grey: Image, rng: np.random.Generator) -> Image:
    """Mix in scattered light, unevenly over the image (Koschmieder's law)."""
    lost = smooth_field(rng, grey.shape[0], 0.0, float(rng.uniform(0.2, 0.7))).clip(0.0, 0.8)
    light = float(rng.uniform(140.0, 240.0))
    return (grey + lost * (light - grey)).clip(0, 255).astype(np.uint8)


def lose_resolution(grey: Image, rng: np.random.Generator) -> Image:
    """Shrink by up to 2.2 and enlarge again: a map coarser than the camera."""
    size = grey.shape[0]
    small = round(size / rng.uniform(1.2, 2.2))
    shrunk = cv2.resize(grey, (small, small), interpolation=cv2.INTER_AREA)
    return cv2.resize(
        shrunk,
        (size, size),
        interpolation=cv2.INTER_LINEAR if rng.random() < 0.5 else cv2.INTER_CUBIC,
    )


def motion_blur(grey: Image, rng: np.random.Generator) -> Image:
    """Smear along a random direction by 2 to 7 px."""
    length, angle = rng.uniform(2.0, 7.0), rng.uniform(0, np.pi)
    kernel = np.zeros((9, 9), np.float32)
    du, dv = 0.5 * length * np.cos(angle), 0.5 * length * np.sin(angle)
    shift = 4  # fixed-point bits of cv2.line
    ends = [(round((4 + s * du) * 2**shift), round((4 + s * dv) * 2**shift)) for s in (-1, 1)]
    cv2.line(kernel, ends[0], ends[1], 1.0, 1, cv2.LINE_AA, shift)
    soft = cv2.GaussianBlur(kernel, (3, 3), 0.5)
    return cv2.filter2D(grey, -1, soft / soft.sum())


def add_noise(grey: Image, rng: np.random.Generator) -> Image:
    """Add sensor noise of 1 to 10 grey levels, sometimes coarse-grained."""
    noise = rng.standard_normal(grey.shape, dtype=np.float32)
    if rng.random() < 0.3:
        noise = 2.0 * cv2.GaussianBlur(noise, (3, 3), 0.7)
    sigma = np.exp(rng.uniform(0.0, np.log(10.0)))
    return cv2.add(grey, (sigma * noise), dtype=cv2.CV_8U)


def compress(grey: Image, rng: np.random.Generator) -> Image:
    """Go through a JPEG file of quality 25 to 90."""
    _, code = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(25, 90))])
    decoded = cv2.imdecode(code, cv2.IMREAD_GRAYSCALE)
    assert decoded is not None
    return decoded


def photograph(view: Image, rng: np.random.Generator, config: PhotometricConfig) -> Image:
    """Turn a clean view into what some sensor saw on some day.

    Args:
        view: (S, S, 3) BGR or (S, S) grey, uint8.
        rng: Random generator.
        config: Probabilities.

    Returns:
        (S, S) uint8.
    """

    def happens(probability: float) -> bool:
        return bool(rng.random() < probability)

    grey = to_grey(view, rng if happens(config.channel_mix) else None)
    if happens(config.season):
        grey = season(view, grey, rng)
    if happens(config.changed_things):
        grey = change_things(grey, rng)
    if happens(config.recolour):
        grey = recolour(grey, rng)
    if happens(config.snow):
        grey = snow(grey, rng)
    if happens(config.tone_curve):
        grey = cv2.LUT(grey, random_tone_curve(rng))
    if happens(config.gamma):
        grey = cv2.LUT(
            grey, (255 * np.linspace(0, 1, 256) ** np.exp(rng.normal(0.0, 0.4))).astype(np.uint8)
        )
    if happens(config.shading):
        grey = cv2.multiply(grey, smooth_field(rng, grey.shape[0], 0.55, 1.4), dtype=cv2.CV_8U)
    if happens(config.shadow):
        grey = cv2.multiply(grey, shadow_field(rng, grey.shape[0]), dtype=cv2.CV_8U)
    if happens(config.cast_shadows):
        grey = cast_shadows(grey, rng)
    if happens(config.haze):
        grey = haze(grey, rng)
    if happens(config.resolution):
        grey = lose_resolution(grey, rng)
    if happens(config.blur):
        grey = cv2.GaussianBlur(grey, (0, 0), float(rng.uniform(0.4, 1.4)))
    if happens(config.motion_blur):
        grey = motion_blur(grey, rng)
    if happens(config.noise):
        grey = add_noise(grey, rng)
    return compress(grey, rng) if happens(config.jpeg) else grey


def batch_augmentation() -> nn.Module:
    """Kornia's share: illumination over the whole batch, on (B, 1, S, S) float32 in 0 to 1."""
    import kornia.augmentation as augmentation

    return augmentation.AugmentationSequential(
        augmentation.RandomBrightness((0.75, 1.25), p=0.3),
        augmentation.RandomContrast((0.6, 1.3), p=0.3),
        data_keys=["input"],
    )
