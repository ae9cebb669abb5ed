"""Routes out of files: QGroundControl plans, Mission Planner's missions, GeoJSON, `ID,X,Y,Z` text.

Heights are above home. What a file says beyond the way to fly (camera triggers, holding times,
speeds) is not flown; what cannot be flown is refused.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from vwnav.errors import RouteError
from vwnav.geometry.geodesy import LocalFrame
from vwnav.guidance import geojson, mission_text, plan_file, route_text
from vwnav.guidance.waypoints import GlobalWaypoint, LocalWaypoint, RouteFields, load_json
from vwnav.types import Array

__all__ = ["GlobalWaypoint", "LocalWaypoint", "Route", "RouteFrame", "load_route"]

RouteFrame = Literal["local", "global"]
MAX_BYTES = 10_000_000
MAX_WAYPOINTS = 10_000


@dataclass(frozen=True, slots=True)
class Route:
    """Waypoints in order.

    Attributes:
        waypoints: at least one, all of one kind.
        home: (lat_deg, lon_deg) where the file says one.
    """

    waypoints: tuple[GlobalWaypoint | LocalWaypoint, ...]
    home: tuple[float, float] | None

    def to_ned(self, frame: LocalFrame, default_height_m: float) -> Array:
        """Waypoints (n, 3) in the frame, whose origin is home on the ground.

        Args:
            frame: of the flight.
            default_height_m: above home, for waypoints without a height.
        """
        return np.array([self._ned(point, frame, default_height_m) for point in self.waypoints])

    @staticmethod
    def _ned(
        point: GlobalWaypoint | LocalWaypoint, frame: LocalFrame, default_height_m: float
    ) -> Array:
        height_m = default_height_m if point.height_m is None else point.height_m
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
    return Route(tuple(fields.waypoints), fields.home)


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
