"""`vwnav bench estimator`: Monte-Carlo of the filter on simulated sensor streams."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from vwnav.bench.estimator_scenarios import Metric, Scenario


def estimator(
    runs: Annotated[int, typer.Option("--runs", min=1, help="Flights of each scenario.")] = 20,
    scenario: Annotated[
        list[str] | None, typer.Option("--scenario", help="Only this one; may be repeated.")
    ] = None,
    seconds: Annotated[
        float, typer.Option("--seconds", min=60.0, help="Length of a nominal flight.")
    ] = 600.0,
    seed: Annotated[int, typer.Option("--seed", help="Flight k of a seed is always the same.")] = 0,
    json_: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Plots, CSV and MCAP recordings go here.")
    ] = None,
) -> None:
    """How wrong the filter is, and how well it knows: RMSE, NEES, NIS, coverage, drift."""
    from vwnav.bench.estimator import as_json, bench
    from vwnav.cli.screen import LiveLine
    from vwnav.drivers.run_folder import make_run_folder

    if output is not None:
        make_run_folder(output, "bench")
    results = {}
    for chosen in _choose(scenario or [], seconds):
        with LiveLine() as line:
            metrics = bench(chosen, runs, seed, output, lambda text: line.show(0.0, text))
        results[chosen.name] = as_json(metrics)
        if not json_:
            _print(chosen.name, runs, metrics)
    summary = {"runs": runs, "seed": seed, "seconds": seconds, "scenarios": results}
    if output is not None:
        (output / "estimator.json").write_text(json.dumps(summary, indent=2) + "\n")
    if json_:
        print(json.dumps(summary))


def _choose(names: list[str], seconds: float) -> "list[Scenario]":
    from dataclasses import replace

    from vwnav.bench.estimator_scenarios import SCENARIOS

    known = {s.name: s for s in SCENARIOS}
    unknown = [name for name in names if name not in known]
    if unknown:
        raise typer.BadParameter(f"no scenario {unknown[0]!r}; there are {', '.join(known)}")
    known["nominal"] = replace(
        known["nominal"], world=replace(known["nominal"].world, seconds=seconds)
    )
    return [known[name] for name in names] if names else list(known.values())


def _print(name: str, runs: int, metrics: "list[Metric]") -> None:
    from vwnav.cli.screen import print_table

    rows = []
    for m in metrics:
        asked = [f"at least {m.low:.4g}"] if m.low is not None else []
        asked += [f"at most {m.high:.4g}"] if m.high is not None else []
        verdict = {True: "ok", False: "NOT REACHED", None: ""}[m.good]
        value = f"{m.value:.3g} {m.unit}".strip()
        rows.append((m.name, f"{value:<14} {', '.join(asked)} {verdict}".rstrip()))
    print_table(f"{name}, {runs} flights", rows)
