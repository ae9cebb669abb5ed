"""`vwnav map`: make a map pack, describe it, check it against a route."""

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from vwnav.cli.features import ModelOption
from vwnav.cli.numbers import finite

if TYPE_CHECKING:
    from vwnav.guidance.plan_files import Route
    from vwnav.maps.build.builder import BuildOptions
    from vwnav.maps.build.raster import RasterSource
    from vwnav.maps.clearance import RouteClearance
    from vwnav.maps.heights import HeightGrid
    from vwnav.maps.pack import MapPack
    from vwnav.onboard.flight_plan import RouteOnMap

app = typer.Typer(no_args_is_help=True, help="Make a map pack, describe it, check it.")


@app.command()
def build(
    sources: Annotated[
        list[Path],
        typer.Argument(
            metavar="SOURCE...", help="GeoTIFFs, pictures with world files, map.csv, folders."
        ),
    ],
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="PACK", help="The .mbtiles file.")
    ],
    features: Annotated[
        str, typer.Option(help="Feature sets: learned, sift, orb.")
    ] = "learned,sift",
    levels: Annotated[str | None, typer.Option(help="Zoom levels, such as 19,18,17.")] = None,
    name: Annotated[str | None, typer.Option(help="Of the map, for people.")] = None,
    attribution: Annotated[
        str | None, typer.Option(help="Whom the imagery's terms want named.")
    ] = None,
    georeference_sigma_m: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            callback=finite,
            help="One sigma of the imagery's position; else by what overlaps, or 1 m.",
        ),
    ] = None,
    crs: Annotated[
        str | None, typer.Option(help="Of rasters that name none, such as EPSG:32643.")
    ] = None,
    heights: Annotated[Path | None, typer.Option(help="Elevation raster, above sea level.")] = None,
    model: ModelOption = None,
) -> None:
    """Make a map pack: tiles of several levels, and the features to find pictures in them.

    Example: vwnav map build field.tif -o field.mbtiles --attribution "(c) survey office"
    """
    from vwnav.maps.build.builder import build_pack
    from vwnav.maps.build.sources import default_options, open_sources
    from vwnav.maps.build.writer import check_replaceable
    from vwnav.maps.pack import MapPack
    from vwnav.offline.map_agreement import agreement_of, with_agreement
    from vwnav.screen import progress_bar, say
    from vwnav.vision.features.load import load_features

    zooms = _zooms(levels)
    check_replaceable(output)
    extractors = [load_features(feature, model) for feature in _names(features)]
    rasters = open_sources(sources, crs)
    said: dict[str, Any] = {
        "levels": zooms,
        "name": name,
        "attribution": attribution,
        "georeference_sigma_m": georeference_sigma_m,
        "georeference_basis": None if georeference_sigma_m is None else "given",
        "created_utc": _now_utc(),
        "heights": None if heights is None else _heights(heights, rasters),
    }
    # What is not said stays as it is in a pack that is rebuilt.
    said = {key: value for key, value in said.items() if value is not None}
    options: BuildOptions = replace(default_options(sources, rasters), **said)
    with progress_bar() as progress:
        agreement = agreement_of(rasters, extractors, progress)
        if agreement is not None:
            options, lines = with_agreement(options, agreement)
            for line in lines:
                say(f"map: {line}")
        build_pack(rasters, output, extractors, options, progress)
    with MapPack.open(output) as pack:
        _print_description(pack)


@app.command()
def info(
    pack: Annotated[Path, typer.Argument(metavar="PACK")],
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
) -> None:
    """Describe a map pack."""
    from vwnav.maps.pack import MapPack

    with MapPack.open(pack) as opened:
        if as_json:
            typer.echo(json.dumps(_description(opened)))
        else:
            _print_description(opened)


@app.command()
def check(
    pack: Annotated[Path, typer.Argument(metavar="PACK")],
    route: Annotated[
        Path,
        typer.Option(
            help="QGroundControl .plan, Mission Planner .waypoints, GeoJSON or ID,X,Y,Z text."
        ),
    ],
    route_frame: Annotated[
        str,
        typer.Option(help="Text routes: local (north, east, height in m) or global (lat, lon)."),
    ] = "local",
    home: Annotated[
        str | None, typer.Option(help="LAT,LON of the take-off; the route's home if not.")
    ] = None,
    margin_m: Annotated[
        float, typer.Option(min=0.0, callback=finite, help="Imagery is wanted so far around.")
    ] = 50.0,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
) -> None:
    """Say whether the map covers a route and how high that is above its ground; 3 if it fails."""
    from vwnav.errors import PreflightError, RouteError
    from vwnav.maps.pack import MapPack
    from vwnav.onboard.flight_plan import route_on_map
    from vwnav.safety.safety_config import SafetyConfig

    loaded, start = route_and_home(route, route_frame, home)
    with MapPack.open(pack) as opened:
        try:
            found = route_on_map(opened, loaded, start, SafetyConfig(), margin_m)
        except RouteError as error:
            raise RouteError(f"{route}: {error}") from error
    coverage, clearance = found.coverage, found.clearance
    if as_json:
        typer.echo(json.dumps(_check_values(found)))
    elif coverage.ok:
        typer.echo(coverage.summary())
    for each in (coverage, clearance):
        if not each.ok:
            raise PreflightError(f"{pack}: {each.summary()}")
    if not as_json:
        typer.echo("\n".join(filter(None, (clearance.summary(), found.returns))))


def route_and_home(
    route: Path, route_frame: str, home: str | None
) -> "tuple[Route, tuple[float, float] | None]":
    """What the file says, and (lat_deg, lon_deg) of the take-off where that is known.

    Args:
        route: its file.
        route_frame: "local" or "global", for text routes.
        home: LAT,LON of the take-off; the route's own home if not given.

    Raises:
        RouteError: the route cannot be read.
        ConfigError: one of the other arguments makes no sense.
    """
    from vwnav.errors import ConfigError
    from vwnav.geometry.geodesy import parse_lat_lon
    from vwnav.guidance.plan_files import load_route

    if route_frame not in ("local", "global"):
        raise ConfigError(f"--route-frame {route_frame!r}: choose local or global")
    loaded = load_route(route, "global" if route_frame == "global" else "local")
    return loaded, parse_lat_lon(home) if home is not None else loaded.home


def _names(features: str) -> list[str]:
    names = [name.strip() for name in features.split(",") if name.strip()]
    if not names:
        raise typer.BadParameter("no feature set named: learned, sift, orb, or some of them")
    return list(dict.fromkeys(names))


def _zooms(levels: str | None) -> tuple[int, ...] | None:
    if levels is None:
        return None
    try:
        return tuple(int(level) for level in levels.split(","))
    except ValueError:
        raise typer.BadParameter(f"expected zoom levels such as 19,18,17, got {levels}") from None


def _now_utc() -> str:
    from datetime import UTC, datetime

    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def _description(pack: "MapPack") -> dict[str, Any]:
    south, west, north, east = pack.bounds
    return {
        "path": str(pack.path),
        "name": pack.name,
        "attribution": pack.attribution,
        "bytes": pack.path.stat().st_size,
        "south_deg": south,
        "west_deg": west,
        "north_deg": north,
        "east_deg": east,
        "levels": [
            {
                "zoom": level.zoom,
                "m_per_px": round(level.m_per_px, 4),
                "tiles": pack.tile_count(level.zoom),
            }
            for level in pack.levels
        ],
        "features": [
            {
                "name": info.name,
                "feature_set_id": info.feature_set_id,
                "keypoints": pack.keypoint_count(info.name),
            }
            for info in pack.feature_sets
        ],
        "georeference_sigma_m": pack.georeference_sigma_m,
        "georeference_basis": pack.georeference_basis,
        "heights": pack.heights is not None,
        "sources": list(pack.sources),
        "created_utc": pack.created_utc,
    }


def _print_description(pack: "MapPack") -> None:
    from vwnav.geometry.geodesy import horizontal_distance_m

    south, west, north, east = pack.bounds
    height_m = horizontal_distance_m(south, west, north, west)
    width_m = horizontal_distance_m(south, west, south, east)
    known = "" if pack.georeference_basis is None else f", {pack.georeference_basis}"
    lines = [
        f"{pack.path}: {pack.name}, {pack.path.stat().st_size / 1e6:.1f} MB",
        f"  covers    {south:.6f} to {north:.6f} N, {west:.6f} to {east:.6f} E "
        f"({width_m:.0f} x {height_m:.0f} m), "
        f"good to {pack.georeference_sigma_m:g} m (1 sigma{known})",
    ]
    lines += [
        f"  level {level.zoom}  {level.m_per_px:.3f} m/px, {pack.tile_count(level.zoom)} tiles"
        for level in pack.levels
    ]
    lines += [
        f"  {info.name:8}  {pack.keypoint_count(info.name)} keypoints ({info.feature_set_id})"
        for info in pack.feature_sets
    ]
    lines.append(f"  heights   {'yes' if pack.heights is not None else 'none'}")
    lines.append(f"  made      {pack.created_utc or 'at an unknown time'} of {_few(pack.sources)}")
    if pack.attribution:
        lines.append(f"  imagery   {pack.attribution}")
    typer.echo("\n".join(lines))


def _few(names: tuple[str, ...]) -> str:
    shown = ", ".join(names[:3])
    return shown if len(names) <= 3 else f"{shown} and {len(names) - 3} more"


def _lowest(clearance: "RouteClearance", lowest_m: float) -> dict[str, Any]:
    lat_deg, lon_deg = clearance.lat_lon_deg
    return {
        "above_ground_m": round(lowest_m, 1),
        "to_waypoint": clearance.leg or None,
        "lat_deg": lat_deg,
        "lon_deg": lon_deg,
    }


def _check_values(found: "RouteOnMap") -> dict[str, Any]:
    coverage, clearance = found.coverage, found.clearance
    return {
        "ok": coverage.ok and clearance.ok,
        "returns": found.returns,
        "lowest": None if clearance.lowest_m is None else _lowest(clearance, clearance.lowest_m),
        "length_m": round(coverage.length_m, 1),
        "margin_m": coverage.margin_m,
        "uncovered_m": round(coverage.uncovered_m, 1),
        "uncovered": [
            {
                "start_m": round(stretch.start_m, 1),
                "end_m": round(stretch.end_m, 1),
                "start_lat_deg": stretch.start_lat_lon_deg[0],
                "start_lon_deg": stretch.start_lat_lon_deg[1],
                "end_lat_deg": stretch.end_lat_lon_deg[0],
                "end_lon_deg": stretch.end_lat_lon_deg[1],
            }
            for stretch in coverage.uncovered
        ],
    }


def _heights(path: Path, rasters: "list[RasterSource]") -> "HeightGrid":
    from vwnav.errors import MapError
    from vwnav.machine.extras import how_to_install
    from vwnav.maps.build.builder import sources_bounds

    try:
        from vwnav.maps.build.geotiff import read_heights
    except ImportError as error:
        raise MapError(
            f"{path}: reading it needs rasterio; install it: {how_to_install('maps')} ({error})"
        ) from error
    return read_heights(path, sources_bounds(rasters))
