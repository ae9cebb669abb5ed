"""What a run of the filter's benchmark has to answer for."""

import math

import numpy as np

from vwnav.bench.estimator.flown import Run


def worst_sigmas(run: Run) -> float:
    """Of the horizontal error, by the ellipse that was told."""
    return max(
        math.sqrt(error_m @ np.linalg.solve(P[:2, :2], error_m))
        for error_m, P in zip(run.rows.error_ne_m, run.rows.P, strict=True)
    )
