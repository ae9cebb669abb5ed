"""What a flight is, as far as it is known before the link is opened."""

import math
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np

from vwnav.config import Config
from vwnav.geometry.camera import Camera
from vwnav.geometry.geodesy import LocalFrame
from vwnav.guidance.plan_files import DEFAULT_HEIGHT_M, Route
from vwnav.maps.clearance import RouteClearance, check_clearance, clears_m
from vwnav.maps.coverage import RouteCoverage, begins_too_low, check_route
from vwnav.maps.pack import MapPack
from vwnav.mission.home import WayHome, from_home_ned_m
from vwnav.mission.mission import Mission
from vwnav.safety.safety_config import SafetyConfig
from vwnav.types import Array, FeatureExtractor

_RETURNS_EVERY_M = 20.0
_MOST_RETURNS = 300


@dataclass(frozen=True, slots=True, eq=False)
class FlightPlan:
    """All that is known before the link is opened.

    Attributes:
        local_frame: NED origin of the run: home, on the ground, where that is known; else a
            frame about the middle of the map, and nothing but a frame.
        route_ned_m: (n, 3) waypoints.
        home_known: False when the take-off may be anywhere on the map.
        home_sigma_m: how well home is known then, per axis.
        about_home: the waypoints are counted from home.
        features: extractor, and what stands in for it; the pack fits the first.
    """

    config: Config
    pack: MapPack
    camera: Camera
    local_frame: LocalFrame
    route_ned_m: Array
    home_known: bool
    home_sigma_m: float
    about_home: bool
    features: tuple[FeatureExtractor, FeatureExtractor | None]

    @property
    def mission(self) -> Mission:
        """What the flight is asked to do."""
        return Mission(
            self.route_ned_m,
            about_home=self.about_home and not self.home_known,
            home_ne_m=np.zeros(2) if self.home_known else None,
            home_sigma_m=self.home_sigma_m,
            way_home=self.way_home,
            refuse=self.refuse,
        )

    @property
    def way_home(self) -> WayHome:
        """How high a return is flown over the map's ground."""
        return way_home_over(self.pack, self.local_frame, self.config.safety)

    @property
    def returns(self) -> str:
        """What returns from the route ask for, where home is known; "" where nothing beyond."""
        if not self.home_known:
            return ""
        return summary_of_returns(self.way_home, self._flown_ned_m)

    @property
    def _flown_ned_m(self) -> Array:
        return from_home_ned_m(self.route_ned_m, np.zeros(2), self.way_home)

    def refuse(self, route_ned_m: Array) -> str:
        """Why a route must not be flown, "" when it may.

        The map does not cover it, or has higher ground there.

        Args:
            route_ned_m: (n, 3) the waypoints and the way to above home, the last one.
        """
        return self._refuse(np.vstack([[*route_ned_m[-1, :2], route_ned_m[0, 2]], route_ned_m]))

    def refuse_at_once(self) -> str:
        """The same before the flight, as far as it can be told then, or a start without fixes."""
        # The map first: of a home that is elsewhere by mistake heights tell nothing.
        return self._refuse_by_map() or begins_too_low(
            self.pack, self.camera, -float(self.route_ned_m[0, 2])
        )

    def _refuse_by_map(self) -> str:
        if self.home_known:
            return self._refuse(self._flown_ned_m)
        if self.about_home:
            return ""
        covered = check_route(self.pack, self.route_lat_lon_deg)
        return "" if covered.ok else covered.summary()

    def _refuse(self, flown_ned_m: Array) -> str:
        covered = check_route(self.pack, _lat_lon_deg(self.local_frame, flown_ned_m))
        if not covered.ok:
            return covered.summary()
        waypoints = len(self.route_ned_m)
        clearance = check_clearance(self.pack, self.local_frame, flown_ned_m, waypoints)
        return "" if clearance.ok else clearance.summary()

    @property
    def route_lat_lon_deg(self) -> Array:
        """(n + 2, 2): from home over the waypoints and back, as far as it is known now."""
        home = np.zeros((1, 3))
        stops = [home, self.route_ned_m, home] if self.home_known else [self.route_ned_m]
        return _lat_lon_deg(self.local_frame, np.vstack(stops))


def _lat_lon_deg(frame: LocalFrame, places_ned_m: Array) -> Array:
    lat_deg, lon_deg, _ = frame.to_geodetic(places_ned_m)
    return np.stack([lat_deg, lon_deg], axis=-1)


@dataclass(frozen=True, slots=True)
class RouteOnMap:
    """What a map says of a route, flown from home and back as by default.

    Attributes:
        coverage: by imagery.
        clearance: above the ground.
        returns: what returns from it ask for, "" where nothing beyond the least height.
        begins_m: height of the first waypoint above home.
    """

    coverage: RouteCoverage
    clearance: RouteClearance
    returns: str
    begins_m: float


def route_on_map(
    pack: MapPack,
    route: Route,
    home: tuple[float, float] | None,
    safety: SafetyConfig,
    margin_m: float = 50.0,
) -> RouteOnMap:
    """Hold a route against a map.

    Args:
        pack: the map.
        route: as its file says.
        home: (lat_deg, lon_deg) of the take-off, None where nobody knows.
        safety: how returns are flown.
        margin_m: imagery is asked for so far around.

    Raises:
        RouteError: it counts from a home, or from sea level at a home, that nobody knows.
    """
    if home is None:
        coverage = check_route(pack, route.lat_lon_deg(), margin_m)
        route_ned_m = route.to_ned(LocalFrame(*pack.middle, 0.0), DEFAULT_HEIGHT_M, None)
        return RouteOnMap(coverage, RouteClearance(), "", -float(route_ned_m[0, 2]))
    frame = LocalFrame(*home, 0.0)
    ground_m = route.ground_amsl_m(home, pack.elevation_m(*home))
    route_ned_m = route.to_ned(frame, DEFAULT_HEIGHT_M, ground_m)
    way_home = way_home_over(pack, frame, safety)
    flown_ned_m = from_home_ned_m(route_ned_m, np.zeros(2), way_home)
    coverage = check_route(pack, _lat_lon_deg(frame, flown_ned_m), margin_m)
    clearance = check_clearance(pack, frame, flown_ned_m, len(route_ned_m))
    returns = summary_of_returns(way_home, flown_ned_m)
    return RouteOnMap(coverage, clearance, returns, -float(route_ned_m[0, 2]))


def way_home_over(pack: MapPack, frame: LocalFrame, safety: SafetyConfig) -> WayHome:
    """How high the straight way home is flown over a map's ground."""
    return WayHome.within(safety, partial(clears_m, pack, frame))


def summary_of_returns(way_home: WayHome, flown_ned_m: Array) -> str:
    """One line on the straight ways home from a route (n, 3), from above home and back there.

    "" where none is flown higher than the least height, or than the aircraft is anyhow.
    """
    home_ne_m = flown_ned_m[0, :2]
    risen_m, flown_back = way_home.lowest_m, 0
    places = _every(flown_ned_m)
    for place in places:
        straight_ned_m = way_home.straight_ned_m(place, home_ne_m)
        if straight_ned_m is None:
            flown_back += 1
        elif len(straight_ned_m) > 1:
            risen_m = max(risen_m, -float(straight_ned_m[-1, 2]))
    told = []
    if risen_m > way_home.lowest_m:
        told.append(f"a return climbs to {risen_m:.0f} m above home, to clear the ground")
    if flown_back:
        told.append(
            f"from {math.ceil(100.0 * flown_back / len(places))} % of the route the ground on the "
            f"straight way home is above the ceiling of {way_home.ceiling_m:g} m: a return from "
            "there goes back along the flown way"
        )
    return "; ".join(told)


def _every(flown_ned_m: Array) -> Array:
    """(m, 3) places along a route (n, 3), some 20 m apart, farther on a long one."""
    lengths_m = np.hypot(*np.diff(flown_ned_m[:, :2], axis=0).T)
    step_m = max(_RETURNS_EVERY_M, float(lengths_m.sum()) / _MOST_RETURNS)
    legs = [
        np.linspace(start, end, math.ceil(length_m / step_m) + 1)
        for (start, end), length_m in zip(pairwise(flown_ned_m), lengths_m, strict=True)
    ]
    return np.vstack(legs)
