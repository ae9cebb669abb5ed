"""Routes out of GeoJSON: one LineString, or Points in order, `lon, lat[, height above home]`.

A MultiLineString of one line is that line: QGIS stores what is drawn on a line layer as such.
"""

from typing import Any, TypeGuard

from vwnav.errors import RouteError
from vwnav.guidance.waypoints import GlobalWaypoint, RouteFields, number


def parse(content: Any) -> RouteFields:
    """Waypoints of all LineStrings and Points, in the order of the file.

    Raises:
        RouteError: it is not GeoJSON, or holds areas or other things that are no way to fly.
    """
    positions = [position for geometry in _geometries(content) for position in _points(geometry)]
    return RouteFields([_waypoint(position) for position in positions])


def _geometries(content: Any) -> list[dict[str, Any]]:
    """Geometries of a collection, a feature, or a bare geometry."""
    if not isinstance(content, dict) or not isinstance(content.get("type"), str):
        raise RouteError("neither a QGroundControl plan nor GeoJSON")
    match content["type"]:
        case "FeatureCollection":
            features = content.get("features")
            if not isinstance(features, list):
                raise RouteError("a FeatureCollection without features")
            return [geometry for feature in features for geometry in _of_feature(feature)]
        case "Feature":
            return _of_feature(content)
        case _:
            return [content]


def _of_feature(feature: Any) -> list[dict[str, Any]]:
    geometry = feature.get("geometry") if isinstance(feature, dict) else None
    if not isinstance(geometry, dict):
        raise RouteError("a feature without geometry")
    return [geometry]


def _points(geometry: dict[str, Any]) -> list[Any]:
    coordinates = geometry.get("coordinates")
    match geometry.get("type"):
        case "Point":
            return [coordinates]
        case "LineString" | "MultiPoint" if isinstance(coordinates, list):
            return coordinates
        case "MultiLineString" if _are_lists(coordinates):
            if len(coordinates) > 1:
                raise RouteError(
                    f"a MultiLineString of {len(coordinates)} lines, and no way between them; "
                    "join them to one line"
                )
            return coordinates[0]
        case kind:
            raise RouteError(f"{str(kind)[:40]!r} is no route; expected a LineString or Points")


def _are_lists(coordinates: Any) -> TypeGuard[list[list[Any]]]:
    is_list = isinstance(coordinates, list) and len(coordinates) > 0
    return is_list and all(isinstance(each, list) for each in coordinates)


def _waypoint(position: Any) -> GlobalWaypoint:
    if not isinstance(position, list) or not 2 <= len(position) <= 3:
        raise RouteError("expected positions of lon, lat and maybe height")
    lon_deg, lat_deg = number(position[0], "longitude"), number(position[1], "latitude")
    height_m = number(position[2], "height") if len(position) == 3 else None
    return GlobalWaypoint(lat_deg, lon_deg, height_m)
