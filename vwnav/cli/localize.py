"""`vwnav localize`: where pictures were taken."""

from enum import StrEnum
from pathlib import Path

import typer

from vwnav.cli.features import ModelOption
from vwnav.cli.numbers import finite


class PriorSource(StrEnum):
    """Whether the pictures' own metadata are believed."""

    EXIF = "exif"
    NONE = "none"


def localize(
    images: list[Path] = typer.Argument(help="Pictures, or folders of them.", show_default=False),
    map_path: Path = typer.Option(..., "--map", help="Map pack (vwnav map build)."),
    camera: Path | None = typer.Option(None, help="Camera calibration (JSON, TOML, OpenCV YAML)."),
    hfov_deg: float | None = typer.Option(
        None,
        min=1.0,
        max=179.0,
        callback=finite,
        help="Horizontal field of view instead; else what EXIF says.",
    ),
    prior: PriorSource = typer.Option(
        PriorSource.NONE, help="exif: place, attitude and height as the pictures say."
    ),
    metadata: Path | None = typer.Option(
        None,
        help="CSV: image, and any of lat_deg, lon_deg, sigma_m, agl_m, yaw_deg, roll_deg, "
        "pitch_deg. Goes before EXIF.",
    ),
    lat: float | None = typer.Option(
        None, min=-90.0, max=90.0, callback=finite, help="Latitude. Goes before all."
    ),
    lon: float | None = typer.Option(
        None, min=-180.0, max=180.0, callback=finite, help="Longitude."
    ),
    sigma_m: float | None = typer.Option(
        None, min=0.0, callback=finite, help="One sigma of that position."
    ),
    yaw_deg: float | None = typer.Option(
        None, callback=finite, help="Heading of the pictures' upper edge."
    ),
    agl_m: float | None = typer.Option(
        None, min=1.0, callback=finite, help="Height above the ground."
    ),
    features: str = typer.Option("learned", help="learned, sift or orb."),
    model: ModelOption = None,
    json_lines: bool = typer.Option(False, "--json", help="One JSON object per picture."),
) -> None:
    """Find where pictures were taken on a map.

    What is not known of a picture is searched: place, heading and height. A picture that cannot be
    placed is a result, not a failure. Without an attitude the position is that of the picture's
    centre, with one it is the ground point below the camera (`point`).

    Example: vwnav localize pictures/ --map field.mbtiles --prior exif --json
    """
    from vwnav.offline.localize import LocalizeOptions, localize_images

    if (lat is None) != (lon is None):
        raise typer.BadParameter("--lat and --lon belong together")
    options = LocalizeOptions(
        images=images,
        map_path=map_path,
        camera=camera,
        hfov_deg=hfov_deg,
        use_exif=prior is PriorSource.EXIF,
        metadata=metadata,
        lat_deg=lat,
        lon_deg=lon,
        sigma_m=sigma_m,
        yaw_deg=yaw_deg,
        agl_m=agl_m,
        features=features,
        model=model,
        json_lines=json_lines,
    )
    localize_images(options)
