"""Faults of the map, as the camera sees them: the ground below is not what the map shows."""

from dataclasses import dataclass, replace

import numpy as np

from vwnav.bench.flights.stage import FlightStage, Lasting
from vwnav.sim.named_sites import UNRELATED_HOME_NE_M, parse_site, tiles_folder
from vwnav.sim.scenery.looks import Season
from vwnav.sim.site import Site

_LOW_SUN_RAD = 0.3


@dataclass(frozen=True)
class MapShifted:
    """The map lies so far from where it belongs: north and east."""

    ne_m: tuple[float, float]

    def begin(self, world: FlightStage) -> None:
        """What is seen lies as far off the other way."""
        world.camera.home_ned_m = world.camera.home_ned_m - np.array([*self.ne_m, 0.0])

    def end(self, world: FlightStage) -> None:
        """Where it belongs."""
        world.camera.home_ned_m = world.camera.home_ned_m + np.array([*self.ne_m, 0.0])


@dataclass(frozen=True)
class MapOfElsewhere(Lasting):
    """The ground below is another landscape than the map's."""

    def begin(self, world: FlightStage) -> None:
        """Among the fields of another site."""
        site = parse_site("sim:unrelated")
        world.show(site, tiles_folder(site))
        away = np.array([*UNRELATED_HOME_NE_M, 0.0])
        world.camera.home_ned_m = world.camera.home_ned_m - away


@dataclass(frozen=True)
class OtherSeason(Lasting):
    """The ground below is seen in another season, with other crops and a low morning sun."""

    season: Season

    def begin(self, world: FlightStage) -> None:
        """Drawn anew: kept in memory, as the files of drawn tiles are of the site as it is."""
        site = Site(world.site_seed)
        look = site.looks["flight"]
        site.looks["flight"] = replace(
            look,
            seed=look.seed + 1,
            season=self.season,
            sun_azimuth_rad=look.sun_azimuth_rad - 0.5 * np.pi,
            sun_elevation_rad=_LOW_SUN_RAD,
        )
        world.show(site)
