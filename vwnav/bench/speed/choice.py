"""Which setting holds a rate with the best accuracy, and what that costs, in words."""

import math
from collections.abc import Callable, Iterator

from vwnav.bench.speed.accuracy import Accuracy
from vwnav.bench.speed.results import Latency, RealTimeRun, TimedSetting
from vwnav.bench.speed.settings import CAMERA_HZ, Setting, images_apart
from vwnav.vision.features.load import load_features

_HELD = 0.95  # of the rate: the last image's fix comes after the end
_CLEARLY_FASTER = 0.75  # what is not, will not hold it where another did not
_UNKNOWN = Accuracy(0.0, 0.0)


def try_in_real_time(
    rows: list[TimedSetting], target_hz: float, try_it: Callable[[Setting], Latency]
) -> list[RealTimeRun]:
    """The most accurate setting that is fast enough, and less ones until one holds the rate.

    Args:
        rows: all that were timed.
        target_hz: images to be matched to the map a second.
        try_it: what a setting does in real time.
    """
    tried: list[RealTimeRun] = []
    most_ms = math.inf
    for row in ranking(rows, target_hz):
        if row.time.p50_ms > most_ms:
            continue
        latency = try_it(row.setting)
        tried.append(RealTimeRun(timed=row, latency=latency))
        if latency.rate_hz >= _HELD * target_hz:
            break
        most_ms = _CLEARLY_FASTER * row.time.p50_ms
    return tried


def chosen_of(tried: list[RealTimeRun], target_hz: float) -> RealTimeRun | None:
    """The one that held the rate; None where none did."""
    if tried and tried[-1].latency.rate_hz >= _HELD * target_hz:
        return tried[-1]
    return None


def ranking(rows: list[TimedSetting], target_hz: float) -> list[TimedSetting]:
    """Those that are fast enough, the most accurate first; of equals what takes least."""
    within_ms = 1e3 * images_apart(target_hz) / CAMERA_HZ
    fast = [row for row in rows if row.time.p99_ms <= within_ms]
    return sorted(fast, key=_merit, reverse=True)


def _merit(row: TimedSetting) -> tuple[tuple[int, float], float]:
    return (row.accuracy or _UNKNOWN).merit, -row.time.cpu_ms


def described(setting: Setting) -> str:
    """A setting in words."""
    threads = setting.features.threads
    on = f", {threads} threads" if threads > 1 else ""
    return f"{setting.label} at {setting.size}, {setting.keypoints} keypoints{on}"


def words(
    choice: RealTimeRun, rows: list[TimedSetting], target_hz: float, cores: int
) -> Iterator[str]:
    """What was chosen, and what it costs."""
    row, latency = choice.timed, choice.latency
    yield (
        f"{described(row.setting)} holds {target_hz:g} Hz: a step takes {row.time.p50_ms:.0f} ms, "
        f"the slowest {row.time.p99_ms:.0f} ms."
    )
    late = "no fix was found"
    if latency.p50_ms is not None and latency.p99_ms is not None:
        late = (
            f"from exposure to estimate {latency.p50_ms:.0f} ms, 99 % within "
            f"{latency.p99_ms:.0f} ms ({latency.fixes} fixes)"
        )
    yield (
        f"In real time, {latency.seconds:.0f} s long: {latency.rate_hz:.1f} Hz, {late}; "
        f"{latency.cores:.2f} of {cores} cores busy; no gap between estimates over "
        f"{latency.link_gap_ms:.0f} ms."
    )
    yield _cost(row, rows)
    if (option := _map_option(row)) is not None:
        yield f"Its maps are made with `vwnav map build ... {option}`."


def _map_option(row: TimedSetting) -> str | None:
    """What a map is made with for these features; None: those of any map serve."""
    features = row.setting.features
    if features.name != "learned":
        return "--features orb" if features.name == "orb" else None
    if row.feature_set_id == load_features("learned").feature_set_id:
        return None
    return f"--model {features.model}"


def _cost(row: TimedSetting, rows: list[TimedSetting]) -> str:
    if row.accuracy is None:
        return "Nothing is known of its accuracy: these weights were not measured."
    best = max(rows, key=_merit)
    assert best.accuracy is not None
    if best.accuracy.merit <= row.accuracy.merit:
        return f"It costs no accuracy: {_figures(row.accuracy)}, the most of all that were timed."
    return (
        f"What it costs: {_figures(row.accuracy)}. The most accurate, {described(best.setting)}, "
        f"has {_figures(best.accuracy)}, and takes {best.time.p50_ms:.0f} ms, the slowest "
        f"{best.time.p99_ms:.0f} ms."
    )


def _figures(accuracy: Accuracy) -> str:
    return (
        f"{100.0 * accuracy.within_3_m:.0f} % of pictures placed within 3 m, "
        f"{accuracy.inliers:.0f} inliers"
    )
