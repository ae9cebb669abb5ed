"""`vwnav bench speed`: settings in, times, a choice and a projection out."""

import os
import platform
import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import cv2

from vwnav.bench.speed.choice import chosen_of, described, try_in_real_time
from vwnav.bench.speed.ground import TrialGround
from vwnav.bench.speed.latency import measure_latency
from vwnav.bench.speed.projection import projections
from vwnav.bench.speed.results import Latency, SpeedReport, Wanted
from vwnav.bench.speed.settings import Setting, feature_choices, settings, thread_counts
from vwnav.bench.speed.step import time_settings
from vwnav.errors import VwnavError
from vwnav.onboard.board import check_power_and_heat

Say = Callable[[str], None]


def bench_speed(wanted: Wanted, say: Say) -> SpeedReport:
    """Time all settings, and the best one that holds the rate in real time.

    `say` is told what is next. No bar is drawn meanwhile: its thread would be measured too.

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
        say("bench: drawing a place")
        ground = TrialGround(folder, stack)
        rows = list(time_settings(todo, ground, wanted.repeats, say))

        def try_it(setting: Setting) -> Latency:
            say(f"bench: in real time: {described(setting)}")
            return measure_latency(setting, ground, wanted.target_hz, wanted.seconds)

        tried = try_in_real_time(rows, wanted.target_hz, try_it)
        after = list(check_power_and_heat())
    return SpeedReport(
        wanted=wanted,
        machine=platform.machine(),
        cores=cores,
        rows=rows,
        tried=tried,
        chosen=chosen_of(tried, wanted.target_hz),
        projected=projected,
        before=before,
        after=after,
        skipped=skipped,
    )
