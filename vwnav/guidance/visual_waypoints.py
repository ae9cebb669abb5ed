"""Visual waypoints: a place is reached when enough of the map's features around it are seen.

Thesis, section 3.3: a waypoint is features of the map with their places; the vehicle has arrived
when N of those within the radius R are matched.
"""

from dataclasses import dataclass

import numpy as np

from vwnav.types import Array


@dataclass(frozen=True, slots=True, kw_only=True)
class VisualWaypointConfig:
    """When a visual waypoint is reached.

    Attributes:
        radius_m: R, of the region around the waypoint.
        min_matches: N, features matched within it.
    """

    radius_m: float = 10.0
    min_matches: int = 8

    def __post_init__(self) -> None:
        if not 0.0 < self.radius_m < float("inf") or self.min_matches < 1:
            raise ValueError(
                f"expected a radius and a number of matches, got {self.radius_m} m and "
                f"{self.min_matches}"
            )


class VisualWaypoints:
    """Goes through waypoints in order as their surroundings are recognised.

    Args:
        waypoints_ne_m: (n, 2) places on the map, north and east in the frame of the run.
        config: radius and number of matches.
    """

    def __init__(self, waypoints_ne_m: Array, config: VisualWaypointConfig) -> None:
        waypoints = np.array(waypoints_ne_m, dtype=np.float64)
        if waypoints.ndim != 2 or waypoints.shape[1] != 2 or not np.all(np.isfinite(waypoints)):
            raise ValueError(f"expected finite waypoints (n, 2), got {waypoints.shape}")
        self._waypoints_ne_m = waypoints
        self._config = config
        self.next_index = 0

    @property
    def done(self) -> bool:
        """All waypoints have been reached."""
        return self.next_index == len(self._waypoints_ne_m)

    def step(self, matched_ne_m: Array) -> tuple[int, ...]:
        """Waypoints reached with one image, in order; empty most of the time.

        Args:
            matched_ne_m: (m, 2) places on the map of the features that this image matched and
                that its homography confirmed.
        """
        first = self.next_index
        while not self.done and self._seen(self._waypoints_ne_m[self.next_index], matched_ne_m):
            self.next_index += 1
        return tuple(range(first, self.next_index))

    def _seen(self, waypoint_ne_m: Array, matched_ne_m: Array) -> bool:
        distance_m = np.hypot(*(np.reshape(matched_ne_m, (-1, 2)) - waypoint_ne_m).T)
        near = np.count_nonzero(distance_m <= self._config.radius_m)
        return bool(near >= self._config.min_matches)
