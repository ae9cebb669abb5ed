"""Many flights in numbers, each with a confidence interval from resampling whole flights."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from vwnav.bench.flights.campaign import FlightScore
from vwnav.bench.resampling import interval
from vwnav.types import Array

_INSIDE_95 = 5.991  # chi-square of two degrees of freedom


@dataclass(frozen=True, slots=True)
class Figure:
    """A number of a campaign; `low` and `high` are its 95 % confidence interval.

    Flights differ, samples of one flight hardly do, so whole flights are drawn anew. None where
    that tells nothing: a worst value, or fewer than two flights.
    """

    name: str
    unit: str
    value: float
    low: float | None = None
    high: float | None = None


Statistic = Callable[[Sequence[FlightScore]], float]


def _pooled(name: str, of: Callable[[Array], float]) -> Statistic:
    """Of all samples of a field, of all flights together."""

    def value(flights: Sequence[FlightScore]) -> float:
        samples = np.concatenate([np.asarray(getattr(each, name)) for each in flights])
        return float(of(samples)) if len(samples) else float("nan")

    return value


def _each(of: Callable[[FlightScore], float | None], how: Callable[[Array], float]) -> Statistic:
    """Of one value a flight, where it has one."""

    def value(flights: Sequence[FlightScore]) -> float:
        values = [found for each in flights if (found := of(each)) is not None]
        return float(how(np.array(values))) if values else float("nan")

    return value


def _percentile(percent: float) -> Callable[[Array], float]:
    return lambda values: float(np.percentile(values, percent))


def _mean(values: Array) -> float:
    return float(np.mean(values))


_RESAMPLED: tuple[tuple[str, str, Statistic], ...] = (
    ("error, mean", "m", _pooled("errors_m", _mean)),
    ("error, 95 %", "m", _pooled("errors_m", _percentile(95.0))),
    ("cross-track, mean", "m", _pooled("cross_m", _mean)),
    ("cross-track, 95 %", "m", _pooled("cross_m", _percentile(95.0))),
    ("touch-down from home, mean", "m", _each(lambda each: each.touchdown_m, _mean)),
    ("available", "%", _each(lambda each: 100.0 * each.available, _mean)),
    (
        "fixes of attempts",
        "%",
        lambda all_: 100.0 * sum(e.fixes for e in all_) / max(sum(e.attempts for e in all_), 1),
    ),
    ("NEES (2)", "", _pooled("nees", _mean)),
    (
        "inside the 95 % ellipse",
        "%",
        _pooled("nees", lambda values: 100.0 * float(np.mean(values <= _INSIDE_95))),
    ),
    ("flights in good order", "%", _each(lambda each: 100.0 * (not each.wrong), _mean)),
)
_EXTREMES: tuple[tuple[str, str, Statistic], ...] = (
    ("error, worst", "m", _each(lambda each: each.worst_m, lambda v: float(np.max(v)))),
    (
        "touch-down from home, worst",
        "m",
        _each(lambda e: e.touchdown_m, lambda v: float(np.max(v))),
    ),
    ("fixes over 20 m wrong", "", lambda all_: float(sum(each.wrong_fixes for each in all_))),
    ("fixes", "", lambda all_: float(sum(each.fixes for each in all_))),
    ("way flown", "km", lambda all_: 1e-3 * sum(each.way_m for each in all_)),
    ("processor time of a flight", "s", _each(lambda each: each.cpu_s, _mean)),
)


def summarise(flights: Sequence[FlightScore]) -> list[Figure]:
    """All figures of at least one flight."""
    found = []
    for name, unit, of in _RESAMPLED:
        low, high = interval(of, flights) or (None, None)
        found.append(Figure(name, unit, of(flights), low, high))
    return found + [Figure(name, unit, of(flights)) for name, unit, of in _EXTREMES]


def worst_first(flights: Sequence[FlightScore]) -> list[FlightScore]:
    """Flights in which something was wrong, then by their largest error."""
    return sorted(flights, key=lambda each: (not each.wrong, -each.worst_m))
