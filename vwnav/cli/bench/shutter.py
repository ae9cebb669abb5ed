"""`vwnav bench shutter`: what a rolling shutter costs."""

import json
import sys
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from vwnav.bench.localizer.shutter import ShutterRow

_WIDTH = 120


def shutter(
    features: Annotated[str, typer.Option(help="learned, sift or orb.")] = "learned",
    looks: Annotated[int, typer.Option("--looks", min=1, help="Of each camera.")] = 100,
    seed: Annotated[int, typer.Option(help="Other moments for another seed.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
) -> None:
    """A global shutter, a rolling one of 20 ms, and the same with its rows put back by the gyro.

    The same moments at 50 m, 12 m/s and 60 degrees a second about any axis, over the generated
    site and its map of another season: raw fixes, and odometry's way of a tenth of a second.

    Example: vwnav bench shutter --looks 200
    """
    import cv2

    from vwnav.bench.localizer.shutter import ASKED, bench_shutter
    from vwnav.maps.pack import MapPack
    from vwnav.onboard.simulation import DEFAULT_SITE, map_pack_of
    from vwnav.screen import progress_bar
    from vwnav.sim.named_sites import parse_site
    from vwnav.vision.features.load import load_features

    cv2.setNumThreads(1)
    # The pack that `fly --sim` draws serves here too.
    sets = ["learned", "sift"] if features != "orb" else ["orb"]
    extractors = {name: load_features(name) for name in {*sets, features}}
    site = parse_site(DEFAULT_SITE)
    path = map_pack_of(DEFAULT_SITE, list(extractors.values()))
    with MapPack.open(path) as pack, progress_bar() as progress:
        rows = bench_shutter(site, pack, extractors[features], looks, seed, progress)
    if as_json:
        print(json.dumps({"asked": ASKED, "rows": [asdict(row) for row in rows]}))
    else:
        _print(rows, ASKED)


def _print(rows: "list[ShutterRow]", asked: float) -> None:
    from rich.console import Console
    from rich.table import Table

    names = ("fixes", "place m", "of global", "95 % m", "heading deg", "height m", "way m", "ms")
    title = f"shutter of 20 ms, 12 m/s, 60 deg/s; root mean squares; asked: {asked:g} of global"
    table = Table(title=title, title_justify="left")
    table.add_column("shutter")
    for name in names:
        table.add_column(name, justify="right")
    for row in rows:
        table.add_row(
            row.shutter, f"{row.fixes} of {row.looks}", f"{row.place_m:.3f}",
            f"{row.place_m / rows[0].place_m:.2f}", f"{row.place_p95_m:.3f}", f"{row.yaw_deg:.3f}",
            f"{row.agl_m:.3f}", f"{row.way_m:.4f}", f"{row.look_ms:.1f}",
        )  # fmt: skip
    width = None if sys.stdout.isatty() else _WIDTH
    Console(file=sys.stdout, highlight=False, width=width).print(table)
