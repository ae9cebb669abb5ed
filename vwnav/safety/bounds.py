"""Where an aircraft belongs: near its route, the way to it and the way home."""

import math

import numpy as np

from vwnav.types import Array


class RouteBounds:
    """The legs from home over the waypoints and back.

    Args:
        route_ned_m: (n, 3) waypoints.
        home_ne_m: (2,).
    """

    def __init__(self, route_ned_m: Array, home_ne_m: Array) -> None:
        stops = np.vstack([home_ne_m, np.asarray(route_ned_m)[:, :2], home_ne_m])
        self._home_ne_m = np.asarray(home_ne_m)
        self._legs: Array = np.stack([stops[:-1], stops[1:]], axis=1)  # (n + 1, 2, 2)

    def off_route_m(self, position_ned_m: Array) -> float:
        """Horizontal distance from the nearest leg.

        Who is on the way home may be far from all of them: what is asked of him then, he does.
        """
        begin, along = self._legs[:, 0], self._legs[:, 1] - self._legs[:, 0]
        there = position_ned_m[:2] - begin
        squares = np.maximum(np.sum(along * along, axis=1), 1e-9)
        share = np.clip(np.sum(there * along, axis=1) / squares, 0.0, 1.0)
        off = there - share[:, None] * along
        return float(np.sqrt(np.min(np.sum(off * off, axis=1))))

    def off_home_m(self, position_ned_m: Array) -> float:
        """Horizontal distance from home."""
        return float(np.hypot(*(position_ned_m[:2] - self._home_ne_m)))


class CarriedOff:
    """How much farther it has got since it left the fence, from its route and from home alike.

    Who flies home, whichever way, comes nearer to one of them; who does not is carried off.

    Args:
        fence_m: off the route.
    """

    def __init__(self, fence_m: float) -> None:
        self._fence_m = fence_m
        self.forget()

    def forget(self) -> None:
        """It begins anew: it was within the fence, or somebody else flew it."""
        self._least_m = (math.inf, math.inf)

    def step(self, off_route_m: float, off_home_m: float) -> float:
        """Metres; 0 within the fence."""
        if off_route_m <= self._fence_m:
            self.forget()
            return 0.0
        route_m, home_m = self._least_m
        self._least_m = min(route_m, off_route_m), min(home_m, off_home_m)
        return min(off_route_m - self._least_m[0], off_home_m - self._least_m[1])
