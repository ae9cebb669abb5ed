"""Table 6.3 of the thesis: how far off places are, 25 and 50 m up, on a map of another season.

The thesis held three waypoints against their truth, without its filter. Here each map fix of short
lockstep flights is one, and beside it what the filter believed at that image's exposure.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from vwnav.bench.flights.log import flight_log
from vwnav.bench.flights.scenario import Ending, Flown, Scenario
from vwnav.bench.flights.setup import AirStart, Setup
from vwnav.bench.resampling import interval
from vwnav.mission.mission import Phase
from vwnav.types import FeatureName, MapFix, Rejected, RejectReason

HEIGHTS_M = (25.0, 50.0)
THESIS_M = {25.0: (6.71, 2.53, 3.65), 50.0: (3.34, 2.56, 2.51)}  # table 6.3, without filter
_HALF_NORTH_M, _HALF_EAST_M = 380.0, 560.0
_WAYPOINTS = 8
_USABLE_SIGMA_M = 8.0  # what stops a flight, as `SafetyConfig` has it


@dataclass(frozen=True, slots=True)
class Seen:
    """What a flight was told and believed of its places.

    Attributes:
        raw_m: errors of its fixes. filtered_m: of the filter's estimates at the same exposures.
        attempts: images that were matched. looks, usable: images, and those at whose exposure
            there was an estimate good enough to fly on.
        correlated: fixes that were placed by correlation, not by keypoints.
    """

    raw_m: tuple[float, ...]
    filtered_m: tuple[float, ...]
    attempts: int
    looks: int
    usable: int
    correlated: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Errors:
    """Horizontal errors in metres; the intervals are 95 %, None below two flights.

    Attributes:
        available: share of the attempts that gave a place, or of the images with an estimate.
    """

    count: int
    mean_m: float
    mean_interval_m: tuple[float, float] | None
    median_m: float
    p95_m: float
    p95_interval_m: tuple[float, float] | None
    worst_m: float
    available: float


@dataclass(frozen=True, slots=True, kw_only=True)
class WaypointsRow:
    """One feature set at one height.

    Attributes:
        correlated: fixes that were placed by correlation, where keypoints did not tell the place.
    """

    features: FeatureName
    height_m: float
    flights: int
    correlated: int
    raw: Errors
    filtered: Errors


def plan(number: int, height_m: float, seconds: float, wind_m_s: float, seed: int) -> Scenario:
    """A flight in the air between random places of the map; the same for every feature set."""
    rng = np.random.default_rng([seed, number, round(height_m)])
    north = rng.uniform(-_HALF_NORTH_M, _HALF_NORTH_M, _WAYPOINTS + 1).tolist()
    east = rng.uniform(-_HALF_EAST_M, _HALF_EAST_M, _WAYPOINTS + 1).tolist()
    points = [(n, e, -height_m) for n, e in zip(north, east, strict=True)]
    setup = Setup(
        seed=int(rng.integers(1, 2**31)),
        start=AirStart(phase=Phase.ROUTE, place_ned_m=points[0]),
        route_ned_m=tuple(points[1:]),
        wind_m_s=wind_m_s,
        wind_from_deg=float(rng.uniform(0.0, 360.0)),
    )
    return Scenario(
        name=f"waypoints {number}", setup=setup, breaks=(), limit_s=seconds, ending=Ending.FLIES_ON
    )


def measure(
    fly: Callable[[Scenario], Flown],
    features: FeatureName,
    scenarios: Sequence[Scenario],
    height_m: float,
    progress: Callable[[int, int], None],
) -> WaypointsRow:
    """Fly them, where `features` are matched by; `progress(done, of all)`."""
    seen = []
    for scenario in scenarios:
        seen.append(look_at(fly(scenario)))
        progress(len(seen), len(scenarios))
    return row_of(features, height_m, seen)


def row_of(features: FeatureName, height_m: float, seen: Sequence[Seen]) -> WaypointsRow:
    """The flights of a row together, at least one."""
    return WaypointsRow(
        features=features,
        height_m=height_m,
        flights=len(seen),
        correlated=sum(each.correlated for each in seen),
        raw=_errors(seen, lambda each: each.raw_m, lambda each: (len(each.raw_m), each.attempts)),
        filtered=_errors(
            seen, lambda each: each.filtered_m, lambda each: (each.usable, each.looks)
        ),
    )


def look_at(flown: Flown) -> Seen:
    """Hold fixes and estimates of a flight against its truth."""
    log, steps = flight_log(flown), flown.steps
    steps = [step for step in steps if step.t_s >= flown.begun_s]
    believed = {step.t_s: step.estimate for step in steps if step.estimate is not None}
    raw, filtered = [], []
    for fix in log.fixes:
        truth, estimate = log.true_place_ne_m(fix.t_s), believed.get(fix.t_s)
        if truth is not None and estimate is not None:
            north, east, _ = estimate.position_ned_m.tolist()
            raw.append(math.dist(fix.ne, truth))
            filtered.append(math.dist((north, east), truth))
    usable = sum(each.sigma_horizontal_m <= _USABLE_SIGMA_M for each in believed.values())
    attempts = sum(_is_attempt(step.outcome) for step in steps)
    correlated = sum(
        isinstance(step.outcome, MapFix) and step.outcome.placed_by == "correlation"
        for step in steps
    )
    return Seen(tuple(raw), tuple(filtered), attempts, len(steps), usable, correlated)


def _is_attempt(outcome: MapFix | Rejected) -> bool:
    idle = (RejectReason.NOT_TRIED, RejectReason.TOO_LOW)
    return isinstance(outcome, MapFix) or outcome.reason not in idle


def _errors(
    seen: Sequence[Seen],
    errors: Callable[[Seen], tuple[float, ...]],
    share: Callable[[Seen], tuple[int, int]],
) -> Errors:
    def pooled(of: Callable[[list[float]], float]) -> Callable[[Sequence[Seen]], float]:
        def value(flights: Sequence[Seen]) -> float:
            values = [error for each in flights for error in errors(each)]
            return of(values) if values else math.nan

        return value

    mean = pooled(lambda values: float(np.mean(values)))
    p95 = pooled(lambda values: float(np.percentile(values, 95.0)))
    good, asked = (sum(column) for column in zip(*map(share, seen), strict=True))
    return Errors(
        count=sum(len(errors(each)) for each in seen),
        mean_m=mean(seen),
        mean_interval_m=interval(mean, seen),
        median_m=pooled(lambda values: float(np.median(values)))(seen),
        p95_m=p95(seen),
        p95_interval_m=interval(p95, seen),
        worst_m=pooled(max)(seen),
        available=good / max(asked, 1),
    )
