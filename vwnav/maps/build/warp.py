"""Warps georeferenced rasters onto the web-mercator grid."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.errors import MapError
from vwnav.geometry.geodesy import (
    MAX_LAT_DEG,
    TILE_PX,
    Window,
    ground_resolution_m_per_px,
    horizontal_distance_m,
    lat_lon_from_mercator_px,
    mercator_px,
)
from vwnav.maps.build.raster import Bounds, RasterSource
from vwnav.maps.image import MapImage, window_slices
from vwnav.types import Array

BLOCK_PX = 4 * TILE_PX  # rendered at once
_SMALLEST_PART_PX = 32
_NODE_PX = 32  # exact georeference at such a grid, linear between: 1e-4 px at worst
_EDGE_PX = 0.49  # images with rounded corners leave gaps of up to a pixel between them
_PAD_PX = 4  # what the cubic kernel and the mask's erosion reach
_ALIGNED_PX = 1e-3
_FAR_PX = 1e9
_SMALLEST_M_PER_PX = 1e-3


@dataclass(frozen=True, slots=True)
class PlacedRaster:
    """A raster with its place on earth.

    Attributes:
        bounds: south, west, north, east, degrees.
        m_per_px: at its middle, geometric mean of both axes.
    """

    source: RasterSource
    bounds: Bounds
    m_per_px: float

    @classmethod
    def of(cls, source: RasterSource) -> "PlacedRaster":
        """Find a raster's place.

        Raises:
            MapError: it lies nowhere on the web-mercator map, crosses the 180th meridian, or its
                pixels have no size that can be.
        """
        bounds = _bounds(source)
        m_per_px = _m_per_px(source)
        if not (math.isfinite(m_per_px) and m_per_px > 0.0):
            raise MapError(f"{source.name}: its georeference gives pixels without a size")
        if m_per_px < _SMALLEST_M_PER_PX:
            raise MapError(
                f"{source.name}: its pixels are {1e3 * m_per_px:.2g} mm wide by its georeference, "
                "which no map's are: degrees under a coordinate system in metres? say the right "
                "one (gdal_edit.py -a_srs, or --crs EPSG:4326 beside a world file)"
            )
        return cls(source, bounds, m_per_px)

    def window(self, zoom: int) -> Window:
        """The global pixels of a level that it touches."""
        return bounds_window(self.bounds, zoom)

    def reduction(self, zoom: int) -> int:
        """By how much it is averaged before a level is sampled from it."""
        wanted = ground_resolution_m_per_px((self.bounds[0] + self.bounds[2]) / 2.0, zoom)
        return max(1, round(wanted / self.m_per_px))


def render(raster: PlacedRaster, zoom: int, window: Window) -> MapImage | None:
    """Warp a raster onto global pixels of a level; None where it has nothing.

    Cubic interpolation; where the level is coarser than the raster, its area is averaged first,
    and where their pixels coincide they are copied.
    """
    u, v = _source_pixels(raster.source, zoom, window)
    w, h = raster.source.size_wh
    inside = (u >= -_EDGE_PX) & (u <= w + _EDGE_PX) & (v >= -_EDGE_PX) & (v <= h + _EDGE_PX)
    if not inside.any():
        return None
    k = raster.reduction(zoom)
    needed = _needed(u[inside], v[inside], k, (w, h))
    image = _reduced(raster.source.window(needed), k)
    if not image.mask.any():
        return None
    u_local, v_local = (u - needed.x0) / k - 0.5, (v - needed.y0) / k - 0.5
    sample = _copied if _aligned(u_local) and _aligned(v_local) else _interpolated
    sampled = sample(image, u_local.astype(np.float32), v_local.astype(np.float32))
    mask = sampled.mask & inside
    return MapImage(np.where(mask[..., None], sampled.bgr, 0).astype(np.uint8), mask)


def compose(rasters: Sequence[PlacedRaster], zoom: int, block: Window) -> MapImage:
    """Global pixels of a level from all rasters; the first one that has data wins."""
    out = MapImage.empty(block.shape)
    for raster in rasters:
        # A raster much finer than the level is read in smaller parts, or it would fill the memory.
        size_px = max(BLOCK_PX // raster.reduction(zoom), _SMALLEST_PART_PX)
        for part in block.parts(size_px):
            if 0 not in raster.window(zoom).grown(1).clipped(part).shape:
                _fill(out, block, raster, zoom, part)
        if out.mask.all():
            break
    return out


def _fill(out: MapImage, block: Window, raster: PlacedRaster, zoom: int, part: Window) -> None:
    into = window_slices(part, block.x0, block.y0)
    missing = ~out.mask[into]
    image = render(raster, zoom, part) if missing.any() else None
    if image is not None:
        fresh = image.mask & missing
        out.bgr[into][fresh] = image.bgr[fresh]
        out.mask[into] |= fresh


def _aligned(at: Array) -> bool:
    return bool(np.abs(at - np.round(at)).max() < _ALIGNED_PX)


def _copied(image: MapImage, u: NDArray[np.float32], v: NDArray[np.float32]) -> MapImage:
    h, w = image.mask.shape
    rows = np.round(v).astype(np.int64).clip(0, h - 1)
    columns = np.round(u).astype(np.int64).clip(0, w - 1)
    return MapImage(image.bgr[rows, columns], image.mask[rows, columns])


def _interpolated(image: MapImage, u: NDArray[np.float32], v: NDArray[np.float32]) -> MapImage:
    bgr = cv2.remap(image.bgr, u, v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    # Two pixels next to missing data are dropped: the cubic kernel mixes it into them.
    solid = cv2.erode(image.mask.astype(np.uint8), np.ones((5, 5), np.uint8)) * np.uint8(255)
    data = cv2.remap(solid, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return MapImage(np.asarray(bgr, np.uint8), np.asarray(data) >= 128)


def bounds_window(bounds: Bounds, zoom: int) -> Window:
    """The global pixels of a level that touch (south, west, north, east)."""
    south, west, north, east = bounds
    x0, y0 = mercator_px(north, west, zoom)
    x1, y1 = mercator_px(south, east, zoom)
    return Window(math.floor(x0), math.floor(y0), math.ceil(x1), math.ceil(y1))


def _source_pixels(source: RasterSource, zoom: int, window: Window) -> tuple[Array, Array]:
    """(u, v), each (h, w): where the centres of the window's pixels lie in the raster."""
    nodes_x, weights_x = _interpolation(window.x0, window.x1)
    nodes_y, weights_y = _interpolation(window.y0, window.y1)
    grid_x, grid_y = np.meshgrid(nodes_x, nodes_y)
    lat, lon = lat_lon_from_mercator_px(grid_x, grid_y, zoom)
    u, v = source.georeference.pixel_from_lat_lon(lat, lon)
    # Nodes beyond what a projection can express: far outside.
    u, v = (np.nan_to_num(at, nan=_FAR_PX, posinf=_FAR_PX, neginf=-_FAR_PX) for at in (u, v))
    return weights_y @ u @ weights_x.T, weights_y @ v @ weights_x.T


def _interpolation(first: int, last: int) -> tuple[Array, Array]:
    """Nodes (m,) of an even grid over [first, last], and weights (last - first, m) on them."""
    count = max(2, -(-(last - first) // _NODE_PX) + 1)
    nodes = np.linspace(first, last, count)
    at = (np.arange(first, last) + 0.5 - first) / (last - first) * (count - 1)
    low = np.minimum(at.astype(np.int64), count - 2)
    weights = np.zeros((last - first, count))
    rows = np.arange(last - first)
    weights[rows, low] = 1.0 - (at - low)
    weights[rows, low + 1] = at - low
    return nodes, weights


def _needed(u: Array, v: Array, k: int, size_wh: tuple[int, int]) -> Window:
    """The raster's pixels under (u, v) with a margin, from multiples of k so that blocks agree."""
    w, h = size_wh
    x0, y0 = (math.floor(value.min() / k - _PAD_PX) * k for value in (u, v))
    x1, y1 = (math.ceil(value.max() / k + _PAD_PX) * k for value in (u, v))
    return Window(max(x0, 0), max(y0, 0), min(x1, w), min(y1, h))


def _reduced(image: MapImage, k: int) -> MapImage:
    """The mean of each k x k pixels that have data; part of a cell at the far edges is lost."""
    if k == 1:
        return image
    h, w = (max(side // k, 1) * k for side in image.mask.shape)
    size = (w // k, h // k)
    weight = cv2.resize(image.mask[:h, :w].astype(np.float32), size, interpolation=cv2.INTER_AREA)
    masked = np.where(image.mask[:h, :w, None], image.bgr[:h, :w], 0).astype(np.float32)
    total = cv2.resize(masked, size, interpolation=cv2.INTER_AREA)
    mean = total / np.maximum(weight, 1e-6)[..., None]
    return MapImage(np.round(mean).clip(0, 255).astype(np.uint8), weight >= 0.5)


def _bounds(source: RasterSource) -> Bounds:
    """Where a raster lies, from points along its edges."""
    w, h = source.size_wh
    along = np.linspace(0.0, 1.0, 33)
    zero, one = np.zeros_like(along), np.ones_like(along)
    u = np.concatenate([along, along, zero, one]) * w
    v = np.concatenate([zero, one, along, along]) * h
    lat, lon = source.georeference.lat_lon_from_pixel(u, v)
    if not (np.isfinite(lat).all() and np.isfinite(lon).all() and np.abs(lon).max() <= 360.0):
        raise MapError(f"{source.name}: its georeference gives no latitude and longitude")
    if np.abs(lat).max() > MAX_LAT_DEG:
        raise MapError(f"{source.name}: reaches beyond {MAX_LAT_DEG:.2f} degrees of latitude")
    if np.ptp(lon) > 180.0 or np.abs(lon).max() > 180.0:
        raise MapError(f"{source.name}: crosses the 180th meridian; cut it there, make two packs")
    return float(lat.min()), float(lon.min()), float(lat.max()), float(lon.max())


def _m_per_px(source: RasterSource) -> float:
    w, h = source.size_wh
    u = np.array([0.0, 1.0, 0.0]) + w / 2.0
    v = np.array([0.0, 0.0, 1.0]) + h / 2.0
    lat, lon = source.georeference.lat_lon_from_pixel(u, v)
    along_u = horizontal_distance_m(lat[0], lon[0], lat[1], lon[1])
    along_v = horizontal_distance_m(lat[0], lon[0], lat[2], lon[2])
    return math.sqrt(along_u * along_v)
