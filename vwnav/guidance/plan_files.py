"""Routes out of files: QGroundControl plans, Mission Planner's missions, GeoJSON, `ID,X,Y,Z` text.

Heights are above home; those above sea level become so once home is known. What a file says beyond
the way to fly (camera triggers, holding times, speeds) is not flown; what cannot be flown is
refused.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from vwnav.errors import RouteError
from vwnav.geometry.geodesy import LocalFrame, horizontal_distance_m
from vwnav.guidance import geojson, mission_text, plan_file, route_text
from vwnav.guidance.waypoints import (
    GlobalWaypoint,
    LocalWaypoint,
    RouteFields,
    check_height,
    load_json,
)
from vwnav.types import Array

__all__ = [
    "DEFAULT_HEIGHT_M",
    "GlobalWaypoint",
    "LocalWaypoint",
    "Route",
    "RouteFrame",
    "load_route",
]

RouteFrame = Literal["local", "global"]
DEFAULT_HEIGHT_M = 50.0  # of waypoints that say none
MAX_BYTES = 10_000_000
MAX_WAYPOINTS = 10_000
_SAME_GROUND_M = 15.0  # by which maps and planners differ; from the ellipsoid it is 47 m in Europe
_SAME_HOME_M = 10.0  # a home that is written with fewer digits; beyond, the ground may be another


@dataclass(frozen=True, slots=True)
class Route:
    """Waypoints in order.

    Attributes:
        waypoints: at least one, all of one kind.
        home: (lat_deg, lon_deg) where the file says one.
        home_amsl_m: its ground above mean sea level, as the file says.
    """

    waypoints: tuple[GlobalWaypoint | LocalWaypoint, ...]
    home: tuple[float, float] | None
    home_amsl_m: float | None = None

    @property
    def about_home(self) -> bool:
        """Its waypoints count in metres from home."""
        return isinstance(self.waypoints[0], LocalWaypoint)

    def ground_amsl_m(
        self, home: tuple[float, float] | None, surveyed_m: float | None
    ) -> float | None:
        """The ground at the flight's home above mean sea level, None where nobody knows.

        Args:
            home: (lat_deg, lon_deg) of the flight, None while it is not known.
            surveyed_m: what a map says of that place; the file knows its own home alone.

        Raises:
            RouteError: both say it, not the same, and there are altitudes above sea level.
        """
        if home is None:
            return None
        own_m = None
        if self.home is not None and horizontal_distance_m(*home, *self.home) <= _SAME_HOME_M:
            own_m = self.home_amsl_m
        if surveyed_m is None or own_m is None:
            return own_m if surveyed_m is None else surveyed_m
        by_sea = any(getattr(each, "alt_amsl_m", None) is not None for each in self.waypoints)
        if by_sea and abs(surveyed_m - own_m) > _SAME_GROUND_M:
            raise RouteError(
                f"the ground at home is {own_m:.0f} m above sea level by the route, "
                f"{surveyed_m:.0f} m by the map (heights above the ellipsoid?): make the route's "
                "altitudes relative, or the map's heights right"
            )
        return surveyed_m

    def lat_lon_deg(self) -> Array:
        """The waypoints (n, 2) in degrees, wherever home is.

        Raises:
            RouteError: they count in metres from there.
        """
        if self.about_home:
            raise RouteError("counts in metres from home; say where with --home LAT,LON")
        places = (each for each in self.waypoints if isinstance(each, GlobalWaypoint))
        return np.array([(each.lat_deg, each.lon_deg) for each in places])

    def to_ned(
        self, frame: LocalFrame, default_height_m: float, home_amsl_m: float | None
    ) -> Array:
        """Waypoints (n, 3) in the frame, whose origin is home on the ground.

        Args:
            frame: of the flight.
            default_height_m: above home, for waypoints without a height.
            home_amsl_m: the ground at home, from which those above sea level are counted.

        Raises:
            RouteError: there are such, and nobody knows the ground at home; or a height above home
                comes out that nobody flies.
        """
        heights_m = [
            default_height_m if height_m is None else height_m
            for height_m in (_above_home_m(point, home_amsl_m) for point in self.waypoints)
        ]
        return np.array(
            [_ned(*each, frame) for each in zip(self.waypoints, heights_m, strict=True)]
        )


def _above_home_m(point: GlobalWaypoint | LocalWaypoint, home_amsl_m: float | None) -> float | None:
    if isinstance(point, LocalWaypoint) or point.alt_amsl_m is None:
        return point.height_m
    if home_amsl_m is None:
        raise RouteError(
            "the route's altitudes are above sea level, and the ground at home is not known: take "
            "a map with heights (vwnav map build --heights) and --home, or the file's own home, "
            "or make them relative"
        )
    height_m = point.alt_amsl_m - home_amsl_m
    check_height(height_m)
    return height_m


def _ned(point: GlobalWaypoint | LocalWaypoint, height_m: float, frame: LocalFrame) -> Array:
    if isinstance(point, LocalWaypoint):
        return np.array([point.north_m, point.east_m, -height_m])
    return frame.to_ned(point.lat_deg, point.lon_deg, frame.alt_amsl_m + height_m)


def load_route(path: Path | str, frame: RouteFrame = "local") -> Route:
    """The route of a `.plan`, `.waypoints`, `.geojson`, `.json`, `.txt` or `.csv` file.

    Args:
        path: the file.
        frame: what the columns of a text file are: "local" for north, east, height above home in
            metres, "global" for latitude, longitude in degrees and height.

    Raises:
        RouteError: the file cannot be read, is of another kind, or its route makes no sense.
    """
    path = Path(path)
    text = _read(path)
    try:
        fields = _parse(path, text, frame)
        if not fields.waypoints:
            raise RouteError("it holds no waypoints")
        if len(fields.waypoints) > MAX_WAYPOINTS:
            raise RouteError(f"more than {MAX_WAYPOINTS} waypoints")
    except RouteError as error:
        raise RouteError(f"{path}: {error}") from error
    return Route(tuple(fields.waypoints), fields.home, fields.home_amsl_m)


def _read(path: Path) -> str:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise RouteError(f"{path}: larger than {MAX_BYTES // 1_000_000} MB, not a route")
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise RouteError(f"{path}: cannot read the route ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise RouteError(
            f"{path}: not a text file; use .plan, .geojson or ID,X,Y,Z text"
        ) from error


def _parse(path: Path, text: str, frame: RouteFrame) -> RouteFields:
    match path.suffix.lower():
        case ".waypoints":
            return mission_text.parse(text)
        case ".txt" if text.startswith(mission_text.HEADER):
            return mission_text.parse(text)
        case ".txt" | ".csv":
            return route_text.parse(text, frame == "global")
        case ".plan":
            return plan_file.parse(load_json(text))
        case ".geojson":
            return geojson.parse(load_json(text))
        case ".json":
            content: Any = load_json(text)
            is_plan = isinstance(content, dict) and content.get("fileType") == "Plan"
            return plan_file.parse(content) if is_plan else geojson.parse(content)
        case suffix:
            raise RouteError(
                f"unknown kind of route {suffix!r}; use .plan, .waypoints, .geojson, .txt or .csv"
            )
