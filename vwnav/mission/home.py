"""Where the aircraft stood, known once fixes say where that was; and the way it has flown since."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vwnav.safety.safety_config import SafetyConfig
from vwnav.types import Array, Estimate

_AGREES_M = 3.0  # a home that was given is right when the way flown from it ends this near
_ELSEWHERE_SIGMAS = 2.45  # sqrt(chi2.ppf(0.95, 2)): no nearer can it be told from the one given
_SPACING_M = 20.0


class Home:
    """Counts the way from the take-off until the first fixes tell where its end is.

    It is landed on in the map's frame, which is off from the earth's by more than a pad is wide:
    where the way from it begins is nearer to it, for who lands by that map, than where it was said
    to be. Both are unsure, and weighed by that.

    Args:
        given_ne_m: (2,) about the origin, as a person gave it; None where nobody did.
        given_sigma_m: how well that is known, per axis.

    Attributes:
        place_ne_m: (2,) about the origin; None while nobody knows.
    """

    def __init__(self, given_ne_m: Array | None, given_sigma_m: float) -> None:
        self._given_ne_m, self._given_sigma_m = given_ne_m, given_sigma_m
        self._way_ne_m: Array = np.zeros(2)
        self._way_m2 = 0.0  # its variance
        self._settled = False
        self.place_ne_m: Array | None = None

    def flown(self, step_ne_m: Array, grown_m2: float) -> None:
        """Count the way (2,) of one tick, without jumps of the position.

        `grown_m2` is by what the place's variance per axis has grown; by a fix it shrinks.
        """
        if not self._settled:
            self._way_ne_m = self._way_ne_m + step_ne_m
            self._way_m2 += max(grown_m2, 0.0)

    def take(self, place_ne_m: Array) -> None:
        """It is known for sure."""
        self.place_ne_m, self._settled = place_ne_m, True

    def settle(self, estimate: Estimate) -> str:
        """Fix it by an estimate that fixes have placed; what a person should know of it, if so."""
        if self._settled:
            return ""
        self._settled = True
        stood_ne_m = estimate.position_ned_m[:2] - self._way_ne_m
        self.place_ne_m = stood_ne_m
        if self._given_ne_m is None:
            return "home is where the aircraft stood: known now"
        apart_m = float(np.hypot(*(stood_ne_m - self._given_ne_m)))
        here_m2 = estimate.sigma_horizontal_m**2
        if apart_m <= max(_AGREES_M, _ELSEWHERE_SIGMAS * math.sqrt(self._way_m2 + here_m2)):
            given_m2 = self._given_sigma_m**2 + here_m2  # of where it is to who flies by the map
            share = given_m2 / (given_m2 + self._way_m2)
            self.place_ne_m = self._given_ne_m + share * (stood_ne_m - self._given_ne_m)
            return ""
        return f"the aircraft stood {apart_m:.0f} m from the home that was given: it returns there"


def straight_home_ned_m(here_ned_m: Array, home_ne_m: Array, lowest_m: float) -> Array:
    """(1 or 2, 3) from here to above home, first up where that is lower than `lowest_m`."""
    down_m = min(float(here_ned_m[2]), -lowest_m)
    above_home = np.array([[*home_ne_m, down_m]])
    if down_m == float(here_ned_m[2]):
        return above_home
    return np.vstack([[*here_ned_m[:2], down_m], above_home])


def _nobody_knows(_here_ne_m: Array, _home_ne_m: Array) -> float:
    return -math.inf


@dataclass(frozen=True, slots=True)
class WayHome:
    """How high the straight way home is flown.

    Attributes:
        lowest_m: above home, at least.
        ceiling_m: above home; where the ground asks for more, only who is as high flies straight.
        clears_m: from a place (2,) to home (2,), the height above home that clears the ground in
            between; -inf where nobody knows.
    """

    lowest_m: float = SafetyConfig().way_home_m
    ceiling_m: float = SafetyConfig().ceiling_m
    clears_m: Callable[[Array, Array], float] = _nobody_knows

    @classmethod
    def within(
        cls, safety: SafetyConfig, clears_m: Callable[[Array, Array], float] = _nobody_knows
    ) -> "WayHome":
        """As the settings have it."""
        return cls(safety.way_home_m, safety.ceiling_m, clears_m)

    def straight_ned_m(self, here_ned_m: Array, home_ne_m: Array) -> Array | None:
        """(1 or 2, 3) from here to above home; None where the ground in between is too high."""
        clears_m = self.clears_m(here_ned_m[:2], home_ne_m)
        if clears_m > max(self.ceiling_m, -float(here_ned_m[2])):
            return None
        return straight_home_ned_m(here_ned_m, home_ne_m, max(self.lowest_m, clears_m))

    def after_route_ned_m(self, last_ned_m: Array, home_ne_m: Array) -> Array:
        """The same from the last waypoint; ground that is too high is left to who checks routes."""
        straight_ned_m = self.straight_ned_m(last_ned_m, home_ne_m)
        if straight_ned_m is None:
            return straight_home_ned_m(last_ned_m, home_ne_m, self.lowest_m)
        return straight_ned_m


def from_home_ned_m(route_ned_m: Array, home_ne_m: Array, way_home: WayHome) -> Array:
    """(n + 2 or 3, 3) from above home, where the route's height is reached, over it and back."""
    return np.vstack(
        [
            [*home_ne_m, route_ned_m[0, 2]],
            route_ned_m,
            way_home.after_route_ned_m(route_ned_m[-1], home_ne_m),
        ]
    )


class FlownWay:
    """Places along the way, and how to return along them.

    They grow with the way: 7 kB for each kilometre.
    """

    def __init__(self) -> None:
        self._places: list[Array] = []

    def note(self, estimate: Estimate) -> None:
        """Remember a place, if it is some way from the last one."""
        place = estimate.position_ned_m
        if not self._places or np.hypot(*(place - self._places[-1])[:2]) >= _SPACING_M:
            self._places.append(place.copy())

    def back_ned_m(self, estimate: Estimate, home_ne_m: Array) -> Array:
        """(n, 3) from here back to above home; loops are left out.

        What was flown twice is flown back once: from each place the earliest that is near. No place
        is flown lower than it was, nor than the estimate is: from higher up the map shows more.
        """
        here = estimate.position_ned_m
        first = self._places[0] if self._places else here
        places = np.array([[*home_ne_m, first[2]], *self._places])
        stops, i = [], len(places)
        while i > 0:
            near = np.hypot(*(places[:i] - here)[:, :2].T) <= 1.5 * _SPACING_M
            i = int(near.argmax()) if near.any() else i - 1
            here = places[i]
            stops.append(here)
        way_ned_m = np.array(stops)
        way_ned_m[:, 2] = np.minimum(way_ned_m[:, 2], estimate.position_ned_m[2])
        return way_ned_m
