"""How tiles and features are written in a pack: PNG images, and features quantised in a blob."""

from typing import Literal, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.geometry.geodesy import TILE_PX
from vwnav.maps.image import MapImage
from vwnav.types import FeatureName, Features

DescriptorKind = Literal["int8", "uint8", "binary"]
DESCRIPTOR_KINDS: tuple[DescriptorKind, ...] = get_args(DescriptorKind)
UV_STEPS_PER_PX = 256  # a tile of 256 px in uint16: nothing is lost against a detector's 0.1 px
PNG_COMPRESSION = 4


def encode_tile(image: MapImage) -> bytes:
    """PNG of a tile: BGR where it is complete, with alpha where data are missing.

    Raises:
        ValueError: not a tile's size.
    """
    if image.mask.shape != (TILE_PX, TILE_PX):
        raise ValueError(f"expected a tile of {TILE_PX} px, got {image.mask.shape}")
    pixels = image.bgr
    if not image.mask.all():
        alpha = np.where(image.mask, 255, 0).astype(np.uint8)
        pixels = np.dstack([np.where(image.mask[..., None], pixels, 0).astype(np.uint8), alpha])
    _, png = cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, PNG_COMPRESSION])
    return png.tobytes()


def decode_tile(data: bytes) -> MapImage:
    """The image of a tile.

    Raises:
        ValueError: the data are no image of a tile's size.
    """
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data else None
    if pixels is None or pixels.dtype != np.uint8 or pixels.shape[:2] != (TILE_PX, TILE_PX):
        raise ValueError("the tile is no picture of 256 x 256 px")
    if pixels.ndim == 2:
        pixels = cv2.cvtColor(pixels, cv2.COLOR_GRAY2BGR)
    if pixels.shape[2] == 4:
        return MapImage(np.ascontiguousarray(pixels[..., :3]), pixels[..., 3] >= 128)
    return MapImage(np.asarray(pixels, np.uint8), np.ones(pixels.shape[:2], np.bool_))


def descriptor_kind(name: FeatureName) -> DescriptorKind:
    """How the descriptors of a feature set are stored."""
    match name:
        case "learned":
            return "int8"
        case "sift":
            return "uint8"
        case "orb":
            return "binary"


def encode_features(features: Features, kind: DescriptorKind) -> bytes:
    """A blob: uv as (n, 2) uint16, scores (n,) float32, descriptors (n, d) of one byte each.

    Float descriptors are stored as multiples of their own largest value. That scale need not be
    kept: they have unit length, which gives it back.

    Args:
        features: uv relative to the tile, centre convention, within [-0.5, 255.5].
        kind: of the descriptors.

    Raises:
        ValueError: the descriptors are not of that kind.
    """
    steps = np.round((features.uv.astype(np.float64) + 0.5) * UV_STEPS_PER_PX)
    uv = np.clip(steps, 0, TILE_PX * UV_STEPS_PER_PX - 1).astype("<u2")
    parts = (uv, features.scores.astype("<f4"), _quantised(features.descriptors, kind))
    return b"".join(part.tobytes() for part in parts)


def decode_features(data: bytes, keypoints: int, dimension: int, kind: DescriptorKind) -> Features:
    """Features of a tile from their blob; float descriptors have unit length again.

    Raises:
        ValueError: the blob has not the size of so many keypoints.
    """
    if len(data) != keypoints * (8 + dimension):
        raise ValueError(f"expected {keypoints} keypoints, got {len(data)} bytes")
    uv = np.frombuffer(data, "<u2", 2 * keypoints).reshape(keypoints, 2)
    scores = np.frombuffer(data, "<f4", keypoints, 4 * keypoints).astype(np.float32)
    dtype = np.int8 if kind == "int8" else np.uint8
    stored = np.frombuffer(data, dtype, offset=8 * keypoints).reshape(keypoints, dimension)
    centred = (uv.astype(np.float32) / np.float32(UV_STEPS_PER_PX)) - np.float32(0.5)
    if kind == "binary":
        return Features(centred, stored.astype(np.uint8), scores)
    values = stored.astype(np.float32)
    length = np.linalg.norm(values, axis=1, keepdims=True)
    return Features(centred, values / np.maximum(length, np.float32(1.0)), scores)


def _quantised(
    descriptors: NDArray[np.float32] | NDArray[np.uint8], kind: DescriptorKind
) -> NDArray[np.int8] | NDArray[np.uint8]:
    if kind == "binary":
        if descriptors.dtype != np.uint8:
            raise ValueError(f"expected binary descriptors, got {descriptors.dtype}")
        return descriptors.astype(np.uint8)
    if descriptors.dtype == np.uint8:
        raise ValueError("expected float descriptors, got binary ones")
    if kind == "uint8" and descriptors.size and descriptors.min() < 0.0:
        raise ValueError("expected descriptors without negative values")
    largest = np.abs(descriptors).max(axis=1, keepdims=True, initial=1e-12)
    if kind == "uint8":
        return np.asarray(np.round(descriptors / largest * 255.0), np.uint8)
    return np.asarray(np.round(descriptors / largest * 127.0), np.int8)
