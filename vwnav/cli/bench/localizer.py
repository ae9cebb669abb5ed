"""`vwnav bench localizer`: the localizer on registered pictures and ground that repeats."""

import json
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vwnav.files.whole import write_whole

if TYPE_CHECKING:
    from vwnav.bench.localizer.run import SceneSet

_WIDTH = 140


def localizer(
    scenes: Annotated[
        str, typer.Option("--set", help="own (training data), judge or repeats (drawn).")
    ] = "own",
    data: Annotated[
        Path | None, typer.Option(help="Folder with pairs.json. [VWNAV_DATA, ../shared/data]")
    ] = None,
    features: Annotated[
        str, typer.Option("--features", help="Names, or paths of models, with commas between.")
    ] = "default,nano,default_open,sift",
    looks: Annotated[
        int,
        typer.Option(
            "--looks", min=1, help="With a prior, for each group; a quarter as many without."
        ),
    ] = 16,
    only: Annotated[
        str | None, typer.Option("--only", help="This group alone; sequences: short flights.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Folder for localizer.json.")
    ] = None,
    json_: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
) -> None:
    """Right places, false fixes and honest sigmas of the whole localizer, on one thread.

    Example: vwnav bench localizer --set judge --features default,sift --looks 40
    """
    from rich.console import Console

    from vwnav.bench.localizer.report import as_json, sequence_table, sequences_as_json, tables
    from vwnav.bench.localizer.run import bench_localizer, extractor_of, sequence_boards
    from vwnav.bench.localizer.sequences import bench_sequences
    from vwnav.bench.localizer.short_flights import SEQUENCES
    from vwnav.recording.run_folder import make_run_folder
    from vwnav.screen import LiveLine, say

    folder = None if output is None else make_run_folder(output, "bench")
    chosen, names = _scenes(scenes), [name for name in features.split(",") if name]
    with LiveLine() as line:

        def progress(text: str) -> None:
            line.show(time.monotonic(), text)

        if only == SEQUENCES:
            extractors = {name: extractor_of(name) for name in names}
            flown = bench_sequences(sequence_boards(chosen, data, looks), extractors, progress)
            values, shown = sequences_as_json(flown), [sequence_table(flown)]
        else:
            report = bench_localizer(chosen, data, names, looks, only, progress)
            values, shown = as_json(report), list(tables(report))
    if json_:
        print(json.dumps(values))
    else:
        # A file has no width of its own.
        width = None if sys.stdout.isatty() else _WIDTH
        console = Console(file=sys.stdout, highlight=False, width=width)
        for table in shown:
            console.print(table)
    if folder is not None:
        write_whole(folder / "localizer.json", json.dumps(values, indent=1))
        say(f"bench: wrote localizer.json to {folder}")


def _scenes(name: str) -> "SceneSet":
    from vwnav.bench.localizer.run import SCENE_SETS

    for known in SCENE_SETS:
        if name == known:
            return known
    raise typer.BadParameter(f"no set {name!r}; there are {', '.join(SCENE_SETS)}")
