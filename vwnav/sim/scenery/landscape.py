"""What stands where: the vectors of a landscape, before any look is drawn from them."""

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.types import Array

LookName = Literal["map", "flight"]
Land = Literal["arable", "meadow", "pasture", "forest", "yard", "garden", "pond"]
Surface = Literal["asphalt", "gravel", "dirt", "water"]
Species = Literal["conifer", "broadleaf", "bush"]
Roof = Literal["gable", "hip", "flat", "sheet"]


@dataclass(frozen=True, slots=True, eq=False)
class Cell:
    """A piece of land: polygon (n, 2) north, east; rows run along `row_rad` from north.

    Attributes:
        core: the part that is worked or mown, without the margin; may be empty.
        inner: the core without the headlands where machines turn; may be empty.
    """

    polygon: Array
    core: Array
    inner: Array
    land: Land
    row_rad: float
    seed: int


@dataclass(frozen=True, slots=True, eq=False)
class Strip:
    """A road, track or stream along points (n, 2)."""

    points: Array
    width_m: float
    surface: Surface
    seed: int


@dataclass(frozen=True, slots=True)
class Plant:
    """A tree or bush; `looks` says in which images it stands."""

    north_m: float
    east_m: float
    radius_m: float
    height_m: float
    species: Species
    seed: int
    looks: tuple[LookName, ...] = ("map", "flight")


@dataclass(frozen=True, slots=True)
class Building:
    """A roof on a rectangle: length along `azimuth_rad`."""

    north_m: float
    east_m: float
    length_m: float
    width_m: float
    azimuth_rad: float
    eaves_m: float
    ridge_m: float
    roof: Roof
    seed: int
    looks: tuple[LookName, ...] = ("map", "flight")

    @property
    def centre_ne(self) -> Array:
        """North, east (2,) of its middle."""
        return np.array([self.north_m, self.east_m])


@dataclass(frozen=True, slots=True)
class ParkedVehicle:
    """A car, lorry, light aircraft or bale: what moves between the looks."""

    north_m: float
    east_m: float
    azimuth_rad: float
    kind: Literal["car", "lorry", "aircraft", "bale"]
    seed: int
    looks: tuple[LookName, ...]

    @property
    def centre_ne(self) -> Array:
        """North, east (2,) of its middle."""
        return np.array([self.north_m, self.east_m])


@dataclass(frozen=True, slots=True, eq=False)
class Airfield:
    """A runway with what belongs to it, in a frame along (a) and right of (c) its direction.

    Attributes:
        north_m, east_m: centre of the runway.
        azimuth_rad: direction of increasing a.
        taxiways: polygons (n, 2) of asphalt; apron: polygon of concrete; strip: mown area.
    """

    north_m: float
    east_m: float
    azimuth_rad: float
    length_m: float
    width_m: float
    strip: Array
    apron: Array
    taxiway: Array
    seed: int

    def to_ne(self, along_across: Array) -> Array:
        """North, east (n, 2) of points (n, 2) along, across."""
        return to_ne(along_across, np.array([self.north_m, self.east_m]), self.azimuth_rad)


@dataclass(frozen=True, slots=True, eq=False)
class Landscape:
    """Everything that stands at a site, in local north, east metres about home."""

    seed: int
    airfield: Airfield
    cells: tuple[Cell, ...]
    strips: tuple[Strip, ...]
    plants: tuple[Plant, ...]
    buildings: tuple[Building, ...]
    vehicles: tuple[ParkedVehicle, ...]


def to_ne(along_across: Array, origin_ne: Array, azimuth_rad: float) -> Array:
    """North, east (n, 2) of points (n, 2) along an azimuth and to the right of it."""
    c, s = np.cos(azimuth_rad), np.sin(azimuth_rad)
    matrix = np.array([[c, s], [-s, c]])
    return np.asarray(along_across @ matrix + origin_ne, np.float64)


def spot(origin_ne: Array, azimuth_rad: float, along_m: float, across_m: float) -> Array:
    """North, east (2,) of the place so far along an azimuth and to the right of it."""
    return np.asarray(to_ne(np.array([[along_m, across_m]]), origin_ne, azimuth_rad)[0])


def rectangle(centre_ne: Array, length_m: float, width_m: float, azimuth_rad: float) -> Array:
    """Corners (4, 2) of a rectangle, length along the azimuth: left-back, then clockwise."""
    a, c = length_m / 2.0, width_m / 2.0
    corners = np.array([[-a, -c], [a, -c], [a, c], [-a, c]])
    return to_ne(corners, centre_ne, azimuth_rad)


def clip_half_plane(polygon: Array, point: Array, normal: Array) -> Array:
    """The part of a convex polygon (n, 2) on the side of `point` that `normal` points to.

    Sutherland and Hodgman, "Reentrant polygon clipping" (1974). Empty (0, 2) if nothing is left.
    """
    height = (polygon - point) @ normal
    kept: list[Array] = []
    for i, (p, q) in enumerate(zip(polygon, np.roll(polygon, -1, axis=0), strict=True)):
        hp, hq = height[i], height[(i + 1) % len(height)]
        if hp >= 0.0:
            kept.append(p)
        if hp * hq < 0.0:
            kept.append(p + (q - p) * (hp / (hp - hq)))
    return np.array(kept).reshape(-1, 2)


def inset(polygon: Array, margin_m: float) -> Array:
    """A convex polygon (n, 2) with every edge moved inwards; may become empty."""
    centre = polygon.mean(axis=0)
    result = polygon
    for p, q in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        edge = q - p
        length = float(np.hypot(*edge))
        if length < 1e-6 or len(result) == 0:
            continue
        normal = np.array([-edge[1], edge[0]]) / length
        normal *= np.sign((centre - p) @ normal) or 1.0
        result = clip_half_plane(result, p + normal * margin_m, normal)
    return result


def wander(points: Array, spacing_m: float, sway_m: float, rng: np.random.Generator) -> Array:
    """A line through points (n, 2), resampled and swaying sideways like a country road."""
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    t = np.linspace(0.0, length[-1], max(2, int(length[-1] / spacing_m)) + 1)
    line = np.stack([np.interp(t, length, points[:, k]) for k in range(2)], axis=1)
    phase = rng.uniform(0.0, 2.0 * np.pi, 3)
    waves = sum(
        np.sin(t * 2.0 * np.pi / period + phase[k]) / (k + 1)
        for k, period in enumerate((430.0, 190.0, 83.0))
    )
    fade = np.minimum(1.0, np.minimum(t, length[-1] - t) / 30.0)
    step = points[-1] - points[0]
    normal = np.array([-step[1], step[0]]) / max(float(np.hypot(*step)), 1e-9)
    return np.asarray(line + (sway_m * fade * waves)[:, None] * normal, np.float64)


def densified(polygon: Array, spacing_m: float) -> Array:
    """A closed polygon (n, 2) with points at least every `spacing_m` along its edges."""
    if len(polygon) < 3:
        return polygon
    parts = []
    for p, q in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        count = max(1, int(np.ceil(float(np.hypot(*(q - p))) / spacing_m)))
        parts.append(p + (q - p) * (np.arange(count) / count)[:, None])
    return np.concatenate(parts)


@dataclass(frozen=True, slots=True, eq=False)
class Bend:
    """A gentle warp of the plane that turns ruled field borders into grown ones."""

    phases: Array  # (3, 2)
    directions_rad: Array  # (3,)

    @staticmethod
    def random(rng: np.random.Generator) -> "Bend":
        """A warp of waves 330 to 900 m long that moves points by up to about 25 m."""
        return Bend(rng.uniform(0.0, 2.0 * np.pi, (3, 2)), rng.uniform(0.0, np.pi, 3))

    def __call__(self, points: Array) -> Array:
        """Where points (n, 2) are moved to."""
        moved = np.array(points, np.float64)
        for k, (length_m, sway_m) in enumerate(((900.0, 13.0), (520.0, 8.0), (330.0, 4.0))):
            c, s = np.cos(self.directions_rad[k]), np.sin(self.directions_rad[k])
            along = (points @ np.array([c, s])) * (2.0 * np.pi / length_m)
            moved[..., 0] += sway_m * np.sin(along + self.phases[k, 0])
            moved[..., 1] += sway_m * np.sin(along + self.phases[k, 1])
        return moved


class Ground:
    """Which square metres are taken, so that houses and trees do not stand on roads."""

    def __init__(self, half_north_m: float, half_east_m: float) -> None:
        self._half = (half_north_m, half_east_m)
        self._taken: NDArray[np.uint8] = np.zeros(
            (int(2 * half_north_m), int(2 * half_east_m)), np.uint8
        )

    def take(self, polygon: Array, margin_m: float = 0.0) -> None:
        """Mark a polygon (n, 2) and a margin about it as taken."""
        cv2.fillPoly(self._taken, [self._corners(polygon)], 1)
        if margin_m > 0.0:
            cv2.polylines(self._taken, [self._corners(polygon)], True, 1, max(1, int(2 * margin_m)))

    def take_line(self, points: Array, width_m: float) -> None:
        """Mark a line (n, 2) of a width as taken."""
        cv2.polylines(self._taken, [self._corners(points)], False, 1, max(1, round(width_m)))

    def free(self, points: Array) -> NDArray[np.bool_]:
        """Whether points (n, 2) are inside and not taken."""
        index = np.floor(points + np.array(self._half)).astype(int)
        limit = np.array(self._taken.shape)
        inside = ((index >= 0) & (index < limit)).all(axis=-1)
        clipped = np.clip(index, 0, limit - 1)
        return np.asarray(inside & (self._taken[clipped[..., 0], clipped[..., 1]] == 0), bool)

    def _corners(self, points: Array) -> NDArray[np.int32]:
        index: NDArray[np.int32] = np.round(points + np.array(self._half)).astype(np.int32)
        return index[:, ::-1]
