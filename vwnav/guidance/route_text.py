"""The thesis' route text: `ID,X,Y,Z` on each line, no header."""

from vwnav.errors import RouteError
from vwnav.guidance.waypoints import GlobalWaypoint, LocalWaypoint, RouteFields, read_number


def parse(text: str, is_global: bool) -> RouteFields:
    """Waypoints in the order of the lines; empty lines are skipped.

    Args:
        text: of the file.
        is_global: X, Y, Z are latitude, longitude, height, else metres north, east, height.

    Raises:
        RouteError: naming the line.
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
    return RouteFields(waypoints)


def _split(line: str) -> tuple[str, float, float, float]:
    parts = [part.strip() for part in line.split(",")]
    if len(parts) != 4 or not parts[0]:
        raise RouteError("expected ID,X,Y,Z")
    x, y, z = (read_number(part, what) for part, what in zip(parts[1:], "XYZ", strict=True))
    return parts[0], x, y, z
