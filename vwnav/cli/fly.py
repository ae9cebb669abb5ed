"""`vwnav fly`: the flight itself, on a drone or in simulation."""

from pathlib import Path
from typing import get_args

import typer

from vwnav.cli.features import ConfigOption, FeaturesOption, ModelOption
from vwnav.cli.numbers import finite
from vwnav.onboard.options import FlyOptions
from vwnav.sim.config import Manners


def fly(
    sim: bool = typer.Option(False, "--sim", help="Everything embedded: site, vehicle, camera."),
    realtime: bool = typer.Option(
        False, "--realtime", help="With --sim: by the wall clock, which waits for nobody."
    ),
    arm: bool = typer.Option(
        False, "--arm", help="Arm by itself once ready; else a person arms a real aircraft."
    ),
    standby: bool = typer.Option(False, "--standby", hidden=True),
    features: FeaturesOption = None,
    map_source: str | None = typer.Option(None, "--map", help="Map pack, or sim:SITE."),
    route: Path | None = typer.Option(
        None, help="QGroundControl .plan, Mission Planner .waypoints, GeoJSON or ID,X,Y,Z text."
    ),
    route_frame: str = typer.Option(
        "local", help="Text routes: local (north, east, height in m) or global (lat, lon, height)."
    ),
    camera: Path | None = typer.Option(None, help="Camera calibration (JSON, TOML, OpenCV YAML)."),
    video: str | None = typer.Option(
        None,
        help="/dev/video0[:640x480@30:GREY], picamera2, rtsp://..., gst:640x480:PIPELINE, "
        "or sim:SITE drawn from --truth.",
    ),
    connection: str | None = typer.Option(
        None, help="udpin://0.0.0.0:14540, tcpout://HOST:PORT, serial:///dev/ttyAMA0:921600."
    ),
    truth: str | None = typer.Option(
        None, help="Simulators only: MAVLink URL of the ground truth that the camera is drawn from."
    ),
    home: str | None = typer.Option(None, help="LAT,LON of the take-off; the route's home if not."),
    home_sigma_m: float = typer.Option(
        5.0, min=0.5, callback=finite, help="How well home is known."
    ),
    manners: str = typer.Option("px4", help="With --sim: the vehicle's: px4, px4-1.16 or copter."),
    wind_m_s: float = typer.Option(
        5.0, min=0.0, max=15.0, callback=finite, help="With --sim: mean wind, gusty."
    ),
    seed: int = typer.Option(1, help="With --sim: of wind and sensor noise."),
    model: ModelOption = None,
    config_path: ConfigOption = None,
    output: Path | None = typer.Option(None, "-o", "--output", help="Folder of the results."),
) -> None:
    """Fly a route without GPS and come home.

    The pilot's mode switch always wins: after it, nothing more is asked of the autopilot.

    Examples:
    vwnav fly --sim
    vwnav fly --sim --manners copter
    vwnav fly --map field.mbtiles --route field.plan --camera cam.toml --video /dev/video0
    --connection serial:///dev/ttyAMA0:921600
    """
    options = FlyOptions(**locals())
    needed = {"--map": map_source, "--route": route, "--video": video, "--connection": connection}
    missing = [name for name, value in needed.items() if not value]
    if missing and not sim:
        raise typer.BadParameter(f"without --sim a flight needs {', '.join(missing)}")
    if realtime and not sim:
        raise typer.BadParameter("--realtime goes with --sim: elsewhere time waits for nobody")
    if manners not in get_args(Manners):
        raise typer.BadParameter(f"--manners is {' or '.join(get_args(Manners))}, not {manners!r}")
    if route_frame not in ("local", "global"):
        raise typer.BadParameter(f"--route-frame is local or global, not {route_frame!r}")
    if standby:  # started by the watchdog
        from vwnav.onboard.successor import stand_by

        stand_by(options)
        return
    from vwnav.onboard.program import fly_route

    fly_route(options)
