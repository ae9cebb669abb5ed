"""What a flight is, as far as it is known before the link is opened."""

from dataclasses import dataclass

import numpy as np

from vwnav.config import Config
from vwnav.geometry.camera import Camera
from vwnav.geometry.geodesy import LocalFrame
from vwnav.guidance.plan_files import DEFAULT_HEIGHT_M, Route
from vwnav.maps.clearance import RouteClearance, check_clearance
from vwnav.maps.coverage import check_route
from vwnav.maps.pack import MapPack
from vwnav.mission.home import from_home_ned_m
from vwnav.mission.mission import Mission
from vwnav.safety.safety_config import SafetyConfig
from vwnav.types import Array


@dataclass(frozen=True, slots=True, eq=False)
class FlightPlan:
    """All that is known before the link is opened.

    Attributes:
        local_frame: NED origin of the run: home, on the ground, where that is known; else a
            frame about the middle of the map, and nothing but a frame.
        route_ned_m: (n, 3) waypoints.
        home_known: False when the take-off may be anywhere on the map.
        about_home: the waypoints are counted from home.
    """

    config: Config
    pack: MapPack
    camera: Camera
    local_frame: LocalFrame
    route_ned_m: Array
    home_known: bool
    about_home: bool

    @property
    def mission(self) -> Mission:
        """What the flight is asked to do."""
        return Mission(
            self.route_ned_m,
            about_home=self.about_home and not self.home_known,
            home_ne_m=np.zeros(2) if self.home_known else None,
            way_home_m=self.config.safety.way_home_m,
            refuse=self.refuse,
        )

    def refuse(self, route_ned_m: Array) -> str:
        """Why a route must not be flown, "" when it may.

        The map does not cover it, or has higher ground there.

        Args:
            route_ned_m: (n, 3) the waypoints and the way to above home, the last one.
        """
        return self._refuse(np.vstack([[*route_ned_m[-1, :2], route_ned_m[0, 2]], route_ned_m]))

    def refuse_at_once(self) -> str:
        """The same before the flight, as far as it can be told then."""
        if self.home_known:
            lowest_m = self.config.safety.way_home_m
            return self._refuse(from_home_ned_m(self.route_ned_m, np.zeros(2), lowest_m))
        if self.about_home:
            return ""
        covered = check_route(self.pack, self.route_lat_lon_deg)
        return "" if covered.ok else covered.summary()

    def _refuse(self, flown_ned_m: Array) -> str:
        covered = check_route(self.pack, self._lat_lon_deg(flown_ned_m))
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
        return self._lat_lon_deg(np.vstack(stops))

    def _lat_lon_deg(self, places_ned_m: Array) -> Array:
        lat_deg, lon_deg, _ = self.local_frame.to_geodetic(places_ned_m)
        return np.stack([lat_deg, lon_deg], axis=-1)


def route_clearance(
    pack: MapPack, route: Route, home: tuple[float, float] | None
) -> RouteClearance:
    """Where a route, flown from home and back as by default, is lowest above the ground.

    Args:
        pack: the map.
        route: as its file says.
        home: (lat_deg, lon_deg) of the take-off, None where nobody knows.

    Raises:
        RouteError: its altitudes are above sea level, and nobody knows the ground at home.
    """
    if home is None:
        route.to_ned(LocalFrame(*pack.middle, 0.0), DEFAULT_HEIGHT_M, None)
        return RouteClearance()
    frame = LocalFrame(*home, 0.0)
    ground_m = route.ground_amsl_m(home, pack.elevation_m(*home))
    route_ned_m = route.to_ned(frame, DEFAULT_HEIGHT_M, ground_m)
    flown_ned_m = from_home_ned_m(route_ned_m, np.zeros(2), SafetyConfig().way_home_m)
    return check_clearance(pack, frame, flown_ned_m, len(route_ned_m))
