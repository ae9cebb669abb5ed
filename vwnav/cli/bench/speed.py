"""`vwnav bench speed`: what this board can fly with."""

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vwnav.cli.numbers import finite

if TYPE_CHECKING:
    from vwnav.bench.speed.results import SpeedReport

_FILE_WIDTH = 80


def speed(
    target_hz: Annotated[
        float,
        typer.Option(
            min=0.1, max=30.0, callback=finite, help="Pictures matched to the map a second."
        ),
    ] = 5.0,
    features: Annotated[
        list[str] | None,
        typer.Option(help="sift, orb, a released model or an ONNX file; may be repeated."),
    ] = None,
    threads: Annotated[
        int | None, typer.Option(min=1, help="Of an extraction, at most; else all cores but one.")
    ] = None,
    repeats: Annotated[int, typer.Option(min=1, help="Pictures of each setting.")] = 20,
    seconds: Annotated[
        float, typer.Option(min=5.0, callback=finite, help="In real time, of what is chosen.")
    ] = 20.0,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Settings that `fly --config` takes.")
    ] = None,
) -> None:
    """Time every setting on this board, and choose what holds a rate with the best accuracy.

    Let nothing else run on the board meanwhile. The accuracy is not measured here: it is that of a
    real flight (docs/benchmarks.md).

    Example: vwnav bench speed --target-hz 5 -o board.toml
    """
    from vwnav.bench.speed.report import as_json as report_as_json
    from vwnav.bench.speed.report import check_place, refusal, write_settings
    from vwnav.bench.speed.results import Wanted
    from vwnav.bench.speed.run import bench_speed
    from vwnav.errors import VwnavError
    from vwnav.screen import say

    if output is not None:
        check_place(output)
    wanted = Wanted(
        features=features or [], threads=threads, target_hz=target_hz, repeats=repeats,
        seconds=seconds,
    )  # fmt: skip
    report = bench_speed(wanted, say)
    for line in report.skipped:
        say(f"bench: {line}")
    if as_json:
        print(json.dumps(report_as_json(report)))
    else:
        _print(report)
    if report.chosen is None:
        raise VwnavError(refusal(report))
    if output is not None:
        write_settings(output, report)
        say(f"bench: wrote {output}: vwnav fly --config {output}")


def _print(report: "SpeedReport") -> None:
    from rich.console import Console

    from vwnav.bench.speed.choice import words
    from vwnav.bench.speed.report import tables
    from vwnav.screen import check_table

    # A file has no width of its own.
    width = None if sys.stdout.isatty() else _FILE_WIDTH
    console = Console(file=sys.stdout, highlight=False, width=width)
    for table in tables(report):
        console.print(table)
    console.print(check_table(report.after))
    if report.chosen is not None:
        for line in words(report.chosen, report.rows, report.wanted.target_hz, report.cores):
            console.print(line, markup=False)
