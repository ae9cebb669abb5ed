"""`vwnav calibrate`: the lens from a board, the mount from a flight."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from vwnav.cli.features import ConfigOption, FeaturesOption, ModelOption

app = typer.Typer(no_args_is_help=True, help="Calibrate the camera: its lens, then its mount.")


class PaperSize(StrEnum):
    """What the board is printed on."""

    A4 = "a4"
    A3 = "a3"


@app.command()
def board(
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="PDF", help="The file to print.")
    ],
    paper: Annotated[PaperSize, typer.Option(help="The larger, the farther off it serves.")] = (
        PaperSize.A4
    ),
) -> None:
    """Draw the calibration board as a PDF to scale.

    Example: vwnav calibrate board -o board.pdf
    """
    from vwnav.calibration.board import COLUMNS, ROWS, write_board

    sheet = write_board(output, paper.value)
    typer.echo(
        f"{output}: {COLUMNS} x {ROWS} squares of {sheet.square_mm} mm on {paper.value.upper()}; "
        "print it at 100 % and glue it to something flat"
    )


@app.command()
def camera(
    source: Annotated[
        str,
        typer.Argument(help="Folder of pictures, a video, /dev/video0, picamera2, rtsp://..."),
    ],
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="FILE", help="Calibration, .toml or .json.")
    ],
) -> None:
    """Fit the lens to pictures of the board, in the size and focus that will fly.

    Move the board, or the camera, slowly: to all sides of the picture, near and far, tilted each
    way. A line says what is missing still. A live camera ends by itself when nothing is; Ctrl-C
    takes what there is.

    Examples:
    vwnav calibrate camera /dev/video0 -o camera.toml
    vwnav calibrate camera board_pictures/ -o camera.toml
    """
    from vwnav.calibration.from_board import calibrate_camera

    calibrate_camera(source, output)


@app.command()
def mount(
    source: Annotated[
        str, typer.Argument(help="A flight.mcap; or a video or pictures, with --telemetry.")
    ],
    map_path: Annotated[Path, typer.Option("--map", help="Map pack (vwnav map build).")],
    camera: Annotated[Path, typer.Option(help="The calibration that flew: its lens is kept.")],
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="FILE", help="Calibration, .toml or .json.")
    ],
    telemetry: Annotated[
        Path | None,
        typer.Option(
            help="Attitude, and agl_m if there is: CSV, ULog or tlog. 0 of a CSV's t_s, or the "
            "first attitude of the others, is the first picture's time."
        ),
    ] = None,
    focal: Annotated[bool, typer.Option("--focal", help="Ask for the focal length too.")] = False,
    features: FeaturesOption = None,
    model: ModelOption = None,
    config_path: ConfigOption = None,
) -> None:
    """Solve how the camera is mounted, how late and how slow it is, from one flight over the map.

    Fly some minutes in legs of several headings, with brisk banked turns. Each number comes with
    its sigma; what the flight does not tell is refused, with the reason, and left as it was.

    Example: vwnav calibrate mount flight.mcap --map field.mbtiles --camera camera.toml -o new.toml
    """
    from vwnav.calibration.from_flight import MountOptions, calibrate_mount
    from vwnav.config import load_config, with_features

    chosen = with_features(load_config(config_path), features, model).features
    calibrate_mount(MountOptions(source, map_path, camera, telemetry, focal, chosen, output))
