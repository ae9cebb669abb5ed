"""Finds the few things of a landscape that touch a window."""

from collections.abc import Sequence
from typing import Generic, TypeVar

import numpy as np

from vwnav.sim.scenery.noise import NedWindow
from vwnav.types import Array

T = TypeVar("T")


class Index(Generic[T]):
    """Things with the boxes they fill, in their drawing order."""

    def __init__(self, things: Sequence[T], outlines: Sequence[Array], margin_m: float) -> None:
        """Each outline (n, 2) north, east, grown by the margin, encloses its thing."""
        self._things = things
        self._low = np.array([o.min(axis=0) - margin_m for o in outlines]).reshape(-1, 2)
        self._high = np.array([o.max(axis=0) + margin_m for o in outlines]).reshape(-1, 2)

    def near(self, window: NedWindow) -> list[T]:
        """The things whose boxes touch the window."""
        south, west, north, east = window.bounds()
        hit = (self._low < (north, east)).all(axis=1) & (self._high > (south, west)).all(axis=1)
        return [self._things[i] for i in np.flatnonzero(hit).tolist()]
