"""Fixes that are not where the aircraft is: of ground that looks alike, or another piece of map."""

import math
from dataclasses import dataclass, replace

import numpy as np

from vwnav.bench.flights.stage import FlightStage, Lasting
from vwnav.geometry.geodesy import LocalFrame
from vwnav.geometry.rotations import wrap_pi
from vwnav.types import MapFix, Rejected, RejectReason


@dataclass(frozen=True)
class OneFixWrong(Lasting):
    """The next fix is of ground that looks alike: turned, aside, and as sure of itself as ever."""

    turned_deg: float = 0.0
    ne_m: tuple[float, float] = (0.0, 0.0)

    def begin(self, world: FlightStage) -> None:
        """The next one, that is."""
        executor = world.navigator.executor

        def mistaken(found: MapFix | Rejected) -> MapFix | Rejected:
            if isinstance(found, Rejected) or found.yaw_rad is None:
                return found
            executor.mistake = None
            yaw_rad = wrap_pi(found.yaw_rad + math.radians(self.turned_deg))
            return replace(_moved(found, self.ne_m), yaw_rad=yaw_rad)

        executor.mistake = mistaken


@dataclass(frozen=True)
class MapSteps(Lasting):
    """Another piece of the map begins, which was laid so far beside the one before."""

    ne_m: tuple[float, float]

    def begin(self, world: FlightStage) -> None:
        """All that is found from now on lies on it."""
        world.navigator.executor.mistake = lambda found: (
            found if isinstance(found, Rejected) else _moved(found, self.ne_m)
        )


@dataclass(frozen=True)
class NoFixes:
    """The map shows nothing of what images do, which are followed all the same: snow, a flood."""

    def begin(self, world: FlightStage) -> None:
        """Nothing is found."""
        world.navigator.executor.mistake = lambda found: Rejected(
            found.t_s, RejectReason.FEW_INLIERS, "snow"
        )

    def end(self, world: FlightStage) -> None:
        """It thaws."""
        world.navigator.executor.mistake = None


def _moved(fix: MapFix, ne_m: tuple[float, float]) -> MapFix:
    ned_m = np.array([*ne_m, 0.0])
    lat_deg, lon_deg, _ = LocalFrame(fix.lat_deg, fix.lon_deg, 0.0).to_geodetic(ned_m)
    return replace(fix, lat_deg=float(lat_deg), lon_deg=float(lon_deg))
