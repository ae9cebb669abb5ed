"""GeoTIFFs with marks whose places are known by pyproj."""

import warnings
from pathlib import Path

import cv2
import numpy as np
import pyproj
import rasterio
from map_samples import textured
from rasterio.enums import ColorInterp
from rasterio.errors import NotGeoreferencedWarning
from rasterio.transform import Affine

UTM = "EPSG:32643"
LEFT_M, TOP_M, PIXEL_M = 313_100.0, 3_724_900.0, 0.5
TRANSFORM = Affine(PIXEL_M, 0.0, LEFT_M, 0.0, -PIXEL_M, TOP_M)
MARKS_UV = np.array([[60.3, 70.8], [301.5, 90.25], [180.9, 200.1], [55.0, 280.6], [333.3, 270.7]])


def marked_rgb(height: int = 340, width: int = 400) -> np.ndarray:
    """(3, h, w) gray ground with round bright marks; `MARKS_UV` in the corner convention."""
    v, u = np.mgrid[:height, :width] + 0.5
    gray = np.full((height, width), 80.0)
    for mark_u, mark_v in MARKS_UV:
        gray += 150.0 * np.exp(-((u - mark_u) ** 2 + (v - mark_v) ** 2) / (2 * 2.5**2))
    return np.repeat(np.round(gray).astype(np.uint8)[None], 3, axis=0)


def marks_lat_lon() -> list[tuple[float, float]]:
    to_wgs84 = pyproj.Transformer.from_crs(UTM, "EPSG:4326", always_xy=True)
    x, y = LEFT_M + PIXEL_M * MARKS_UV[:, 0], TOP_M - PIXEL_M * MARKS_UV[:, 1]
    lon, lat = to_wgs84.transform(x, y)
    return list(zip(lat, lon, strict=True))


def texture_rgb(height: int = 300, width: int = 320) -> np.ndarray:
    return np.moveaxis(textured(height, width)[..., ::-1], -1, 0).copy()


def write_tiff(path: Path, bands: np.ndarray, *, alpha: bool = False, **profile) -> Path:
    settings = {"crs": UTM, "transform": TRANSFORM, "dtype": bands.dtype} | profile
    count, height, width = bands.shape
    warnings.simplefilter("ignore", NotGeoreferencedWarning)
    with rasterio.open(
        path, "w", driver="GTiff", count=count, height=height, width=width, **settings
    ) as file:
        file.write(bands)
        if alpha:
            file.colorinterp = [
                ColorInterp.red,
                ColorInterp.green,
                ColorInterp.blue,
                ColorInterp.alpha,
            ]
    return path


def write_palette_tiff(path: Path, rgb: np.ndarray, *, transparent: int | None = None) -> Path:
    """An indexed image of 64 colours; index 5 is unused but for a hole if one is wanted."""
    levels = (rgb.astype(int) // 64).clip(0, 3)
    index = (levels[0] * 16 + levels[1] * 4 + levels[2]).astype(np.uint8) + 10
    if transparent is not None:
        index[100:160, 100:180] = transparent
    profile = {"crs": UTM, "transform": TRANSFORM, "dtype": "uint8", "photometric": "palette"}
    height, width = index.shape
    every = [(r, g, b) for r in range(4) for g in range(4) for b in range(4)]
    table = {10 + i: (*(64 * value + 32 for value in rgb), 255) for i, rgb in enumerate(every)}
    with rasterio.open(
        path, "w", driver="GTiff", count=1, height=height, width=width, **profile
    ) as file:
        file.write(index, 1)
        if transparent is not None:
            file.nodata = transparent
        file.write_colormap(1, table)
    return path


def found_mark(gray: np.ndarray, near_uv: np.ndarray) -> np.ndarray:
    """Centre of brightness within 10 px of a place, centre convention."""
    u0, v0 = np.round(near_uv).astype(int) - 10
    patch = gray[v0 : v0 + 21, u0 : u0 + 21].astype(float) - 80.0
    moments = cv2.moments(np.clip(patch, 0, None))
    return np.array([moments["m10"], moments["m01"]]) / moments["m00"] + (u0, v0)
