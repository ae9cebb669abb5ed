"""Routes out of `QGC WPL` mission text, as Mission Planner and MAVProxy save it.

Format: https://mavlink.io/en/file_formats/#mission_plain_text_file. Twelve fields a line: index,
current, frame, command, seven params (latitude, longitude and height last), autocontinue.
"""

from typing import Any

from vwnav.errors import RouteError
from vwnav.guidance import plan_file
from vwnav.guidance.waypoints import RouteFields, read_number

HEADER = "QGC WPL"
_FIELDS = 12
_FRAME, _COMMAND, _PARAMS = 2, 3, slice(4, 11)
_NOT_FLOWN = range(4, 8)  # params before the place, a heading among them
_AMSL_FRAME, _WAYPOINT = 0, 16


def parse(text: str) -> RouteFields:
    """Waypoints in the order of the lines.

    Item 0 is home where it is a waypoint above sea level, as ArduPilot writes it; latitude and
    longitude 0 say that nobody knew it.

    Raises:
        RouteError: naming the line, or the item.
    """
    header, *lines = text.splitlines() or [""]
    if not header.startswith(HEADER):
        raise RouteError(f"the first line is not {HEADER!r} and a version")
    items = [_item(line, index) for index, line in enumerate(lines, start=2) if line.strip()]
    if not items or (items[0]["command"], items[0]["frame"]) != (_WAYPOINT, _AMSL_FRAME):
        return plan_file.route_of(items, None)
    place = items[0]["params"][4:]
    return plan_file.route_of(items[1:], plan_file.home_of(place if any(place[:2]) else None))


def _item(line: str, index: int) -> dict[str, Any]:
    try:
        fields = [_field(part, place) for place, part in enumerate(line.split())]
        if len(fields) != _FIELDS:
            raise RouteError(f"{len(fields)} fields, expected {_FIELDS}")
    except RouteError as error:
        raise RouteError(f"line {index}: {error}") from error
    return {"frame": fields[_FRAME], "command": fields[_COMMAND], "params": fields[_PARAMS]}


def _field(text: str, place: int) -> float | None:
    """A number; None for what is left open: a plan has null there, a PX4's mission nan."""
    if place in _NOT_FLOWN and text.lower() == "nan":
        return None
    return read_number(text, "a field")
