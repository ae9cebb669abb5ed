"""How high a route is above the ground, where a map has heights."""

import math
from dataclasses import dataclass

import numpy as np

from vwnav.geometry.geodesy import LocalFrame, places_along, places_on_leg
from vwnav.maps.pack import MapPack
from vwnav.types import Array

# Heights of terrain are wrong by 2 to 4 m and know neither trees nor houses, a barometer drifts by
# 3 m in ten minutes, and a height is held to 2 m.
LEAST_CLEARANCE_M = 5.0
STEP_M = 5.0
_AS_LOW_M = 0.05
_ROUNDED_M = 0.01  # what clears the ground so passes the check of the route, too


@dataclass(frozen=True, slots=True)
class RouteClearance:
    """Where a route is lowest above the ground.

    Attributes:
        lowest_m: above the ground there, negative below it; None where that cannot be told.
        leg: the waypoint, from 1, that is flown to there; 0 on the way home.
        lat_lon_deg: where that is.
        known_share: of the route, where the map has heights.
    """

    lowest_m: float | None = None
    leg: int = 0
    lat_lon_deg: tuple[float, float] = (0.0, 0.0)
    known_share: float = 0.0

    @property
    def ok(self) -> bool:
        """Whether nothing that is known speaks against it."""
        return self.lowest_m is None or self.lowest_m >= LEAST_CLEARANCE_M

    def summary(self) -> str:
        """One line for a person."""
        if self.lowest_m is None:
            return (
                "how high the route is above the ground is not known: that takes a home, and a map "
                "with its heights (vwnav map build --heights)"
            )
        side = f"{abs(self.lowest_m):.1f} m {'above' if self.lowest_m >= 0.0 else 'below'}"
        leg = f"the leg to waypoint {self.leg}" if self.leg else "the way home"
        lat_deg, lon_deg = self.lat_lon_deg
        where = f"on {leg} at {lat_deg:.6f}, {lon_deg:.6f}, {side} the ground"
        if self.ok:
            part = "" if self.known_share > 0.995 else f" ({self.known_share:.0%} of it is known)"
            return f"the route is lowest {where}{part}"
        missing_m = LEAST_CLEARANCE_M - self.lowest_m
        return (
            f"the route is too low {where}: {missing_m:.1f} m are missing to the "
            f"{LEAST_CLEARANCE_M:g} m that are asked for"
        )


def check_clearance(
    pack: MapPack, frame: LocalFrame, flown_ned_m: Array, waypoints: int
) -> RouteClearance:
    """Hold a route against the map's heights, every `STEP_M` along its legs.

    Take-off and landing are no part of it: they go straight up and down.

    Args:
        pack: the map.
        frame: of the route.
        flown_ned_m: (n, 3) from above home over the waypoints and back; heights count from the
            ground at home.
        waypoints: how many of them are waypoints.
    """
    lat_deg, lon_deg, _ = frame.to_geodetic(flown_ned_m)
    stops = np.stack([lat_deg, lon_deg, -flown_ned_m[:, 2]], axis=-1)
    home_m = pack.elevation_m(*_lat_lon(stops[0]))
    if home_m is None:
        return RouteClearance()
    passed = [(leg, place) for _, leg, place in places_along(stops, STEP_M)]
    places = np.array([place for _, place in passed])
    above_m = home_m + places[:, 2] - pack.elevations_m(places[:, 0], places[:, 1])
    # At home it is known, so that there is one.
    known = [
        (float(height_m), leg, _lat_lon(place))
        for height_m, (leg, place) in zip(above_m, passed, strict=True)
        if np.isfinite(height_m)
    ]
    lowest_m = min(height_m for height_m, _, _ in known)
    # The first of those that are as low: what is flown over twice is named on the way out.
    _, leg, here = next(each for each in known if each[0] < lowest_m + _AS_LOW_M)
    return RouteClearance(lowest_m, leg if leg <= waypoints else 0, here, len(known) / len(passed))


def clears_m(pack: MapPack, frame: LocalFrame, here_ne_m: Array, home_ne_m: Array) -> float:
    """Height above the ground at home from which on a straight way there clears what it passes.

    Args:
        pack: the map.
        frame: of the places.
        here_ne_m: (2,) where it begins.
        home_ne_m: (2,).

    Returns:
        -inf where the map has no height of home.
    """
    ends_ned_m = np.array([[*here_ne_m, 0.0], [*home_ne_m, 0.0]])
    lat_deg, lon_deg, _ = frame.to_geodetic(ends_ned_m)
    home_m = pack.elevation_m(float(lat_deg[1]), float(lon_deg[1]))
    if home_m is None:
        return -math.inf
    here, home = np.stack([lat_deg, lon_deg], axis=-1)
    places = places_on_leg(here, home, STEP_M)
    highest_m = float(np.nanmax(pack.elevations_m(places[:, 0], places[:, 1])))
    return highest_m - home_m + LEAST_CLEARANCE_M + _ROUNDED_M


def _lat_lon(place: Array) -> tuple[float, float]:
    return float(place[0]), float(place[1])
