"""Positions on the WGS84 ellipsoid, in a local north-east-down frame and on the web-mercator map.

All are exact both ways. Web-mercator (EPSG:3857) is in pixels of a zoom level, 256 px tiles. Its
global pixel coordinates have the corner convention: x = 0 is the left edge of the world, y = 0 its
upper edge (85.05 degrees north), and the centre of the first pixel is at 0.5.
"""

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple, overload

import numpy as np
from numpy.typing import ArrayLike

from vwnav.errors import ConfigError
from vwnav.types import Array

WGS84_A_M = 6378137.0
WGS84_F = 1.0 / 298.257223563
WGS84_E2 = WGS84_F * (2.0 - WGS84_F)
_B_M = WGS84_A_M * (1.0 - WGS84_F)
_EP2 = WGS84_E2 / (1.0 - WGS84_E2)
TILE_PX = 256
MAX_LAT_DEG = math.degrees(math.atan(math.sinh(math.pi)))
MAX_ZOOM = 30
_MOST_PLACES = 50_000  # along a route: 500 km of it every 10 m


def ecef_from_geodetic(lat_deg: ArrayLike, lon_deg: ArrayLike, alt_m: ArrayLike) -> Array:
    """Earth-centred coordinates (…, 3) in metres; the height is above the ellipsoid."""
    lat, lon, alt = np.broadcast_arrays(
        np.radians(np.asarray(lat_deg, dtype=np.float64)),
        np.radians(np.asarray(lon_deg, dtype=np.float64)),
        np.asarray(alt_m, dtype=np.float64),
    )
    sin_lat = np.sin(lat)
    prime_m = WGS84_A_M / np.sqrt(1.0 - WGS84_E2 * sin_lat**2)
    radial_m = (prime_m + alt) * np.cos(lat)
    z_m = (prime_m * (1.0 - WGS84_E2) + alt) * sin_lat
    return np.stack([radial_m * np.cos(lon), radial_m * np.sin(lon), z_m], axis=-1)


class LocalFrame:
    """North-east-down coordinates about an origin, exact on WGS84 (by way of ECEF).

    Heights are above mean sea level. The undulation of the geoid is taken as the same at the origin
    and at the point, which over the few kilometres of a flight is good to centimetres.
    """

    def __init__(self, lat_deg: float, lon_deg: float, alt_amsl_m: float) -> None:
        if not (math.isfinite(lat_deg + lon_deg + alt_amsl_m) and abs(lat_deg) <= 90.0):
            raise ValueError(
                f"expected an origin in degrees, got {lat_deg}, {lon_deg}, {alt_amsl_m}"
            )
        self.lat_deg, self.lon_deg, self.alt_amsl_m = lat_deg, lon_deg, alt_amsl_m
        lat, lon = math.radians(lat_deg), math.radians(lon_deg)
        sin_lat, cos_lat, sin_lon, cos_lon = (
            math.sin(lat),
            math.cos(lat),
            math.sin(lon),
            math.cos(lon),
        )
        self._R_ned_ecef = np.array(
            [
                [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat],
                [-sin_lon, cos_lon, 0.0],
                [-cos_lat * cos_lon, -cos_lat * sin_lon, -sin_lat],
            ]
        )
        self._origin_ecef_m = ecef_from_geodetic(lat_deg, lon_deg, alt_amsl_m)

    def to_ned(self, lat_deg: ArrayLike, lon_deg: ArrayLike, alt_amsl_m: ArrayLike) -> Array:
        """Coordinates (…, 3) north, east, down in metres; arguments broadcast."""
        offset_m = ecef_from_geodetic(lat_deg, lon_deg, alt_amsl_m) - self._origin_ecef_m
        return np.asarray(offset_m @ self._R_ned_ecef.T)

    def to_geodetic(self, ned_m: ArrayLike) -> tuple[Array, Array, Array]:
        """(lat_deg, lon_deg, alt_amsl_m), each (…), of points (…, 3); scalars for one point.

        Longitude is within [-180, 180]. Bowring (1976) for the start and two fixed-point steps,
        each of which shrinks the error by e^2: below 1e-9 m wherever an aircraft flies, poles
        included.
        """
        offset_m = np.asarray(ned_m, dtype=np.float64) @ self._R_ned_ecef
        x, y, z = np.moveaxis(self._origin_ecef_m + offset_m, -1, 0)
        radial_m = np.hypot(x, y)
        reduced = np.arctan2(z * WGS84_A_M, radial_m * _B_M)
        lat = np.arctan2(
            z + _EP2 * _B_M * np.sin(reduced) ** 3,
            radial_m - WGS84_E2 * WGS84_A_M * np.cos(reduced) ** 3,
        )
        for _ in range(2):
            prime_m = WGS84_A_M / np.sqrt(1.0 - WGS84_E2 * np.sin(lat) ** 2)
            lat = np.arctan2(z + WGS84_E2 * prime_m * np.sin(lat), radial_m)
        # This form of the height holds at the poles, where radial / cos(lat) does not.
        own_m = WGS84_A_M * np.sqrt(1.0 - WGS84_E2 * np.sin(lat) ** 2)
        alt_m = radial_m * np.cos(lat) + z * np.sin(lat) - own_m
        return np.degrees(lat), np.degrees(np.arctan2(y, x)), alt_m


@overload
def horizontal_distance_m(
    lat0_deg: float, lon0_deg: float, lat1_deg: float, lon1_deg: float
) -> float: ...
@overload
def horizontal_distance_m(
    lat0_deg: Array | float, lon0_deg: Array | float, lat1_deg: Array, lon1_deg: Array
) -> Array: ...
def horizontal_distance_m(
    lat0_deg: Array | float,
    lon0_deg: Array | float,
    lat1_deg: Array | float,
    lon1_deg: Array | float,
) -> Array | float:
    """Distance along the ellipsoid between near points (better than 1e-5 of it up to 50 km).

    Radii of curvature at the middle latitude; the antimeridian is crossed the short way.
    """
    middle = np.radians((np.asarray(lat0_deg) + np.asarray(lat1_deg)) / 2.0)
    w2 = 1.0 - WGS84_E2 * np.sin(middle) ** 2
    meridian_m = WGS84_A_M * (1.0 - WGS84_E2) / w2**1.5
    prime_m = WGS84_A_M / np.sqrt(w2)
    d_lon_deg = (np.asarray(lon1_deg) - np.asarray(lon0_deg) + 180.0) % 360.0 - 180.0
    north_m = meridian_m * np.radians(np.asarray(lat1_deg) - np.asarray(lat0_deg))
    east_m = prime_m * np.cos(middle) * np.radians(d_lon_deg)
    distance_m = np.hypot(north_m, east_m)
    return float(distance_m) if np.ndim(distance_m) == 0 else distance_m


def parse_lat_lon(text: str) -> tuple[float, float]:
    """The LAT,LON of `--home`.

    Raises:
        ConfigError: not two numbers, or not on the globe.
    """
    try:
        lat_deg, lon_deg = (float(part) for part in text.split(","))
    except ValueError:
        raise ConfigError(f"--home {text!r}: expected LAT,LON in degrees") from None
    if not (abs(lat_deg) <= 90.0 and abs(lon_deg) <= 180.0):
        raise ConfigError(f"--home {text!r}: not on the globe")
    return lat_deg, lon_deg


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


class Tile(NamedTuple):
    """A tile of a level: `x` counts from 180 degrees west, `y` from the northern edge."""

    zoom: int
    x: int
    y: int

    @property
    def row(self) -> int:
        """The tile's row as MBTiles counts it: from the southern edge (TMS)."""
        return int(2**self.zoom - 1 - self.y)

    @property
    def window(self) -> "Window":
        """The tile's pixels in global pixels of its level."""
        x0, y0 = self.x * TILE_PX, self.y * TILE_PX
        return Window(x0, y0, x0 + TILE_PX, y0 + TILE_PX)


class Window(NamedTuple):
    """A rectangle of global pixels of one level, corner convention, end exclusive."""

    x0: int
    y0: int
    x1: int
    y1: int

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width) in pixels, never negative."""
        return max(self.y1 - self.y0, 0), max(self.x1 - self.x0, 0)

    def grown(self, margin_px: int) -> "Window":
        """The window with a margin on each side."""
        return Window(
            self.x0 - margin_px, self.y0 - margin_px, self.x1 + margin_px, self.y1 + margin_px
        )

    def clipped(self, other: "Window") -> "Window":
        """What this window shares with another; of zero size when that is nothing."""
        x0, y0 = max(self.x0, other.x0), max(self.y0, other.y0)
        return Window(x0, y0, max(x0, min(self.x1, other.x1)), max(y0, min(self.y1, other.y1)))

    def parts(self, size_px: int) -> Iterator["Window"]:
        """The window cut into squares of at most that size."""
        for y0 in range(self.y0, self.y1, size_px):
            for x0 in range(self.x0, self.x1, size_px):
                yield Window(x0, y0, min(x0 + size_px, self.x1), min(y0 + size_px, self.y1))

    def tiles(self, zoom: int) -> list[Tile]:
        """The tiles that have a pixel in the window, row by row; the grid's own edges are kept."""
        if 0 in self.shape:
            return []
        last = 2**zoom - 1
        rows = range(max(self.y0 // TILE_PX, 0), min((self.y1 - 1) // TILE_PX, last) + 1)
        columns = range(max(self.x0 // TILE_PX, 0), min((self.x1 - 1) // TILE_PX, last) + 1)
        return [Tile(zoom, x, y) for y in rows for x in columns]


def places_along(stops: Array, step_m: float) -> Iterator[tuple[float, int, Array]]:
    """Places along a route, `step_m` apart at most, and at each stop.

    Farther apart on a route so long that none flies it, from a home at 0, 0 say: no more than
    `_MOST_PLACES` and the stops.

    Args:
        stops: (n, 2 or more) latitude and longitude in degrees, and what else changes along a leg.
        step_m: horizontal.

    Yields:
        The distance along the route, the leg from 1, and the place, as the stops are given.
    """
    step_m = max(step_m, _length_m(stops) / _MOST_PLACES)
    along_m = 0.0
    yield along_m, 1, stops[0]
    for leg, (start, end) in enumerate(pairwise(stops), start=1):
        leg_m = horizontal_distance_m(*map(float, start[:2]), *map(float, end[:2]))
        places = places_on_leg(start, end, step_m)[1:]
        for k, place in enumerate(places, start=1):
            yield along_m + k / len(places) * leg_m, leg, place
        along_m += leg_m


def _length_m(stops: Array) -> float:
    legs_m = horizontal_distance_m(stops[:-1, 0], stops[:-1, 1], stops[1:, 0], stops[1:, 1])
    return float(legs_m.sum())


def places_on_leg(start: Array, end: Array, step_m: float) -> Array:
    """(n, k) from one place to another, both of them too, `step_m` apart at most.

    Args:
        start: (k,) latitude and longitude in degrees, and what else changes along the leg.
        end: (k,).
        step_m: horizontal.
    """
    leg_m = horizontal_distance_m(*map(float, start[:2]), *map(float, end[:2]))
    steps = max(1, math.ceil(leg_m / step_m))
    fraction = np.arange(steps + 1)[:, None] / steps
    return np.asarray(start + fraction * (end - start))
