"""Compares belief with truth after the fact; nothing here reaches the navigator."""

import math
import threading
from dataclasses import dataclass, field

import numpy as np

from vwnav.geometry.geodesy import LocalFrame, horizontal_distance_m
from vwnav.sim.truth_state import TruthState
from vwnav.types import Array, Estimate, MapFix


@dataclass(frozen=True, slots=True)
class ErrorSummary:
    """Horizontal errors in metres."""

    count: int
    mean_m: float
    p95_m: float
    max_m: float


def summarise(errors_m: list[float]) -> ErrorSummary | None:
    """None without errors to summarise."""
    if not errors_m:
        return None
    values = np.asarray(errors_m)
    return ErrorSummary(
        len(values), float(values.mean()), float(np.percentile(values, 95)), float(values.max())
    )


@dataclass
class Score:
    """Collects errors of estimates and fixes during a flight. Thread-safe."""

    local_frame: LocalFrame
    estimate_errors_m: list[float] = field(default_factory=list)
    fix_errors_m: list[float] = field(default_factory=list)
    truth_ned_m: list[Array] = field(default_factory=list)
    last_error_m: float | None = None
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def add_estimate(self, estimate: Estimate, truth: TruthState) -> None:
        """One moment of the flight; before the first fix only the last error is kept."""
        truth_ned = self.local_frame.to_ned(truth.lat_deg, truth.lon_deg, truth.alt_amsl_m)
        error_m = float(np.hypot(*(estimate.position_ned_m[:2] - truth_ned[:2])))
        with self._lock:
            self.last_error_m = error_m
            self.truth_ned_m.append(truth_ned)
            if estimate.t_last_fix_s is not None:
                self.estimate_errors_m.append(error_m)

    def add_fix(self, fix: MapFix, truth: TruthState) -> None:
        """One accepted fix, against the truth at its exposure."""
        error_m = horizontal_distance_m(fix.lat_deg, fix.lon_deg, truth.lat_deg, truth.lon_deg)
        with self._lock:
            self.fix_errors_m.append(float(error_m))

    def path_m(self) -> float:
        """True horizontal length of the flight."""
        track = np.array(self.truth_ned_m)[:, :2] if self.truth_ned_m else np.zeros((1, 2))
        return float(np.hypot(*np.diff(track, axis=0).T).sum()) if len(track) > 1 else 0.0

    def max_distance_from_home_m(self) -> float:
        """How far the aircraft truly went."""
        return max((math.hypot(*ned[:2]) for ned in self.truth_ned_m), default=0.0)
