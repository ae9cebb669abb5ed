"""How long extraction and matching take: one thread, one image, all feature sets in turn."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from vwnav.bench.features.methods import OPENCV_SIFT, XFEAT, FeatureSet
from vwnav.types import Gray

SIZES_WH = ((320, 320), (640, 480))
KEYPOINTS = 1000
REPEATS = 50
_WARM_UP = 3
_T = TypeVar("_T")


@dataclass(frozen=True, slots=True, kw_only=True)
class Times:
    """Medians of one feature set on one image, and its extraction against two others'."""

    extract_ms: float
    extract_cpu_ms: float
    match_ms: float
    match_cpu_ms: float
    extract_cpu_to_sift: float | None
    extract_cpu_to_xfeat: float | None


def measure(
    sets: list[FeatureSet], image: Gray, other: Gray, repeats: int = REPEATS
) -> dict[str, Times]:
    """Time every set `repeats` times, round by round, so that all meet the same machine.

    Args:
        sets: matched by their first method.
        image: (h, w) what is extracted.
        other: an image that overlaps it, extracted before, to be matched with it.
        repeats: rounds; the first few more are not counted.
    """
    reference = {each.name: each.extract(other, KEYPOINTS) for each in sets}
    samples: dict[str, list[tuple[float, float, float, float]]] = {each.name: [] for each in sets}
    for turn in range(_WARM_UP + repeats):
        for each in sets:
            found, extract_ms = _timed(lambda: each.extract(image, KEYPOINTS))  # noqa: B023
            match, map_ = each.methods[0].match, reference[each.name]
            _, match_ms = _timed(lambda: match(found, map_))  # noqa: B023
            if turn >= _WARM_UP:
                samples[each.name].append((*extract_ms, *match_ms))
    medians = {name: np.median(values, axis=0) for name, values in samples.items()}

    def ratio(name: str, to: str) -> float | None:
        return float(medians[name][1] / medians[to][1]) if to in medians else None

    return {
        name: Times(
            extract_ms=float(values[0]),
            extract_cpu_ms=float(values[1]),
            match_ms=float(values[2]),
            match_cpu_ms=float(values[3]),
            extract_cpu_to_sift=ratio(name, OPENCV_SIFT),
            extract_cpu_to_xfeat=ratio(name, XFEAT),
        )
        for name, values in medians.items()
    }


def _timed(work: Callable[[], _T]) -> tuple[_T, tuple[float, float]]:
    """The result, and milliseconds by the clock and of this process' processor time."""
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    result = work()
    spent_s = time.perf_counter() - wall_s, time.process_time() - cpu_s
    return result, (spent_s[0] * 1e3, spent_s[1] * 1e3)
