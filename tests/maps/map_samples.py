"""A synthetic landscape, a real extractor under a chosen name, and small packs."""

from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.maps.build.builder import BuildOptions, build_pack
from vwnav.maps.build.raster import array_source, level_georeference
from vwnav.maps.image import Mask
from vwnav.types import Features, Gray

ZOOM = 18
ORIGIN_PX = (37_000_000, 19_000_100)  # of the small map; its tiles are cut by the map's edge


class SiftStub:
    """OpenCV's SIFT, with a name and an identity that a test may choose."""

    def __init__(self, feature_set_id: str = "sift-test-1", name: str = "sift") -> None:
        self.feature_set_id, self.name = feature_set_id, name
        self.log10_per_decade = 1.5
        self.calls = 0

    def extract(self, gray: Gray, max_keypoints: int) -> Features:
        self.calls += 1
        sift = cv2.SIFT_create(nfeatures=max_keypoints, contrastThreshold=0.02)
        keypoints, descriptors = sift.detectAndCompute(gray, None)
        if descriptors is None:
            empty = np.zeros(0, np.float32)
            return Features(empty.reshape(0, 2), empty.reshape(0, 128), empty)
        order = np.argsort([-point.response for point in keypoints], kind="stable")
        uv = cv2.KeyPoint.convert(keypoints)[order]
        scores = np.array([point.response for point in keypoints], np.float32)[order]
        lengths = np.linalg.norm(descriptors, axis=1, keepdims=True)
        return Features(np.asarray(uv, np.float32), (descriptors / lengths)[order], scores)


class DotFinder:
    """Finds single bright pixels: what it must find is known exactly."""

    name, feature_set_id, log10_per_decade = "learned", "dots-1", 5.0

    def extract(self, gray: Gray, max_keypoints: int) -> Features:
        rows, columns = np.nonzero(gray == 255)
        uv = np.stack([columns, rows], axis=-1).astype(np.float32)[:max_keypoints]
        descriptors = np.tile(np.float32([0.6, 0.8]), (len(uv), 1))
        return Features(uv, descriptors, np.ones(len(uv), np.float32))


@lru_cache
def textured(height: int, width: int, seed: int = 1) -> NDArray[np.uint8]:
    """BGR with structure of every size, none of it near black or white."""
    rng = np.random.default_rng(seed)
    total = np.zeros((height, width, 3))
    for sigma in (1.5, 4.0, 12.0):
        noise = cv2.GaussianBlur(rng.normal(size=(height, width, 3)), (0, 0), sigma)
        total += noise / noise.std()
    return np.clip(128 + 25 * total, 20, 235).astype(np.uint8)


def small_pack(
    path: Path,
    extractors: tuple[SiftStub, ...] = (),
    mask: Mask | None = None,
    options: BuildOptions | None = None,
) -> Path:
    """A pack of 700 x 600 px at one level and the two coarser ones."""
    source = array_source(
        textured(600, 700), level_georeference(ZOOM, *ORIGIN_PX), name="field.png", mask=mask
    )
    build_pack([source], path, extractors, options)
    return path
