"""Many flights of one route: where, in which wind and with which luck each is flown."""

from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from vwnav import __version__
from vwnav.bench.flights.scenario import Scenario
from vwnav.bench.flights.setup import Setup
from vwnav.errors import RouteError
from vwnav.estimation.config import EkfConfig
from vwnav.sim.config import Manners
from vwnav.sim.map_warp import MapWarp
from vwnav.sim.named_sites import MAP_EAST_M, MAP_NORTH_M, MAP_SIGMA_M, SITE_PREFIX
from vwnav.sim.renderer import default_camera
from vwnav.sim.site import FIRST_TRAINING_SEED
from vwnav.types import Array

_MARGIN_M = 90.0  # of map around the route: what the camera sees, and the prior
_GROUND_S = 240.0  # getting ready, climb, descent and landing
_SLOWEST_M_S = 2.0  # along the route, on average
_LANDS_WITHIN_M = 3.0
_COMPASS_SIGMA_DEG = 5.0
_MOST_READOUT_S = 0.03

Place3 = tuple[float, float, float]


class Sortie(NamedTuple):
    """One flight of a campaign: those of one number differ in nothing but the autopilot."""

    manners: Manners
    number: int

    def __str__(self) -> str:
        return f"{self.manners} {self.number}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Campaign:
    """What the flights have in common; flight k of it is always the same.

    Attributes:
        route_ned_m: waypoints about home; the way back is added.
        sites: generated sites, each with two looks of its own, flown one after the other.
        wind_m_s: mean wind, with gusts; where it comes from is drawn for each flight.
        seed: of winds, gusts and sensors.
    """

    route_ned_m: tuple[Place3, ...]
    sites: int = 4
    wind_m_s: float = 8.0
    seed: int = 0
    version: str = __version__

    def __post_init__(self) -> None:
        if not 1 <= self.sites < FIRST_TRAINING_SEED:
            raise ValueError(f"expected 1 to {FIRST_TRAINING_SEED - 1} sites, got {self.sites}")

    def as_json(self) -> dict[str, Any]:
        """What a folder of flights is of."""
        return asdict(self) | {"route_ned_m": [list(point) for point in self.route_ned_m]}

    def site_of(self, number: int) -> str:
        """The site of a flight, numbered from 0, as commands name it."""
        return f"{SITE_PREFIX}{1 + number % self.sites}"

    def scenario(self, sortie: Sortie) -> Scenario:
        """A flight from the ground to the ground in which nothing breaks."""
        rng = np.random.default_rng([self.seed, sortie.number])
        setup = Setup(
            manners=sortie.manners,
            seed=int(rng.integers(1, 2**31)),
            route_ned_m=self.route_ned_m,
            wind_m_s=self.wind_m_s,
            wind_from_deg=float(rng.uniform(0.0, 360.0)),
            **off_as_told(rng),
        )
        return Scenario(
            name=f"flight {sortie}",
            setup=setup,
            breaks=(),
            limit_s=_GROUND_S + self.way_m / _SLOWEST_M_S,
            lands_within_m=_LANDS_WITHIN_M,
            lands_at_ne_m=(0.0, 0.0),
        )

    @property
    def way_ne_m(self) -> Array:
        """(n + 2, 2) from home over the waypoints and back."""
        return np.vstack([np.zeros(2), np.array(self.route_ned_m)[:, :2], np.zeros(2)])

    @property
    def way_m(self) -> float:
        """Horizontal length of that."""
        return float(np.hypot(*np.diff(self.way_ne_m, axis=0).T).sum())


def off_as_told(rng: np.random.Generator) -> dict[str, Any]:
    """How an aircraft is not as its files say: by what the filter is told that it may be.

    But for its compass, which errs by less than the filter is prepared for.
    """
    camera, ekf = default_camera(), EkfConfig()
    hangs_rad = camera.sigma_mount_rad, camera.sigma_mount_rad, ekf.mount_turn_sigma_rad
    return {
        "mount_off_deg": tuple(np.degrees(rng.normal(0.0, hangs_rad)).tolist()),
        "lens_ratio": float(rng.normal(1.0, camera.sigma_focal_ratio)),
        "compass_off_deg": float(rng.normal(0.0, _COMPASS_SIGMA_DEG)),
        "map_warp": MapWarp(sigma_m=MAP_SIGMA_M, seed=int(rng.integers(1, 2**31))),
        "readout_s": float(rng.uniform(0.0, _MOST_READOUT_S)),
        "late_s": float(rng.normal(0.0, camera.sigma_time_offset_s)),
    }


def campaign_of(route_ned_m: Array, **changes: Any) -> Campaign:
    """A campaign over a route (n, 3) about home.

    Raises:
        RouteError: the route leaves what maps of generated sites show.
    """
    north_m, east_m = MAP_NORTH_M / 2.0 - _MARGIN_M, MAP_EAST_M / 2.0 - _MARGIN_M
    for number, (north, east, _) in enumerate(route_ned_m.tolist(), 1):
        if abs(north) > north_m or abs(east) > east_m:
            raise RouteError(
                f"waypoint {number} is {north:.0f} m north and {east:.0f} m east of home: maps of "
                f"generated sites carry routes within {north_m:.0f} and {east_m:.0f} m of it"
            )
    points = tuple((float(n), float(e), float(d)) for n, e, d in route_ned_m)
    return Campaign(route_ned_m=points, **changes)


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightScore:
    """A flight, as one line of JSON.

    Attributes:
        wrong: what its judge found, broken rules by name and time; empty for a good flight.
        errors_m, nees: of the estimates sent in the air after the first fix, one a second:
            horizontal error, and that squared over its covariance and that of a shift of the whole
            map, which nobody can tell on it (2 is honest).
        worst_m: the largest error of all of them.
        cross_m: distance of the true place from the route's line while on route, one a second.
        touchdown_m: from home; None where it is not down.
        available: share of the time in the air after the first fix with an estimate of the last
            0.2 s that may be flown on (sigma at most what stops a route).
        fixes, attempts, wrong_fixes: images matched; those further than 20 m off.
        cpu_s: processor time that it took.
    """

    manners: Manners
    number: int
    site: str
    seed: int
    wind_m_s: float
    wind_from_deg: float
    flown_s: float
    way_m: float
    wrong: tuple[str, ...]
    errors_m: tuple[float, ...]
    nees: tuple[float, ...]
    worst_m: float
    cross_m: tuple[float, ...]
    touchdown_m: float | None
    available: float
    fixes: int
    attempts: int
    wrong_fixes: int
    cpu_s: float

    @property
    def sortie(self) -> Sortie:
        """Which flight of its campaign."""
        return Sortie(self.manners, self.number)
