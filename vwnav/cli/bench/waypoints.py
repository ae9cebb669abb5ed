"""`vwnav bench waypoints`: the thesis' table 6.3 for every feature set."""

import json
import math
import sys
from collections.abc import Mapping
from dataclasses import asdict
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from vwnav.cli.numbers import all_finite, finite

if TYPE_CHECKING:
    from vwnav.bench.flights.waypoints import Errors, WaypointsRow
    from vwnav.bench.flights.world import Place
    from vwnav.types import FeatureName

_WIDTH = 146  # of a file, which has none of its own


def waypoints(
    site: Annotated[str, typer.Option(help="sim:default or sim:SEED.")] = "sim:default",
    features: Annotated[
        list[str] | None, typer.Option(help="learned, sift or orb; may be repeated; else all.")
    ] = None,
    height_m: Annotated[
        list[float] | None,
        typer.Option(
            min=10.0, max=120.0, callback=all_finite, help="May be repeated; else 25, 50."
        ),
    ] = None,
    runs: Annotated[int, typer.Option("--runs", min=1, help="Flights of each row.")] = 6,
    seconds: Annotated[
        float, typer.Option(min=5.0, callback=finite, help="Length of each.")
    ] = 20.0,
    wind_m_s: Annotated[
        float, typer.Option(min=0.0, max=15.0, callback=finite, help="Mean wind, gusty.")
    ] = 5.0,
    seed: Annotated[int, typer.Option(help="The same flights for every feature set.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Folder for waypoints.json.")
    ] = None,
) -> None:
    """How far off places are at 25 and 50 m, without and with the filter, beside the thesis.

    Short flights over a generated site, on its map of another season. Each map fix is held against
    the truth at its exposure, and so is the filter's estimate of that moment.

    Example: vwnav bench waypoints --features learned --height-m 50
    """
    from vwnav.bench.flights.fly import fly
    from vwnav.bench.flights.waypoints import HEIGHTS_M, THESIS_M, measure, plan
    from vwnav.recording.run_folder import make_run_folder, write_json
    from vwnav.screen import progress_bar
    from vwnav.sim.named_sites import parse_site

    parse_site(site)
    names, heights_m = _known(features or []), height_m or HEIGHTS_M
    folder = None if output is None else make_run_folder(output, "bench")
    rows: list[WaypointsRow] = []
    values: dict[str, Any] = {}
    with progress_bar() as progress:
        for name, height in ((name, height) for name in names for height in heights_m):
            flights = [plan(k, height, seconds, wind_m_s, seed) for k in range(runs)]
            bar = partial(progress, f"{name}, {height:g} m")
            fly_there = partial(fly, place=_place(site, name))
            rows.append(measure(fly_there, name, flights, height, bar))
            values = _as_json(site, seconds, wind_m_s, rows, THESIS_M)
            if folder is not None:  # after each row: what has been measured is kept
                write_json(folder / "waypoints.json", values)
    if as_json:
        print(json.dumps(values))
    else:
        _print(site, rows, THESIS_M)


def _known(asked: list[str]) -> "list[FeatureName]":
    from vwnav.types import FEATURE_NAMES

    unknown = [name for name in asked if name not in FEATURE_NAMES]
    if unknown:
        raise typer.BadParameter(
            f"no features {unknown[0]!r}; there are {', '.join(FEATURE_NAMES)}"
        )
    return [name for name in FEATURE_NAMES if name in asked or not asked]


@cache
def _place(site: str, features: "FeatureName") -> "Place":
    """With the pack that flies with these features, but nothing to stand in for them."""
    import cv2

    from vwnav.assemble import choose_features
    from vwnav.bench.flights.world import Place
    from vwnav.errors import ModelError
    from vwnav.onboard.simulation import map_pack_of
    from vwnav.screen import say
    from vwnav.sim.named_sites import parse_site
    from vwnav.sim.renderer import default_camera
    from vwnav.vision.config import FeaturesConfig

    cv2.setNumThreads(1)
    primary, fallback = choose_features(FeaturesConfig(name=features), say)
    if primary.name != features:
        raise ModelError(f"{features} features are not available")
    pack = map_pack_of(site, [primary, *([fallback] if fallback else [])])
    return Place(parse_site(site), pack, default_camera(), primary, None)


def _as_json(
    site: str,
    seconds: float,
    wind_m_s: float,
    rows: "list[WaypointsRow]",
    thesis_m: Mapping[float, tuple[float, ...]],
) -> dict[str, Any]:
    return {
        "site": site,
        "seconds": seconds,
        "wind_m_s": wind_m_s,
        "rows": [_plain(asdict(row)) for row in rows],
        "thesis": {f"{height:g}": list(errors) for height, errors in thesis_m.items()},
    }


def _plain(value: Any) -> Any:
    """NaN, of errors that nothing was measured of, as null."""
    if isinstance(value, dict):
        return {name: _plain(entry) for name, entry in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _print(
    site: str, rows: "list[WaypointsRow]", thesis_m: Mapping[float, tuple[float, ...]]
) -> None:
    from rich.console import Console
    from rich.table import Table

    names = (
        "features", "height", "", "n", "mean m", "median m", "95 % m", "worst m", "available",
        "by correlation",
    )  # fmt: skip
    table = Table(title=f"waypoints over {site}; 95 % intervals", title_justify="left")
    for name in names:
        table.add_column(name, justify="left" if name in ("features", "") else "right")
    for height, errors in thesis_m.items():
        mean, worst = sum(errors) / len(errors), max(errors)
        median = sorted(errors)[len(errors) // 2]
        cells = (str(len(errors)), f"{mean:.2f}", f"{median:.2f}", "", f"{worst:.2f}", "", "")
        table.add_row("thesis: SIFT", f"{height:g} m", "no filter", *cells)
    for row in rows:
        raw = (*_cells(row.raw), str(row.correlated))
        table.add_row(row.features, f"{row.height_m:g} m", "no filter", *raw)
        table.add_row("", "", "filter", *_cells(row.filtered), "")
    width = None if sys.stdout.isatty() else _WIDTH
    Console(file=sys.stdout, highlight=False, width=width).print(table)


def _cells(errors: "Errors") -> tuple[str, ...]:
    return (
        str(errors.count),
        f"{errors.mean_m:.2f}{_interval(errors.mean_interval_m)}",
        f"{errors.median_m:.2f}",
        f"{errors.p95_m:.2f}{_interval(errors.p95_interval_m)}",
        f"{errors.worst_m:.2f}",
        f"{100.0 * errors.available:.1f} %",
    )


def _interval(bounds: tuple[float, float] | None) -> str:
    return "" if bounds is None else f" [{bounds[0]:.2f}, {bounds[1]:.2f}]"
