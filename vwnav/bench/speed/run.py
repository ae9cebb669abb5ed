"""`vwnav bench speed`: settings in, times, a choice and a projection out."""

import os
import platform
import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import cv2

from vwnav.bench.speed.choice import choose
from vwnav.bench.speed.ground import TrialGround
from vwnav.bench.speed.latency import measure_latency
from vwnav.bench.speed.projection import projections
from vwnav.bench.speed.results import SpeedReport, Wanted
from vwnav.bench.speed.settings import feature_choices, settings, thread_counts
from vwnav.bench.speed.step import time_settings
from vwnav.errors import VwnavError
from vwnav.onboard.board import check_power_and_heat

Progress = Callable[[str, int, int], None]


def bench_speed(wanted: Wanted, progress: Progress) -> SpeedReport:
    """Time all settings, and the best one that holds the rate in real time.

    Raises:
        ModelError: there is no such model, or it is damaged.
        ConfigError: more threads were asked for than there are cores.
    """
    cv2.setNumThreads(1)  # as in flight
    cores = os.cpu_count() or 1
    choices = feature_choices(wanted.features)
    todo = list(settings(choices, thread_counts(cores, wanted.threads)))
    skipped: list[str] = []
    try:
        projected = list(projections(choices))
    except VwnavError as error:
        projected = []
        skipped.append(f"no projection: {error}")
    before = list(check_power_and_heat())
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        progress("drawing", 0, 1)
        ground = TrialGround(folder, stack)
        progress("drawing", 1, 1)
        rows = list(
            time_settings(
                todo, ground, wanted.repeats, lambda done: progress("settings", done, len(todo))
            )
        )
        chosen = choose(
            rows,
            wanted.target_hz,
            lambda setting: measure_latency(setting, ground, wanted.target_hz, wanted.seconds),
        )
        after = list(check_power_and_heat())
    return SpeedReport(
        wanted=wanted,
        machine=platform.machine(),
        cores=cores,
        rows=rows,
        chosen=chosen,
        projected=projected,
        before=before,
        after=after,
        skipped=skipped,
    )
