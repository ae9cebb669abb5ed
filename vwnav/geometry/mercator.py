"""Web-mercator (EPSG:3857) in pixels of a zoom level, 256 px tiles.

Global pixel coordinates have the corner convention: x = 0 is the left edge of the world, y = 0 its
upper edge (85.05 degrees north), and the centre of the first pixel is at 0.5.
"""

import math
from typing import overload

import numpy as np

from vwnav.geometry.geodesy import WGS84_A_M, WGS84_E2
from vwnav.types import Array

TILE_PX = 256
MAX_LAT_DEG = math.degrees(math.atan(math.sinh(math.pi)))
MAX_ZOOM = 30


@overload
def mercator_px(lat_deg: float, lon_deg: float, zoom: int) -> tuple[float, float]: ...
@overload
def mercator_px(lat_deg: Array, lon_deg: Array, zoom: int) -> tuple[Array, Array]: ...
def mercator_px(
    lat_deg: Array | float, lon_deg: Array | float, zoom: int
) -> tuple[Array | float, Array | float]:
    """(x, y) global pixels, corner convention; latitude is clipped to +-85.0511 degrees."""
    world_px = TILE_PX * 2.0**zoom
    sin_lat = np.sin(np.radians(np.clip(lat_deg, -MAX_LAT_DEG, MAX_LAT_DEG)))
    x = (np.asarray(lon_deg, dtype=np.float64) / 360.0 + 0.5) * world_px
    y = (0.5 - np.arctanh(sin_lat) / (2.0 * np.pi)) * world_px
    return (float(x), float(y)) if np.ndim(x) == 0 and np.ndim(y) == 0 else (x, y)


@overload
def lat_lon_from_mercator_px(x: float, y: float, zoom: int) -> tuple[float, float]: ...
@overload
def lat_lon_from_mercator_px(x: Array, y: Array, zoom: int) -> tuple[Array, Array]: ...
def lat_lon_from_mercator_px(
    x: Array | float, y: Array | float, zoom: int
) -> tuple[Array | float, Array | float]:
    """(lat_deg, lon_deg) of global pixels, corner convention."""
    world_px = TILE_PX * 2.0**zoom
    lon_deg = (np.asarray(x, dtype=np.float64) / world_px - 0.5) * 360.0
    northing = 2.0 * np.pi * (0.5 - np.asarray(y, dtype=np.float64) / world_px)
    lat_deg = np.degrees(np.arctan(np.sinh(northing)))
    if np.ndim(lat_deg) == 0 and np.ndim(lon_deg) == 0:
        return float(lat_deg), float(lon_deg)
    return lat_deg, lon_deg


def mercator_px_per_m(lat_deg: float, zoom: int) -> tuple[float, float]:
    """(px per metre east, px per metre north) on WGS84, at height zero.

    The projection treats geodetic latitude as if the earth were a sphere, so the two differ: by
    0.67 % at the equator, by nothing at the poles (k and h of EPSG 1024, Popular Visualisation).
    """
    lat = math.radians(lat_deg)
    w2 = 1.0 - WGS84_E2 * math.sin(lat) ** 2
    px_per_equator_m = TILE_PX * 2.0**zoom / (2.0 * math.pi * WGS84_A_M)
    east = px_per_equator_m * math.sqrt(w2) / math.cos(lat)
    north = px_per_equator_m * w2**1.5 / (1.0 - WGS84_E2) / math.cos(lat)
    return east, north


def ground_resolution_m_per_px(lat_deg: float, zoom: int) -> float:
    """Metres per pixel, geometric mean of east and north."""
    east, north = mercator_px_per_m(lat_deg, zoom)
    return 1.0 / math.sqrt(east * north)


def zoom_for_resolution(lat_deg: float, m_per_px: float) -> int:
    """The zoom level, within 0 to 30, whose resolution is nearest (as a ratio) to `m_per_px`.

    Raises:
        ValueError: `m_per_px` is not a positive number.
    """
    if not (math.isfinite(m_per_px) and m_per_px > 0.0):
        raise ValueError(f"expected a positive resolution in metres per pixel, got {m_per_px}")
    zoom = round(math.log2(ground_resolution_m_per_px(lat_deg, 0) / m_per_px))
    return min(max(zoom, 0), MAX_ZOOM)
