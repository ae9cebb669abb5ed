"""Where a map covers a route, with margin."""

import math
from dataclasses import dataclass

import numpy as np

from vwnav.geometry.camera import Camera
from vwnav.geometry.geodesy import places_along
from vwnav.maps.image import MIN_VIEW_PX
from vwnav.maps.pack import MapPack
from vwnav.types import Array

STEP_M = 10.0
_DIRECTIONS = 8
_M_PER_DEG = 111_320.0  # of latitude, to a per cent: only places the margin's ring


@dataclass(frozen=True, slots=True)
class Stretch:
    """A stretch of a route that the map does not cover.

    Attributes:
        start_m, end_m: distances along the route.
        start_lat_lon_deg, end_lat_lon_deg: where that is.
    """

    start_m: float
    end_m: float
    start_lat_lon_deg: tuple[float, float]
    end_lat_lon_deg: tuple[float, float]


@dataclass(frozen=True, slots=True)
class RouteCoverage:
    """Whether a map covers a route.

    Attributes:
        length_m: of the route.
        margin_m: how far around the route imagery was asked for.
        uncovered: stretches that lack it, in the order of flight.
    """

    length_m: float
    margin_m: float
    uncovered: tuple[Stretch, ...]

    @property
    def ok(self) -> bool:
        """Whether all of it is covered."""
        return not self.uncovered

    @property
    def uncovered_m(self) -> float:
        """Length of what is not covered; a single point counts nothing."""
        return sum(stretch.end_m - stretch.start_m for stretch in self.uncovered)

    def summary(self) -> str:
        """One line for a person."""
        if self.ok:
            return f"the map covers all {self.length_m:.0f} m of the route"
        first = self.uncovered[0]
        lat_deg, lon_deg = first.start_lat_lon_deg
        return (
            f"the map does not cover the route with {self.margin_m:.0f} m to spare: "
            f"first from {first.start_m:.0f} to {first.end_m:.0f} m of {self.length_m:.0f} m "
            f"({lat_deg:.6f}, {lon_deg:.6f}), {self.uncovered_m:.0f} m in all"
        )


def begins_too_low(pack: MapPack, camera: Camera, height_m: float) -> str:
    """Why no route begins at a height above ground: a level camera sees too little of the map.

    "" from the height on at which it can be placed there.
    """
    seen = max(camera.width_px / camera.K[0, 0], camera.height_px / camera.K[1, 1])
    m_per_px = pack.levels[0].m_per_px
    least_m = MIN_VIEW_PX * m_per_px / float(seen)
    if height_m >= least_m:
        return ""
    return (
        f"the first waypoint is {height_m:.0f} m up: below {least_m:.0f} m this camera sees too "
        f"little of a map of {m_per_px:.2f} m/px to be placed on it; plan it higher, or build the "
        "map from finer imagery"
    )


def check_route(pack: MapPack, lat_lon_deg: Array, margin_m: float = 50.0) -> RouteCoverage:
    """Check that imagery lies under a route and around it.

    Args:
        pack: the map.
        lat_lon_deg: (n, 2) places flown through, degrees, in order, n >= 1.
        margin_m: imagery is asked for on a ring of this radius as well.

    Raises:
        ValueError: no places, or one that is not finite.
    """
    if lat_lon_deg.ndim != 2 or lat_lon_deg.shape[1] != 2 or not len(lat_lon_deg):
        raise ValueError(f"expected places (n, 2), got {lat_lon_deg.shape}")
    if not np.isfinite(lat_lon_deg).all():
        raise ValueError("expected finite places")
    uncovered: list[Stretch] = []
    open_stretch: Stretch | None = None
    along_m = 0.0
    for along_m, _, place in places_along(lat_lon_deg, STEP_M):
        here = (float(place[0]), float(place[1]))
        if _covered(pack, *here, margin_m):
            uncovered += [open_stretch] if open_stretch else []
            open_stretch = None
        elif open_stretch is None:
            open_stretch = Stretch(along_m, along_m, here, here)
        else:
            start = open_stretch
            open_stretch = Stretch(start.start_m, along_m, start.start_lat_lon_deg, here)
    uncovered += [open_stretch] if open_stretch else []
    return RouteCoverage(along_m, margin_m, tuple(uncovered))


def _covered(pack: MapPack, lat_deg: float, lon_deg: float, margin_m: float) -> bool:
    if not pack.covers(lat_deg, lon_deg):
        return False
    north_deg = margin_m / _M_PER_DEG
    east_deg = north_deg / max(math.cos(math.radians(lat_deg)), 0.05)
    angles = np.arange(_DIRECTIONS) * (2.0 * math.pi / _DIRECTIONS)
    return all(
        pack.covers(lat_deg + north_deg * math.cos(angle), lon_deg + east_deg * math.sin(angle))
        for angle in angles
    )
