"""Where an aircraft belongs: near its route, the way to it and the way home."""

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
