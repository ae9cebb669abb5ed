"""`vwnav bench significance`: how little chance the wrong agreements of a model show."""

import json
import time
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer


def significance(
    features: Annotated[
        str, typer.Option("--features", help="Names, or paths of models, with commas between.")
    ] = "default",
    data: Annotated[
        Path | None, typer.Option(help="Folder with pairs.json. [VWNAV_DATA, ../shared/data]")
    ] = None,
    looks: Annotated[
        int, typer.Option("--looks", min=100, help="Of a view at a piece of map elsewhere.")
    ] = 3000,
    write: Annotated[
        bool, typer.Option("--write", help="Put the value into each model's own file.")
    ] = False,
    json_: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
) -> None:
    """Measure on unrelated training pictures what the matches of a model prove.

    A model without a value of its own flies with a cautious one. Do this once for new weights.

    Example: vwnav bench significance --features runs/new.onnx --write
    """
    from vwnav.bench.localizer.run import data_folder, extractor_of
    from vwnav.bench.localizer.unrelated import calibrate, write_log10_per_decade
    from vwnav.screen import LiveLine, print_table, say
    from vwnav.types import FEATURE_NAMES
    from vwnav.vision.features.learned import find_model

    folder, found = data_folder(data), {}
    with LiveLine() as line:
        for name in (name for name in features.split(",") if name):
            extractor = extractor_of(name)
            found[name] = calibrate(
                folder, extractor, looks, lambda text: line.show(time.monotonic(), text)
            )
            if write and name not in FEATURE_NAMES:
                path = find_model(Path(name))
                write_log10_per_decade(path, found[name].log10_per_decade)
                say(f"bench: wrote {found[name].log10_per_decade} to {path}")
    if json_:
        print(json.dumps({name: asdict(each) for name, each in found.items()}))
        return
    for name, each in found.items():
        print_table(name, [(key, f"{value:.4g}") for key, value in asdict(each).items()])
