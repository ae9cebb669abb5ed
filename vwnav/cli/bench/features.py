"""`vwnav bench features` and `drift`: feature sets side by side, and how far odometry goes off."""

import json
import math
import sys
from dataclasses import asdict
from pathlib import Path

import typer

from vwnav.files.whole import write_whole
from vwnav.screen import print_table, progress_bar, say

_WIDTH = 120


def features(
    data: Path | None = typer.Option(
        None, help="Folder with eval/, flights/ and pairs.json. [VWNAV_DATA, ../shared/data]"
    ),
    model: list[Path] = typer.Option(
        [], help="ONNX model to judge, may be repeated; else all the released ones."
    ),
    views: int = typer.Option(60, min=1, help="Scenes of each group, at most."),
    repeats: int = typer.Option(50, min=1, help="Repeats of each time measurement."),
    output: Path | None = typer.Option(
        None, "-o", "--output", help="Folder for report.json, a plot and pictures of matches."
    ),
    sequence: bool = typer.Option(
        False, "--sequence", help="Instead: the whole pipeline over a real video, begun anywhere."
    ),
    as_json: bool = typer.Option(False, "--json", help="One JSON object on stdout."),
) -> None:
    """Match, place and time every feature set on the same scenes, on one thread.

    Without a data folder generated places are the scenes.

    Example: vwnav bench features --data ../shared/data -o bench
    """
    from rich.console import Console

    from vwnav.bench.features.report import as_json as report_as_json
    from vwnav.bench.features.report import tables
    from vwnav.bench.features.run import bench_features, data_folder
    from vwnav.recording.run_folder import make_run_folder

    if sequence:
        _sequence(data_folder(data), model[0] if model else None, as_json)
        return
    folder = None if output is None else make_run_folder(output, "bench")
    with progress_bar() as progress:
        report = bench_features(data_folder(data), model, views, repeats, progress)
    for line in report.skipped:
        say(f"bench: {line}")
    values = report_as_json(report)
    if as_json:
        print(json.dumps(values))
    else:
        # A file has no width of its own.
        width = None if sys.stdout.isatty() else _WIDTH
        console = Console(file=sys.stdout, highlight=False, width=width)
        for table in tables(report):
            console.print(table)
    if folder is not None:
        from vwnav.bench.features.figures import write_figures
        from vwnav.bench.features.plots import write_plot

        write_figures(folder / "matches", report.samples)
        write_whole(folder / "report.json", json.dumps(values, indent=1))
        write_plot(folder / "features.png", report)
        say(f"bench: wrote report.json, features.png and matches/ to {folder}")


def _sequence(data: Path | None, model: Path | None, as_json: bool) -> None:
    from vwnav.bench.features import sequence

    scores = sequence.bench_sequence(data, model, say)
    if as_json:
        print(json.dumps(sequence.as_json(scores)))
        return
    print_table("a video without a start, 5 s of it black", list(sequence.rows(scores)))


def drift(
    trajectory: Path = typer.Argument(help="trajectory.csv of `vwnav replay`."),
    track: Path = typer.Argument(help="The true way: CSV with t_s, lat_deg, lon_deg (or t, ...)."),
    as_json: bool = typer.Option(False, "--json", help="One JSON object on stdout."),
) -> None:
    """How far a trajectory has drifted from the true way, in per cent of it.

    For odometry alone, replay with a settings file that says `most_fixes = 1` under [pipeline].

    Example: vwnav bench drift result/trajectory.csv track.csv
    """
    from vwnav.bench.track_drift import compare

    found = compare(trajectory, track)
    if as_json:
        print(json.dumps(asdict(found)))
        return
    rows = [
        ("true way", f"{found.way_m:.0f} m"),
        ("off at its end", f"{100.0 * found.end_ratio:.2f} %"),
        ("off at the worst", f"{100.0 * found.worst_ratio:.2f} %"),
        ("fits when multiplied by", f"{found.scale:.4f}"),
        ("and turned by", f"{math.degrees(found.turn_rad):.2f} deg"),
    ]
    print_table("drift", rows)
