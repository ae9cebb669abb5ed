"""`vwnav replay`: the flight's pipeline over a recorded video, picture folder or recording."""

from pathlib import Path

import typer


def replay(
    source: str = typer.Argument(help="Video file or folder of pictures."),
    map_path: Path = typer.Option(..., "--map", help="Map pack (vwnav map build)."),
    camera: Path | None = typer.Option(None, help="Camera calibration (JSON, TOML, OpenCV YAML)."),
    hfov_deg: float | None = typer.Option(None, help="Horizontal field of view instead of it."),
    telemetry: Path | None = typer.Option(None, help="Attitude and height: CSV, ULog or tlog."),
    features: str = typer.Option("learned", help="learned, sift or orb."),
    model: Path | None = typer.Option(
        None, help="Learned features of another size (nano) or ONNX file."
    ),
    config_path: Path | None = typer.Option(None, "--config", help="Settings (TOML)."),
    output: Path | None = typer.Option(None, "-o", "--output", help="Folder of the results."),
) -> None:
    """Fly a recording again: writes trajectory.csv, run.json and a picture of the track.

    Without telemetry the camera is taken to look straight down and the position is found on the
    whole map. The same recording gives the same trajectory.

    Example: vwnav replay flight.mp4 --map field.mbtiles --hfov-deg 78 -o result
    """
    from vwnav.cli.replaying import ReplayOptions, replay_source

    options = ReplayOptions(
        source, map_path, camera, hfov_deg, telemetry, features, model, config_path, output
    )
    replay_source(options)
