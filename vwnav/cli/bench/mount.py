"""`vwnav bench mount`: how true the calibration of a mount is, over rendered flights."""

import json
import sys
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from vwnav.bench.mount.run import MountRow, MountTrial

_WIDTH = 120


def mount(
    features: Annotated[str, typer.Option(help="learned, sift or orb.")] = "learned",
    runs: Annotated[int, typer.Option("--runs", min=1, help="Flights, half a minute each.")] = 20,
    seed: Annotated[int, typer.Option(help="Other cameras and ways for another seed.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
) -> None:
    """Calibrate cameras that hang as was drawn, each from one rendered flight over the map.

    110 s at 45 m and 8 m/s over the generated site and its map of another season: mount up to 4
    degrees off, 20 to 100 ms late, read-out 10 to 30 ms, focal length right, 2 % short or 1.5 %
    long; the autopilot's level wanders, its rangefinder errs. What `vwnav calibrate mount --focal`
    makes of the recording is held against the truth.

    Example: vwnav bench mount --runs 20
    """
    import cv2

    from vwnav.bench.mount.run import SIGMAS, bench_mount, rows_of
    from vwnav.config import load_config, with_features
    from vwnav.onboard.simulation import DEFAULT_SITE, map_pack_of
    from vwnav.screen import say
    from vwnav.sim.named_sites import parse_site
    from vwnav.vision.features.load import load_features

    cv2.setNumThreads(1)
    # The pack that `fly --sim` draws serves here too.
    sets = ["learned", "sift"] if features != "orb" else ["orb"]
    pack = map_pack_of(DEFAULT_SITE, [load_features(name) for name in sets])
    chosen = with_features(load_config(None), features, None).features
    trials = []
    for trial in bench_mount(parse_site(DEFAULT_SITE), pack, chosen, runs, seed):
        trials.append(trial)
        say(f"flight {trial.number + 1} of {runs}: {_in_words(trial)}")
    rows = rows_of(trials)
    if as_json:
        told = {"flights": runs, "sigmas": SIGMAS, "rows": [asdict(row) for row in rows]}
        print(json.dumps(told))
    else:
        _print(rows, runs, SIGMAS)


def _in_words(trial: "MountTrial") -> str:
    from vwnav.bench.mount.run import SOUGHT

    if trial.refused:
        return trial.refused
    told = zip(SOUGHT, trial.errors.tolist(), trial.sigmas.tolist(), strict=True)
    return ", ".join(f"{each.name} {off:+.2f} +- {by:.2f} {each.unit}" for each, off, by in told)


def _print(rows: "list[MountRow]", runs: int, sigmas: float) -> None:
    from rich.console import Console
    from rich.table import Table

    names = (
        "asked",
        "root mean square",
        "largest",
        "told",
        "as asked",
        f"within {sigmas:g} sigmas",
    )
    table = Table(title=f"mounts of {runs} rendered flights", title_justify="left")
    table.add_column("number")
    for name in names:
        table.add_column(name, justify="right")
    for row in rows:
        asked = "-" if row.asked is None else f"{row.asked:g} {row.unit}"
        as_asked = "-" if row.as_asked is None else f"{row.as_asked} of {row.told}"
        table.add_row(
            row.name, asked, f"{row.rms:.2f} {row.unit}", f"{row.largest:.2f} {row.unit}",
            f"{row.told} of {runs}", as_asked, f"{row.within} of {row.told}",
        )  # fmt: skip
    width = None if sys.stdout.isatty() else _WIDTH
    Console(file=sys.stdout, highlight=False, width=width).print(table)
