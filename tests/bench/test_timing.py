import time

import numpy as np
from bench_scenes import features, fixed, ground, scene

from vwnav.bench.features.figures import draw
from vwnav.bench.features.methods import OPENCV_SIFT, FeatureSet, Method
from vwnav.bench.features.scoring import Judge
from vwnav.bench.features.thesis import thesis_rows
from vwnav.bench.features.timing import measure

IMAGE = ground(64, 64)[:, :, 0]


def slow(name: str, spent_s: float) -> FeatureSet:
    def extract(gray, count):
        # of this thread: others of the process may be busy at the same time
        end_s = time.thread_time() + spent_s
        while time.thread_time() < end_s:
            pass
        return features(np.random.default_rng(0).uniform(0, 60, (20, 2)))

    # Matched without a product of matrices: its library's threads would spin beside what is timed.
    return FeatureSet(name, extract, [Method(name, lambda *_: np.zeros((0, 2), np.int64))])


def wait_for_other_threads():
    """Libraries' threads spin for a while after the tests before; the process counts their time."""
    for _ in range(100):
        before_s = time.process_time()
        time.sleep(0.05)
        if time.process_time() - before_s < 0.002:
            return


def test_times_are_given_against_sift():
    wait_for_other_threads()
    times = measure([slow("quick", 0.002), slow(OPENCV_SIFT, 0.008)], IMAGE, IMAGE, repeats=5)
    assert times[OPENCV_SIFT].extract_cpu_to_sift == 1.0
    assert 0.15 < times["quick"].extract_cpu_to_sift < 0.5
    assert times["quick"].extract_cpu_to_xfeat is None
    assert times["quick"].extract_ms >= 2.0


def test_thesis_rows_count_what_is_left_after_outlier_rejection():
    uv = np.random.default_rng(1).uniform(10, 110, (80, 2))
    wrong = uv.copy()
    wrong[:20] = np.random.default_rng(2).uniform(10, 110, (20, 2))
    row = thesis_rows([fixed("drawn", features(uv), features(wrong))], [scene(None)])["drawn"]
    assert row.points_per_image == 80
    assert 60 <= row.matched_per_image <= 63
    assert row.match_ratio == row.matched_per_image / 80
    assert row.match_ms >= row.extract_ms


def test_a_drawing_shows_right_matches_in_green_and_says_how_many():
    uv = np.random.default_rng(1).uniform(10, 110, (30, 2))
    judge = Judge([fixed("drawn", features(uv), features(uv))])
    (found,) = judge.judge(scene(np.eye(3)))
    canvas = draw(found).astype(int)
    green = (canvas[..., 1] > canvas[..., 2] + 80) & (canvas[..., 1] > canvas[..., 0] + 80)
    assert green.sum() > 1000
    assert canvas[:30].max() > 200  # the title
