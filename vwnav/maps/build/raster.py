"""Georeferenced rasters: what a map is built from."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from vwnav.geometry.geodesy import LocalFrame, Window, lat_lon_from_mercator_px, mercator_px
from vwnav.maps.image import MapImage, Mask
from vwnav.types import Array

Bounds = tuple[float, float, float, float]  # south, west, north, east in degrees


@dataclass(frozen=True, slots=True, eq=False)
class Georeference:
    """Where a raster's pixels lie; both ways take and give arrays of one shape.

    Pixels have the corner convention: (0, 0) is the outer corner of the first one.

    Attributes:
        pixel_from_lat_lon: (lat_deg, lon_deg) -> (u, v).
        lat_lon_from_pixel: (u, v) -> (lat_deg, lon_deg).
    """

    pixel_from_lat_lon: Callable[[Array, Array], tuple[Array, Array]]
    lat_lon_from_pixel: Callable[[Array, Array], tuple[Array, Array]]


class RasterSource(Protocol):
    """A georeferenced raster that can be read in windows."""

    @property
    def name(self) -> str:
        """For provenance and messages."""
        ...

    @property
    def size_wh(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        ...

    @property
    def georeference(self) -> Georeference:
        """Where its pixels lie."""
        ...

    def window(self, window: Window) -> MapImage:
        """A part of the raster; the window lies inside of it."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class DrawnSource:
    """A raster whose windows a function gives: nothing but numpy and OpenCV is needed.

    Attributes:
        name: for provenance and messages.
        size_wh: (width, height) in pixels.
        georeference: where its pixels lie.
        draw: gives the image of a window that lies inside of the raster.
    """

    name: str
    size_wh: tuple[int, int]
    georeference: Georeference
    draw: Callable[[Window], MapImage]

    def window(self, window: Window) -> MapImage:
        """A part of the raster."""
        return self.draw(window)


def array_source(
    bgr: NDArray[np.uint8], georeference: Georeference, *, name: str, mask: Mask | None = None
) -> DrawnSource:
    """A raster in memory.

    Args:
        bgr: (h, w, 3) uint8.
        georeference: such as `local_georeference` or `corner_georeference` give.
        name: for provenance and messages.
        mask: (h, w), true where there are data; everywhere if not given.
    """
    image = MapImage(bgr, np.ones(bgr.shape[:2], np.bool_) if mask is None else mask)
    return DrawnSource(name, (bgr.shape[1], bgr.shape[0]), georeference, image.crop)


def local_georeference(
    frame: LocalFrame, top_left_ne_m: tuple[float, float], m_per_px: float
) -> Georeference:
    """Of a north-up raster in a local frame, on the ground at the height of its origin.

    Args:
        frame: its north and east are those of the raster's sides.
        top_left_ne_m: north and east of the outer corner of the first pixel, metres.
        m_per_px: the same along both axes.
    """
    north_m, east_m = top_left_ne_m

    def forward(lat_deg: Array, lon_deg: Array) -> tuple[Array, Array]:
        ned_m = frame.to_ned(lat_deg, lon_deg, frame.alt_amsl_m)
        return (ned_m[..., 1] - east_m) / m_per_px, (north_m - ned_m[..., 0]) / m_per_px

    def inverse(u: Array, v: Array) -> tuple[Array, Array]:
        north, east = north_m - np.asarray(v) * m_per_px, east_m + np.asarray(u) * m_per_px
        down = np.zeros_like(north)
        # The ground bends away below the frame's tangent plane, by d^2 / 2R.
        for _ in range(2):
            _, _, alt_m = frame.to_geodetic(np.stack([north, east, down], axis=-1))
            down = down + (alt_m - frame.alt_amsl_m)
        lat_deg, lon_deg, _ = frame.to_geodetic(np.stack([north, east, down], axis=-1))
        return lat_deg, lon_deg

    return Georeference(forward, inverse)


def corner_georeference(bounds: Bounds, size_wh: tuple[int, int]) -> Georeference:
    """Of an image known by its corners (south, west, north, east).

    Such images are cut from web maps, so their rows are even in web-mercator. Over a kilometre
    that differs from even degrees by centimetres.
    """
    south, west, north, east = bounds
    w, h = size_wh
    x0, y0 = mercator_px(north, west, 0)
    x1, y1 = mercator_px(south, east, 0)

    def forward(lat_deg: Array, lon_deg: Array) -> tuple[Array, Array]:
        x, y = mercator_px(lat_deg, lon_deg, 0)
        return (x - x0) / (x1 - x0) * w, (y - y0) / (y1 - y0) * h

    def inverse(u: Array, v: Array) -> tuple[Array, Array]:
        return lat_lon_from_mercator_px(
            x0 + np.asarray(u) / w * (x1 - x0), y0 + np.asarray(v) / h * (y1 - y0), 0
        )

    return Georeference(forward, inverse)


def level_georeference(zoom: int, x0: int, y0: int) -> Georeference:
    """Of pixels of a level, counted from the global pixel (x0, y0)."""

    def forward(lat_deg: Array, lon_deg: Array) -> tuple[Array, Array]:
        x, y = mercator_px(lat_deg, lon_deg, zoom)
        return x - x0, y - y0

    def inverse(u: Array, v: Array) -> tuple[Array, Array]:
        return lat_lon_from_mercator_px(np.asarray(u) + x0, np.asarray(v) + y0, zoom)

    return Georeference(forward, inverse)
