"""Where the aircraft stood: a value of the flight, known once fixes say where that was."""

import numpy as np

from vwnav.types import Array, Estimate

_AGREES_M = 3.0  # a home that was given is right when the way flown from it ends this near


class Home:
    """Counts the way from the take-off until the first fixes tell where its end is.

    Attributes:
        place_ne_m: (2,) about the origin; None while nobody knows.
    """

    def __init__(self, given_ne_m: Array | None) -> None:
        self._given_ne_m = given_ne_m
        self._way_ne_m: Array = np.zeros(2)
        self._settled = False
        self.place_ne_m: Array | None = None

    def flown(self, step_ne_m: Array) -> None:
        """The way (2,) of one tick, without jumps of the position."""
        if not self._settled:
            self._way_ne_m = self._way_ne_m + step_ne_m

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
        if apart_m <= _AGREES_M:
            self.place_ne_m = self._given_ne_m
            return ""
        return f"the aircraft stood {apart_m:.0f} m from the home that was given: it returns there"
