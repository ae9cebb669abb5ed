"""How wrong the filter was and how well it knew: RMSE, NEES, NIS with bounds, coverage."""

import math
from dataclasses import dataclass

import numpy as np

from vwnav.bench.estimator.flown import Rows, Run
from vwnav.estimation.events import NedFix
from vwnav.estimation.states import Innovation
from vwnav.types import Array, OdometryMotion

SETTLED_S = 30.0  # after take-off and the first fixes
_Z_95 = 1.959964


@dataclass(frozen=True, slots=True, kw_only=True)
class Consistency:
    """A normalised error squared of `dof` degrees of freedom over many runs.

    Attributes:
        mean: over runs and times; an honest filter has `dof`.
        low, high: two-sided 95 % bounds of the mean over the runs at one time.
        inside: share of the times at which that mean is within them; 0.95 is honest.
        pessimistic, optimistic: share of the times below and above them.
    """

    dof: int
    mean: float
    low: float
    high: float
    inside: float
    pessimistic: float
    optimistic: float


def chi_square_bounds(dof: int, runs: int) -> tuple[float, float]:
    """Two-sided 95 % bounds of the mean of `runs` chi-square values of `dof` (Wilson-Hilferty)."""
    n = dof * runs
    width = _Z_95 * math.sqrt(2.0 / (9.0 * n))
    centre = 1.0 - 2.0 / (9.0 * n)
    return dof * (centre - width) ** 3, dof * (centre + width) ** 3


def consistency(values: Array, dof: int) -> Consistency:
    """Of normalised errors squared (runs, times); NaN where there is none."""
    counts = np.sum(np.isfinite(values), axis=0)
    used = counts >= max(1, len(values) // 2)
    means = np.nanmean(values[:, used], axis=0)
    bounds = np.array([chi_square_bounds(dof, int(n)) for n in counts[used]])
    below, above = means < bounds[:, 0], means > bounds[:, 1]
    low, high = chi_square_bounds(dof, len(values))
    return Consistency(
        dof=dof,
        mean=float(np.nanmean(values[:, used])),
        low=low,
        high=high,
        inside=float(np.mean(~(below | above))),
        pessimistic=float(np.mean(below)),
        optimistic=float(np.mean(above)),
    )


def position_nees(rows: Rows) -> Array:
    """(n,) of north and east."""
    return _quadratic(rows.error_ne_m, rows.P[:, :2, :2])


def velocity_nees(rows: Rows) -> Array:
    """(n,) of the horizontal velocity."""
    return _quadratic(rows.error_v_m_s[:, :2], rows.P[:, 3:5, 3:5])


def _quadratic(errors: Array, covariances: Array) -> Array:
    return np.asarray(
        np.einsum("ni,ni->n", errors, np.linalg.solve(covariances, errors[..., None])[..., 0])
    )


def nis_per_second(run: Run, kind: str) -> Array:
    """(seconds,) NIS of a kind of measurement, the first that was compared in each second."""
    out = np.full(int(run.stream.truth.t_s[-1]) + 1, np.nan)
    for event, answer in run.answers:
        found = _answer_of(event.seen, answer, kind)
        second = int(event.arrival_s)
        if found is None or found.nis is None or second >= len(out):
            continue
        if np.isnan(out[second]):
            out[second] = found.nis
    return out


NIS_DOF = {"fix": 2, "fix yaw": 1, "fix agl": 1, "odometry": 3}


def _answer_of(seen: object, answer: Innovation, kind: str) -> Innovation | None:
    match seen, kind:
        case NedFix(), "fix":
            return answer
        case NedFix(), "fix yaw" if len(answer.parts) == 2:
            return answer.parts[0]
        case NedFix(), "fix agl" if len(answer.parts) == 2:
            return answer.parts[1]
        case OdometryMotion(), "odometry":
            return answer
    return None


def rms(values: Array) -> float:
    """Root mean square; of the lengths where values are vectors."""
    return float(np.sqrt(np.mean(np.sum(np.atleast_2d(values.T) ** 2, axis=0))))
