"""`vwnav replay`: the flight's pipeline over a recorded video, picture folder or recording."""

from pathlib import Path

import typer

from vwnav.cli.features import ConfigOption, FeaturesOption, ModelOption
from vwnav.cli.numbers import finite


def replay(
    source: str = typer.Argument(help="Video, folder of pictures, or a flight.mcap."),
    map_path: Path | None = typer.Option(None, "--map", help="Map pack (vwnav map build)."),
    camera: Path | None = typer.Option(None, help="Camera calibration (JSON, TOML, OpenCV YAML)."),
    hfov_deg: float | None = typer.Option(
        None, min=1.0, max=179.0, callback=finite, help="Horizontal field of view instead of it."
    ),
    telemetry: Path | None = typer.Option(
        None,
        help="Attitude and height: CSV, ULog or tlog. 0 of a CSV's t_s, or the first attitude of "
        "the others, is the first picture's time.",
    ),
    features: FeaturesOption = None,
    model: ModelOption = None,
    config_path: ConfigOption = None,
    output: Path | None = typer.Option(None, "-o", "--output", help="Folder of the results."),
    check: bool = typer.Option(
        False, "--check", help="Hold a flight.mcap against the rules of every flight instead."
    ),
    truth: Path | None = typer.Option(
        None, help="With --check: the true way, CSV of t_s, north_m, east_m, alt_amsl_m."
    ),
) -> None:
    """Fly a recording again: writes trajectory.csv, run.json and a picture of the track.

    Of a video or pictures: without telemetry the camera is taken to look straight down and the
    position is found on the whole map. The same recording gives the same trajectory.

    Of a flight's own flight.mcap, without options about pictures: the filter takes what it took in
    flight, and the trajectory is the flight's to the last bit.

    With --check nothing is flown again: the recording is held against the rules of every flight,
    and the exit code is 1 when one is broken.

    Examples:
    vwnav replay flight.mp4 --map field.mbtiles --hfov-deg 78 -o result
    vwnav replay runs/fly-1/flight.mcap --map field.mbtiles -o result
    vwnav replay runs/fly-1/flight.mcap --check
    """
    if check:
        from vwnav.offline.check import check_recording

        raise typer.Exit(check_recording(Path(source), truth))
    if map_path is None:
        raise typer.BadParameter("a map pack is needed to fly it again", param_hint="--map")
    from vwnav.offline.report import ReplayOptions

    options = ReplayOptions(
        source, map_path, camera, hfov_deg, telemetry, features, model, config_path, output
    )
    if options.from_input_log:
        from vwnav.offline.replay_inputs import replay_inputs

        replay_inputs(options)
    else:
        from vwnav.offline.replay_images import replay_source

        replay_source(options)
