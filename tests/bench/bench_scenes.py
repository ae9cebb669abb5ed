"""Small scenes and feature sets with known answers."""

from itertools import cycle

import cv2
import numpy as np

from vwnav.bench.features.methods import FeatureSet, Method
from vwnav.bench.features.scenes import ReferenceMap, Scene
from vwnav.types import Features


def ground(height: int = 400, width: int = 400, seed: int = 0) -> np.ndarray:
    """(h, w, 3) ground with corners everywhere."""
    rng = np.random.default_rng(seed)
    image = np.full((height, width, 3), 110, np.uint8)
    for _ in range(height * width // 900):
        corner = rng.integers(0, (width, height))
        size = rng.integers(4, 24, 2)
        shade = rng.integers(0, 256, 3).tolist()
        cv2.rectangle(image, corner.tolist(), (corner + size).tolist(), shade, -1)
    return cv2.GaussianBlur(image, (0, 0), 0.8)


def features(uv: np.ndarray) -> Features:
    """Features at places, each with a descriptor of its own."""
    codes = np.random.default_rng(5).normal(size=(len(uv), 32)).astype(np.float32)
    codes /= np.linalg.norm(codes, axis=1, keepdims=True)
    return Features(np.asarray(uv, np.float32), codes, np.ones(len(uv), np.float32))


def fixed(name: str, *found: Features) -> FeatureSet:
    """A feature set that finds the map's features first, then the image's, and so on."""
    answers = cycle(found)
    return FeatureSet(name, lambda gray, count: next(answers), [Method(name)])


def scene(H_1_0: np.ndarray | None, *, side: int = 128, unit_per_px: float = 1.0) -> Scene:
    """A blank scene whose middle lies at the middle of its map."""
    blank, everywhere = np.zeros((side, side), np.uint8), np.ones((side, side), np.bool_)
    middle = np.full(2, (side - 1) / 2.0)
    return Scene(
        group="drawn",
        name="one",
        image=blank,
        mask=everywhere,
        keypoints=100,
        map_=ReferenceMap(blank, everywhere, 100, unit_per_px, "px"),
        window=(-1.0, -1.0, side + 1.0, side + 1.0),
        point0_uv=middle,
        point1_uv=middle,
        H_1_0=H_1_0,
    )
