"""Positions that follow each other: what both guards of estimates measure by."""

import math
from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np

from vwnav.types import Array, Estimate

_TRACK_S = 1.0


class Track:
    """Positions of the last second: could the next one be of the same aircraft?"""

    def __init__(self, max_speed_m_s: float, max_jump_m: float) -> None:
        self._max_speed_m_s, self._max_jump_m = max_speed_m_s, max_jump_m
        self._points: deque[tuple[float, float, float]] = deque()  # time, north, east

    def excess_m(self, t_s: float, north_m: float, east_m: float) -> float:
        """How much further it is than flight explains, against the oldest and the newest."""
        excess_m = 0.0
        for then_s, then_north_m, then_east_m in (self._points[i] for i in self._ends()):
            moved_m = math.hypot(north_m - then_north_m, east_m - then_east_m)
            excess_m = max(excess_m, moved_m - self._max_speed_m_s * max(t_s - then_s, 0.0))
        return excess_m

    def jumped(self, t_s: float, north_m: float, east_m: float) -> bool:
        """Whether it is further than flight and a correction explain."""
        return self.excess_m(t_s, north_m, east_m) > self._max_jump_m

    def add(self, t_s: float, north_m: float, east_m: float) -> None:
        """One that belongs to it."""
        self._points.append((t_s, north_m, east_m))
        while t_s - self._points[0][0] > _TRACK_S:
            self._points.popleft()

    def silent_s(self, t_s: float) -> float:
        """Since the newest one; 0 before the first."""
        return t_s - self._points[-1][0] if self._points else 0.0

    def velocity_m_s(self) -> tuple[float, float]:
        """North, east, from its ends; zero of a track too short to tell."""
        if not self._points:
            return 0.0, 0.0
        (t0_s, north0_m, east0_m), (t1_s, north1_m, east1_m) = self._points[0], self._points[-1]
        span_s = t1_s - t0_s
        if span_s < 0.2:
            return 0.0, 0.0
        return (north1_m - north0_m) / span_s, (east1_m - east0_m) / span_s

    def clear(self) -> None:
        """Begin anew."""
        self._points.clear()

    def _ends(self) -> tuple[int, ...]:
        return (0, -1) if self._points else ()


@dataclass
class Trial:
    """A lost estimate that is watched until it may come back.

    Attributes:
        since_s: it began; `counter` is its reset counter.
        may_resume: it may go on as the one that was lost.
        fixes_t_s: map fixes from `fixes_from_s` on, since when motions count too; `count` of what
            came.
        before: the one before; `velocity_since_s` since when its velocity has been sure.
    """

    since_s: float
    counter: int
    track: Track
    may_resume: bool
    fixes_from_s: float = math.inf
    fixes_t_s: list[float] = field(default_factory=list)
    count: int = 0
    before: Estimate | None = None
    velocity_since_s: float | None = None


def is_finite(estimate: Estimate) -> bool:
    """Whether all of it are numbers."""
    arrays = (
        estimate.position_ned_m,
        estimate.velocity_ned_m_s,
        estimate.covariance,
        estimate.quat_wxyz,
    )
    return math.isfinite(estimate.t_s) and all(math.isfinite(a.sum()) for a in arrays)


def at_least(estimate: Estimate, sigma_m: float) -> Estimate:
    """With a horizontal position that is no surer than that."""
    if sigma(estimate, 0) >= sigma_m:
        return estimate
    covariance = estimate.covariance.copy()
    covariance[:2, :2] = np.eye(2) * sigma_m**2  # adds what is positive: it stays a covariance
    return replace(estimate, covariance=covariance)


def sigma(estimate: Estimate, first: int) -> float:
    """Larger semi-axis of the horizontal part that begins at `first`: 0 position, 3 velocity.

    NaN, which no bound admits, where the covariance is none.
    """
    (nn, _), (en, ee) = estimate.covariance[first : first + 2, first : first + 2].tolist()
    variance = 0.5 * (nn + ee) + math.hypot(0.5 * (nn - ee), en)
    return math.sqrt(variance) if variance >= 0.0 else math.nan


def tilt_rad(quat_wxyz: Array) -> float:
    """Angle between the body's down axis and the world's: its cosine is 1 - 2 (x^2 + y^2)."""
    w, x, y, z = quat_wxyz.tolist()
    square = w * w + x * x + y * y + z * z
    if square < 0.01:
        return math.nan  # no rotation; no bound admits it
    return math.acos(max(-1.0, min(1.0, 1.0 - 2.0 * (x * x + y * y) / square)))
