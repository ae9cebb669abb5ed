"""Waypoints, and the checks that every kind of route file shares."""

import json
import math
from dataclasses import dataclass
from typing import Any

from vwnav.errors import RouteError

MIN_HEIGHT_M, MAX_HEIGHT_M = 2.0, 1000.0
MAX_OFFSET_M = 100_000.0


@dataclass(frozen=True, slots=True)
class GlobalWaypoint:
    """A waypoint on the globe.

    Attributes:
        lat_deg, lon_deg: where it is.
        height_m: above home; None where the file says none, or counts from sea level.
        alt_amsl_m: above mean sea level, where the file counts from there.
    """

    lat_deg: float
    lon_deg: float
    height_m: float | None
    alt_amsl_m: float | None = None

    def __post_init__(self) -> None:
        if not (abs(self.lat_deg) <= 90.0 and abs(self.lon_deg) <= 180.0):
            raise RouteError(
                f"latitude {self.lat_deg:g}, longitude {self.lon_deg:g} is not on the globe"
            )
        check_height(self.height_m)


@dataclass(frozen=True, slots=True)
class LocalWaypoint:
    """A waypoint in metres from home; `height_m` above it."""

    north_m: float
    east_m: float
    height_m: float | None

    def __post_init__(self) -> None:
        if not max(abs(self.north_m), abs(self.east_m)) <= MAX_OFFSET_M:
            raise RouteError(
                f"waypoint {self.north_m:g} m north, {self.east_m:g} m east is over 100 km from "
                "home; a local route counts from there"
            )
        check_height(self.height_m)


@dataclass(frozen=True, slots=True)
class RouteFields:
    """What a file said; `home_amsl_m` is the ground at its home, above mean sea level."""

    waypoints: list[GlobalWaypoint | LocalWaypoint]
    home: tuple[float, float] | None = None
    home_amsl_m: float | None = None


def number(value: Any, what: str) -> float:
    """A finite number.

    Raises:
        RouteError: it is none.
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise RouteError(f"{what} is {_short(value)}, expected a number")
    try:
        finite = float(value)
    except OverflowError:
        finite = math.inf
    if not math.isfinite(finite):
        raise RouteError(f"{what} is {_short(value)}, expected a finite number")
    return finite


def read_number(text: str, what: str) -> float:
    """A finite number that is written in a text.

    Raises:
        RouteError: it is none.
    """
    try:
        value = float(text)
    except ValueError:
        raise RouteError(f"{what} is {text[:40]!r}, expected a number") from None
    return number(value, what)


def load_json(text: str) -> Any:
    """Content of a JSON file.

    Raises:
        RouteError: it is not JSON.
    """
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise RouteError(f"damaged file, not JSON ({_short(str(error))})") from error


def check_height(height_m: float | None) -> None:
    """Refuse what nobody flies.

    Raises:
        RouteError: a height above home that is too low or too high.
    """
    if height_m is not None and not MIN_HEIGHT_M <= height_m <= MAX_HEIGHT_M:
        raise RouteError(
            f"height {height_m:g} m above home; expected {MIN_HEIGHT_M:g} to {MAX_HEIGHT_M:g} m"
        )


def _short(value: Any) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:57]}..."
