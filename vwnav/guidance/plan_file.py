"""Routes out of QGroundControl's `.plan` files.

Format: https://docs.qgroundcontrol.com/master/en/qgc-dev-guide/file_formats/plan.html. Command and
frame numbers are MAVLink's MAV_CMD and MAV_FRAME.
"""

import logging
from dataclasses import replace
from itertools import takewhile
from typing import Any

from vwnav.errors import RouteError
from vwnav.guidance.waypoints import GlobalWaypoint, RouteFields, number

_log = logging.getLogger(__name__)
_WAYPOINT, _RETURN, _LAND, _TAKEOFF = 16, 20, 21, 22
_WITHOUT_PLACE = (_TAKEOFF, 80, 93)  # MAV_CMD_NAV_ROI, which is looked at, and NAV_DELAY
_FIRST_COMMAND_WITHOUT_PLACE = 112  # MAV_CMD_CONDITION_DELAY; DO commands come after it
_JUMPS = (177, 601)  # MAV_CMD_DO_JUMP, DO_JUMP_TAG: without them another route would be flown
_AMSL_FRAMES, _HOME_FRAMES = (0, 5), (3, 6)


def parse(content: Any) -> RouteFields:
    """Waypoints of a plan, surveys included.

    Its fence and its rally points are the autopilot's to keep: one that has any is warned of.
    Take-off (straight up from home), delays, conditions, camera and gimbal commands are not places
    and add none; a landing place is flown over at the height before it. With a return the mission
    ends.

    Raises:
        RouteError: it is no plan, or holds items that cannot be flown.
    """
    if not isinstance(content, dict) or content.get("fileType") != "Plan":
        raise RouteError("not a QGroundControl plan (fileType is not Plan)")
    mission = content.get("mission")
    items = mission.get("items") if isinstance(mission, dict) else None
    if not isinstance(mission, dict) or not isinstance(items, list):
        raise RouteError("a plan without mission items")
    home = home_of(mission.get("plannedHomePosition"))
    _tell_what_is_not_kept(content)
    return route_of(_simple_items(items), home)


def route_of(items: list[dict[str, Any]], home: tuple[float, float, float] | None) -> RouteFields:
    """Waypoints of mission items.

    Args:
        items: "command", "frame" and seven "params" of each.
        home: latitude, longitude in degrees, height above sea level in metres.

    Raises:
        RouteError: an item cannot be flown; its number, from 1, is named.
    """
    waypoints: list[GlobalWaypoint] = []
    has_landed = False
    flown = takewhile(lambda item: item.get("command") != _RETURN, items)
    for index, item in enumerate(flown, start=1):
        try:
            waypoint = _waypoint(item, waypoints)
            if waypoint is not None and has_landed:
                raise RouteError("comes after a landing; vwnav lands once, at home: take one out")
        except RouteError as error:
            raise RouteError(f"mission item {index}: {error}") from error
        has_landed = has_landed or item["command"] == _LAND
        if waypoint is not None:
            waypoints.append(waypoint)
    return RouteFields([*waypoints], home[:2] if home else None, home[2] if home else None)


def _tell_what_is_not_kept(content: dict[str, Any]) -> None:
    kinds = (("geoFence", "circles"), ("geoFence", "polygons"), ("rallyPoints", "points"))
    parts = ((content.get(part), kind) for part, kind in kinds)
    if any(isinstance(part, dict) and part.get(kind) for part, kind in parts):
        _log.warning(
            "the plan's geofence and rally points are not kept by vwnav: they are the autopilot's, "
            "if they were uploaded to it"
        )


def home_of(position: Any) -> tuple[float, float, float] | None:
    """Latitude, longitude in degrees, height above sea level in metres; None for None.

    Raises:
        RouteError: it is no place.
    """
    if position is None:
        return None
    if not isinstance(position, list) or len(position) != 3:
        raise RouteError("plannedHomePosition is not lat, lon, altitude")
    lat_deg, lon_deg, alt_amsl_m = (number(value, "home position") for value in position)
    GlobalWaypoint(lat_deg, lon_deg, None)
    return lat_deg, lon_deg, alt_amsl_m


def _simple_items(items: list[Any]) -> list[dict[str, Any]]:
    """All simple items in order, those nested in surveys among them."""
    simple: list[dict[str, Any]] = []
    for item in items:
        kind = item.get("type") if isinstance(item, dict) else None
        if kind == "SimpleItem":
            simple.append(item)
        elif kind == "ComplexItem":
            simple += _nested_items(item)
        else:
            raise RouteError(f"a mission item of unknown type {str(kind)[:40]!r}")
    return simple


def _nested_items(item: dict[str, Any]) -> list[dict[str, Any]]:
    transects = item.get("TransectStyleComplexItem")
    nested = transects.get("Items") if isinstance(transects, dict) else None
    if not isinstance(nested, list) or not all(
        isinstance(one, dict) and one.get("type", "SimpleItem") == "SimpleItem" for one in nested
    ):
        kind = str(item.get("complexItemType"))[:40]
        raise RouteError(f"{kind!r} without its waypoints; expected a survey or corridor scan")
    return nested


def _waypoint(item: dict[str, Any], before: list[GlobalWaypoint]) -> GlobalWaypoint | None:
    """The place of an item, None when it has none."""
    command = number(item.get("command"), "command")
    if command in _JUMPS:
        raise RouteError("a jump back cannot be flown; write the waypoints out")
    if command in _WITHOUT_PLACE or command >= _FIRST_COMMAND_WITHOUT_PLACE:
        return None
    if command not in (_WAYPOINT, _LAND):
        raise RouteError(f"command {command:g} cannot be flown; use plain waypoints")
    params = item.get("params")
    if not isinstance(params, list) or len(params) != 7:
        raise RouteError("expected seven params")
    if command == _LAND and (params[4] or 0, params[5] or 0) == (0, 0):
        return None  # MAVLink: land where you are
    lat_deg, lon_deg = number(params[4], "latitude"), number(params[5], "longitude")
    if command == _LAND and before:
        return replace(before[-1], lat_deg=lat_deg, lon_deg=lon_deg)
    if command == _LAND:
        return GlobalWaypoint(lat_deg, lon_deg, None)
    altitude_m, frame = number(params[6], "height"), item.get("frame")
    if frame in _HOME_FRAMES:
        return GlobalWaypoint(lat_deg, lon_deg, altitude_m)
    if frame in _AMSL_FRAMES:
        return GlobalWaypoint(lat_deg, lon_deg, None, altitude_m)
    raise RouteError(f"altitude frame {str(frame)[:40]} cannot be flown; make it relative")
