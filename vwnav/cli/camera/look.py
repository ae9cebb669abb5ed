"""`vwnav camera`: what the drone sees."""

from pathlib import Path

import typer

from vwnav.cli.numbers import finite


def camera(
    source: str = typer.Argument(
        "/dev/video0", help="/dev/video0, picamera2, rtsp://..., a video, pictures, flight.mcap."
    ),
    calibration: Path | None = typer.Option(
        None, "--camera", help="Calibration: says how much of the ground a pixel is."
    ),
    height_m: float = typer.Option(
        50.0, min=0.5, callback=finite, help="Height above ground to say that for."
    ),
    seconds: float = typer.Option(
        5.0, min=0.1, max=3600.0, callback=finite, help="How long to watch."
    ),
    features: str = typer.Option("learned", help="Keypoints: learned, sift or orb."),
    output: Path | None = typer.Option(
        None, "-o", "--output", metavar="PICTURE", help="Draw the newest picture, .jpg or .png."
    ),
) -> None:
    """Show what the camera sees: rate, jitter, latency, sharpness, light, keypoints.

    Example: vwnav camera /dev/video0 --camera camera.toml --height-m 80 -o seen.jpg
    """
    from vwnav.calibration.look import LookOptions, look

    look(LookOptions(source, calibration, height_m, seconds, features, output))
