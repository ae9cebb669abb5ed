"""The way that was flown, to go back on: where the map matched once it matches again."""

import numpy as np

from vwnav.types import Array, Estimate

_SPACING_M = 20.0


class FlownWay:
    """Places along the way, horizontally, and how to return along them.

    They grow with the way: 7 kB for each kilometre.
    """

    def __init__(self) -> None:
        self._places: list[Array] = []

    def note(self, estimate: Estimate) -> None:
        """Remember a place, if it is some way from the last one."""
        place = estimate.position_ned_m[:2]
        if not self._places or np.hypot(*(place - self._places[-1])) >= _SPACING_M:
            self._places.append(place.copy())

    def back_ned_m(self, estimate: Estimate, home_ne_m: Array) -> Array:
        """(n, 3) from here back to above home, at the height of the estimate; loops are left out.

        What was flown twice is flown back once: from each place the earliest that is near.
        """
        places = np.array([home_ne_m, *self._places])
        stops, i = [], len(places)
        here = estimate.position_ned_m[:2]
        while i > 0:
            near = np.hypot(*(places[:i] - here).T) <= 1.5 * _SPACING_M
            i = int(near.argmax()) if near.any() else i - 1
            here = places[i]
            stops.append(here)
        down = np.full((len(stops), 1), estimate.position_ned_m[2])
        return np.hstack([np.array(stops), down])
