"""The thesis' route text: `ID,X,Y,Z` on each line, no header."""

import math

from vwnav.errors import RouteError
from vwnav.guidance.waypoints import GlobalWaypoint, LocalWaypoint, RouteFields, read_number

_ONE_PLACE_M = 0.1


def parse(text: str, is_global: bool) -> RouteFields:
    """Waypoints in the order of the lines; empty lines are skipped.

    Metres that lie within a hand's breadth of each other are taken for degrees, and refused: as
    metres, two places 10 km apart would be flown above one point beside home.

    Args:
        text: of the file.
        is_global: X, Y, Z are latitude, longitude, height, else metres north, east, height.

    Raises:
        RouteError: naming the line; or metres that look like degrees.
    """
    waypoints: list[GlobalWaypoint | LocalWaypoint] = []
    names: set[str] = set()
    for index, line in enumerate(text.splitlines(), start=1):
        if not line.strip():
            continue
        try:
            name, x, y, z = _split(line)
            if name in names:
                raise RouteError(f"the ID {name[:40]!r} is there already")
            names.add(name)
            waypoint = GlobalWaypoint(x, y, z) if is_global else LocalWaypoint(x, y, z)
        except RouteError as error:
            raise RouteError(f"line {index}: {error}") from error
        waypoints.append(waypoint)
    places = [(each.north_m, each.east_m) for each in waypoints if isinstance(each, LocalWaypoint)]
    if 0.0 < max((math.dist(places[0], place) for place in places), default=0.0) < _ONE_PLACE_M:
        raise RouteError(
            f"all waypoints within {_ONE_PLACE_M} m of each other, as metres; are these degrees? "
            "then say so (--route-frame global)"
        )
    return RouteFields(waypoints)


def _split(line: str) -> tuple[str, float, float, float]:
    parts = [part.strip() for part in line.split(",")]
    if len(parts) != 4 or not parts[0]:
        raise RouteError("expected ID,X,Y,Z")
    x, y, z = (read_number(part, what) for part, what in zip(parts[1:], "XYZ", strict=True))
    return parts[0], x, y, z
