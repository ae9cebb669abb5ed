"""The whole localisation of one image, timed, setting by setting."""

import time
from collections.abc import Callable, Iterator
from itertools import cycle, groupby, islice

import numpy as np

from vwnav.bench.speed.accuracy import accuracy_of
from vwnav.bench.speed.ground import TrialGround
from vwnav.bench.speed.results import StepTime, TimedSetting
from vwnav.bench.speed.settings import Setting
from vwnav.types import FeatureExtractor, MapFix, MatchStats
from vwnav.vision.localizer import Localizer

Say = Callable[[str], None]


def time_settings(
    wanted: list[Setting], ground: TrialGround, repeats: int, say: Say
) -> Iterator[TimedSetting]:
    """Time each setting over `repeats` images. `say` is told which are next."""
    for _, group in groupby(wanted, lambda each: each.features):
        of_features = list(group)
        first = of_features[0]
        say(f"bench: {first.label}, threads: {first.features.threads}")
        extractor = first.load()
        for setting in of_features:
            times = time_step(setting, extractor, ground, repeats)
            name = extractor.feature_set_id
            yield TimedSetting(
                setting=setting, feature_set_id=name, time=times,
                accuracy=accuracy_of(setting, name),
            )  # fmt: skip


def time_step(
    setting: Setting, extractor: FeatureExtractor, ground: TrialGround, repeats: int
) -> StepTime:
    """Locate images one after the other; the first time of each, which allocates, not counted."""
    pack = ground.pack(extractor)
    sights = ground.sights(ground.agl_m(pack.levels[0].m_per_px, setting.size_wh))
    localizer = Localizer(pack, extractor, ground.camera, setting.localizer)
    spent_s: list[tuple[float, float]] = []
    stats: list[MatchStats] = []
    placed = 0
    for turn, sight in enumerate(islice(cycle(sights), len(sights) + repeats)):
        start_s, cpu_s = time.perf_counter(), time.process_time()
        outcome = localizer.localize(sight.frame, sight.prior, sight.frame.index)
        if turn >= len(sights):
            spent_s.append((time.perf_counter() - start_s, time.process_time() - cpu_s))
            stats.append(outcome.stats)
            placed += isinstance(outcome, MapFix)
    wall_ms, cpu_ms = 1e3 * np.array(spent_s).T

    def stage_ms(name: str) -> float:
        return float(np.median([getattr(each, name) for each in stats]))

    return StepTime(
        p50_ms=float(np.median(wall_ms)),
        p99_ms=float(np.quantile(wall_ms, 0.99, method="higher")),
        cpu_ms=float(cpu_ms.mean()),
        rectify_ms=stage_ms("rectify_ms"),
        extract_ms=stage_ms("extract_ms"),
        match_ms=stage_ms("match_ms"),
        verify_ms=stage_ms("verify_ms"),
        placed=placed / repeats,
    )
