"""What a flight is, as far as it is known before the link is opened."""

from dataclasses import dataclass

import numpy as np

from vwnav.config import Config
from vwnav.geometry.camera import Camera
from vwnav.geometry.geodesy import LocalFrame
from vwnav.maps.coverage import check_route
from vwnav.maps.pack import MapPack
from vwnav.mission.mission import Mission
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
        """Why a route (n, 3) must not be flown: the map does not cover it; "" when it does."""
        covered = check_route(self.pack, self._lat_lon_deg(route_ned_m))
        return "" if covered.ok else covered.summary()

    @property
    def route_lat_lon_deg(self) -> Array:
        """(n + 2, 2): from home over the waypoints and back, as far as it is known now."""
        home = np.zeros((1, 3))
        stops = [home, self.route_ned_m, home] if self.home_known else [self.route_ned_m]
        return self._lat_lon_deg(np.vstack(stops))

    def _lat_lon_deg(self, places_ned_m: Array) -> Array:
        lat_deg, lon_deg, _ = self.local_frame.to_geodetic(places_ned_m)
        return np.stack([lat_deg, lon_deg], axis=-1)
