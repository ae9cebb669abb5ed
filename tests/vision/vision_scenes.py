"""Generated ground, and images of it from known poses."""

import math
from pathlib import Path

import cv2
import numpy as np

from vwnav.geometry.camera import Camera, rectification
from vwnav.geometry.geodesy import LocalFrame
from vwnav.geometry.rotations import rotation_from_euler
from vwnav.maps.build.builder import BuildOptions, build_pack
from vwnav.maps.build.raster import array_source, local_georeference
from vwnav.types import FeatureExtractor, Frame

HOME = LocalFrame(47.0, 8.0, 400.0)
M_PER_PX = 0.3
GROUND_PX = 840
CAMERA = Camera.from_hfov(480, 360, 70.0)


def texture(seed: int, size_px: int = GROUND_PX) -> np.ndarray:
    """Gray ground (size, size): noise of several scales with plots, roads and roofs on it."""
    rng = np.random.default_rng(seed)
    ground = np.full((size_px, size_px), 110.0, np.float32)
    for cells in (size_px // 128, size_px // 32, size_px // 8, size_px // 3):
        noise = rng.normal(0.0, 14.0, (max(2, cells), max(2, cells))).astype(np.float32)
        ground += cv2.resize(noise, (size_px, size_px), interpolation=cv2.INTER_CUBIC)
    for _ in range(size_px * size_px // 9000):
        center, sides = rng.uniform(0, size_px, 2), rng.uniform(6, 40, 2)
        box = cv2.boxPoints((tuple(center), tuple(sides), float(rng.uniform(0, 90))))
        cv2.fillPoly(ground, [box.astype(np.int32)], float(rng.uniform(30, 230)))
    for _ in range(size_px // 200):
        ends = rng.integers(0, size_px, (2, 2)).tolist()
        cv2.line(ground, ends[0], ends[1], float(rng.uniform(60, 200)), int(rng.integers(2, 7)))
    return np.clip(ground, 0, 255).astype(np.uint8)


def north_east_m(u: float, v: float, size_px: int = GROUND_PX) -> tuple[float, float]:
    """Of a pixel of the ground; its middle is home."""
    return (size_px / 2 - 0.5 - v) * M_PER_PX, (u - size_px / 2 + 0.5) * M_PER_PX


def ground_pack(
    path: Path, gray: np.ndarray, extractors: tuple[FeatureExtractor, ...], levels: int = 2
) -> Path:
    """A pack of a ground about home."""
    bgr = cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR)
    half_m = gray.shape[0] / 2 * M_PER_PX
    georeference = local_georeference(HOME, (half_m, -half_m), M_PER_PX)
    source = array_source(bgr, georeference, name="ground")
    zooms = tuple(18 - i for i in range(levels))
    options = BuildOptions(levels=zooms, georeference_sigma_m=0.1)
    build_pack([source], path, extractors, options)
    return path


def frame_at(
    gray: np.ndarray,
    north_m: float,
    east_m: float,
    agl_m: float,
    *,
    rpy_deg: tuple[float, float, float] = (0.0, 0.0, 0.0),
    rng: np.random.Generator | None = None,
    camera: Camera = CAMERA,
) -> Frame:
    """What a camera at a place sees of a ground, with another tone and some noise."""
    R_ned_camera = rotation_from_euler(*map(math.radians, rpy_deg)) @ camera.R_body_camera
    size_wh = (camera.width_px, camera.height_px)
    view = rectification(camera.K, size_wh, R_ned_camera, agl_m, M_PER_PX, 4000)
    half = gray.shape[0] / 2 - 0.5
    nadir_px = np.array([half + east_m / M_PER_PX, half - north_m / M_PER_PX])
    shift = np.eye(3)
    shift[:2, 2] = nadir_px - view.nadir_uv
    H_ground_frame = shift @ view.H_rect_frame
    flags = cv2.INTER_AREA | cv2.WARP_INVERSE_MAP
    image = cv2.warpPerspective(gray, H_ground_frame, size_wh, flags=flags).astype(np.float32)
    if rng is not None:
        image = 255.0 * (image / 255.0) ** rng.uniform(0.8, 1.25) * rng.uniform(0.85, 1.1)
        image += rng.normal(0.0, 3.0, image.shape)
    return Frame(0.0, np.clip(image, 0, 255).astype(np.uint8), 0)
