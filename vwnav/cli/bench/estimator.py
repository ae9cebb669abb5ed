"""`vwnav bench estimator`: Monte-Carlo of the filter on sensor streams and rendered pictures."""

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vwnav.cli.numbers import finite
from vwnav.files.whole import write_whole

if TYPE_CHECKING:
    from vwnav.bench.estimator.flown import Metric, RenderedScenario
    from vwnav.bench.estimator.scenarios import FilterScenario
    from vwnav.types import FeatureName

_NOMINAL_S = 600.0


def estimator(
    runs: Annotated[int, typer.Option("--runs", min=1, help="Flights of each scenario.")] = 20,
    scenario: Annotated[
        list[str] | None,
        typer.Option(
            "--scenario",
            help="Only this one; may be repeated. rendered and rendered-odometry (also with -imu) "
            "fly with rendered pictures: a minute a flight, so they are flown only where named.",
        ),
    ] = None,
    seconds: Annotated[
        float | None,
        typer.Option(
            "--seconds",
            min=60.0,
            callback=finite,
            help="Length of a nominal (600) or rendered (130) flight.",
        ),
    ] = None,
    features: Annotated[
        str, typer.Option("--features", help="Of rendered flights: learned or sift.")
    ] = "learned",
    seed: Annotated[int, typer.Option("--seed", help="Flight k of a seed is always the same.")] = 0,
    json_: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Plots, CSV and MCAP recordings go here.")
    ] = None,
) -> None:
    """How wrong the filter is, and how well it knows: RMSE, NEES, NIS, coverage, drift."""
    from vwnav.bench.estimator.benchmark import as_json, bench
    from vwnav.bench.estimator.rendered_run import bench_rendered
    from vwnav.bench.estimator.scenarios import FilterScenario
    from vwnav.recording.run_folder import make_run_folder
    from vwnav.screen import LiveLine

    scenarios, matching = _choose(scenario or [], seconds), _matching(features)
    if output is not None:
        make_run_folder(output, "bench")
    results = {}
    for chosen in scenarios:
        with LiveLine() as line:
            if isinstance(chosen, FilterScenario):
                metrics = bench(
                    chosen, runs, seed, output, lambda text: line.show(time.monotonic(), text)
                )
            else:
                metrics = bench_rendered(chosen, runs, seed, seconds, matching, output, line.show)
        results[chosen.name] = as_json(metrics)
        if not json_:
            _print(chosen.name, runs, metrics)
    summary = {"runs": runs, "seed": seed, "seconds": seconds, "scenarios": results}
    if output is not None:
        write_whole(output / "estimator.json", json.dumps(summary, indent=2) + "\n")
    if json_:
        print(json.dumps(summary))


def _matching(features: str) -> "FeatureName":
    if features == "learned":
        return "learned"
    if features == "sift":
        return "sift"
    raise typer.BadParameter(f"no features {features!r} here; there are learned and sift")


def _choose(names: list[str], seconds: float | None) -> "list[FilterScenario | RenderedScenario]":
    from dataclasses import replace

    from vwnav.bench.estimator.rendered_scenarios import RENDERED
    from vwnav.bench.estimator.scenarios import SCENARIOS, FilterScenario

    known: dict[str, FilterScenario | RenderedScenario] = {s.name: s for s in SCENARIOS}
    for name in ("nominal", "nominal-imu"):
        flown = known[name]
        assert isinstance(flown, FilterScenario)
        known[name] = replace(flown, world=replace(flown.world, seconds=seconds or _NOMINAL_S))
    unasked = list(known)
    known |= {s.name: s for s in RENDERED}
    unknown = [name for name in names if name not in known]
    if unknown:
        raise typer.BadParameter(f"no scenario {unknown[0]!r}; there are {', '.join(known)}")
    return [known[name] for name in names or unasked]


def _print(name: str, runs: int, metrics: "list[Metric]") -> None:
    from vwnav.screen import print_table

    rows = []
    for m in metrics:
        asked = [f"at least {m.low:.4g}"] if m.low is not None else []
        asked += [f"at most {m.high:.4g}"] if m.high is not None else []
        verdict = {True: "ok", False: "NOT REACHED", None: ""}[m.good]
        value = f"{m.value:.3g} {m.unit}".strip()
        rows.append((m.name, f"{value:<14} {', '.join(asked)} {verdict}".rstrip()))
    print_table(f"{name}, {runs} flights", rows)
