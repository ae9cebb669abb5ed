"""Figures of a campaign (needs matplotlib, the eval extra)."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from vwnav.bench.figures import pyplot, save
from vwnav.bench.flights.campaign import FlightScore
from vwnav.types import Array

_LEVELS = np.linspace(0.0, 1.0, 101)


def save_plots(folder: Path, flights: Sequence[FlightScore]) -> list[Path]:
    """`errors.png`, `honesty.png` and `flights.png`; their paths."""
    paths = [folder / name for name in ("errors.png", "honesty.png", "flights.png")]
    _errors(paths[0], flights)
    _honesty(paths[1], flights)
    _by_flight(paths[2], flights)
    return paths


def _by_manners(flights: Sequence[FlightScore]) -> dict[str, list[FlightScore]]:
    names = dict.fromkeys(each.manners for each in flights)
    return {name: [each for each in flights if each.manners == name] for name in names}


def _sorted(flights: Sequence[FlightScore], name: str) -> Array:
    """(n,) all values of a field of many, of all flights."""
    return np.sort(np.concatenate([np.asarray(getattr(each, name)) for each in flights]))


def _errors(path: Path, flights: Sequence[FlightScore]) -> None:
    """How many per cent of the time the error, and the distance from the route, are below."""
    figure, axis = pyplot().subplots(figsize=(8, 5))
    for manners, part in _by_manners(flights).items():
        for name, label in (("errors_m", "position error"), ("cross_m", "distance from the route")):
            values = _sorted(part, name)
            percent = 100.0 * np.arange(1, len(values) + 1) / max(len(values), 1)
            axis.plot(values, percent, label=f"{label}, {manners}")
    axis.axhline(95.0, color="0.7", lw=0.8)
    axis.set(xlabel="m", ylabel="% of the time below", xlim=(0.0, None), ylim=(0.0, 100.0))
    axis.legend()
    save(figure, path)


def _honesty(path: Path, flights: Sequence[FlightScore]) -> None:
    """Share of the errors inside each confidence ellipse: the diagonal is honest."""
    limits = -2.0 * np.log(np.maximum(1.0 - _LEVELS, 1e-12))  # chi-square of two degrees
    figure, axis = pyplot().subplots(figsize=(6, 6))
    for manners, part in _by_manners(flights).items():
        nees = _sorted(part, "nees")
        inside = np.searchsorted(nees, limits, side="right") / max(len(nees), 1)
        axis.plot(100.0 * _LEVELS, 100.0 * inside, label=f"flown, {manners}")
    axis.plot((0, 100), (0, 100), color="0.7", lw=0.8, label="honest")
    axis.set(xlabel="ellipse of so many %", ylabel="% of the errors inside")
    axis.legend()
    save(figure, path)


def _by_flight(path: Path, flights: Sequence[FlightScore]) -> None:
    """95 % and worst error of each flight; those with something wrong are red."""
    parts = _by_manners(flights)
    figure, axes = pyplot().subplots(
        len(parts), figsize=(9, 1.0 + 3.5 * len(parts)), sharex=True, squeeze=False
    )
    for axis, (manners, part) in zip(axes[:, 0], parts.items(), strict=True):
        numbers = [each.number for each in part]
        colours = ["tab:red" if each.wrong else "tab:blue" for each in part]
        axis.bar(numbers, [each.worst_m for each in part], color=colours, alpha=0.35, label="worst")
        p95 = [float(np.percentile(each.errors_m, 95.0)) if each.errors_m else 0.0 for each in part]
        axis.bar(numbers, p95, color=colours, label="95 %")
        axis.set(ylabel=f"error, m ({manners})")
        axis.legend()
    axes[-1, 0].set(xlabel="flight")
    save(figure, path)
