import numpy as np
import pytest
from bench_scenes import features

from vwnav.bench.features.repeatability import repeatability
from vwnav.bench.features.scenes import ReferenceMap
from vwnav.types import Features

SIDE = 400
MAP = ReferenceMap(
    np.zeros((SIDE, SIDE), np.uint8), np.ones((SIDE, SIDE), np.bool_), 1000, 1.0, "px"
)
SAME = np.eye(3)


def anywhere(count: int, seed: int, side: float = SIDE, off_px: float = 0.0) -> Features:
    return features(np.random.default_rng(seed).uniform(0, side, (count, 2)) + off_px)


def test_keypoints_anywhere_are_at_chance():
    found = repeatability(anywhere(1000, 0), anywhere(1000, 1), SAME, MAP)
    # 1000 discs of 3 px on 400 x 400
    assert found.by_chance == pytest.approx(1 - np.exp(-1000 * np.pi * 9 / SIDE**2), abs=0.01)
    assert found.above_chance == pytest.approx(0.0, abs=0.04)


def test_the_same_keypoints_are_all_repeated():
    found = repeatability(anywhere(500, 0), anywhere(500, 0, off_px=1.0), SAME, MAP)
    assert found.repeated == 1.0
    assert found.above_chance > 0.8


def test_clustered_keypoints_do_not_pass_for_repeated_ones():
    # Both images have theirs in one corner, unrelated within it: shifted by 20 px they still do.
    found = repeatability(anywhere(1000, 0, SIDE / 4), anywhere(1000, 1, SIDE / 4), SAME, MAP)
    assert found.repeated > 0.9
    assert found.above_chance < 0.45


def test_what_the_map_does_not_show_does_not_count():
    half = ReferenceMap(MAP.gray, MAP.mask.copy(), 1000, 1.0, "px")
    half.mask[:, : SIDE // 2] = False
    found = repeatability(anywhere(500, 0), anywhere(500, 0), SAME, half)
    assert found.repeated == 1.0


@pytest.mark.parametrize(("count0", "count1"), [(0, 5), (5, 0)])
def test_without_keypoints_there_is_no_number(count0, count1):
    assert repeatability(anywhere(count0, 0), anywhere(count1, 1), SAME, MAP) is None
