"""Confidence intervals by drawing whole flights anew: samples of one flight hardly differ."""

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

_RESAMPLES = 1000

FlightT = TypeVar("FlightT")


def interval(
    of: Callable[[Sequence[FlightT]], float], flights: Sequence[FlightT]
) -> tuple[float, float] | None:
    """The 95 % interval of a number of several flights (percentile bootstrap); None below two."""
    if len(flights) < 2:
        return None
    rng = np.random.default_rng(0)
    draws = rng.integers(0, len(flights), (_RESAMPLES, len(flights)))
    low, high = np.nanpercentile([of([flights[i] for i in draw]) for draw in draws], (2.5, 97.5))
    return float(low), float(high)
