"""Places by correlation alone: what is there is found, and what is not there is not."""

import cv2
import numpy as np
import pytest
from vision_scenes import texture

from vwnav.vision.correlation import Peak, best_shift, decades_of_shift

REACH_PX = 30
VIEW_HW = (107, 142)  # of a camera of 80 degrees 25 m up, 0.3 m/px
MIN_DECADES = 5.0


def piece(ground: np.ndarray, row: int, column: int, border_px: int = 0) -> np.ndarray:
    rows = slice(row - border_px, row + VIEW_HW[0] + border_px)
    return ground[rows, column - border_px : column + VIEW_HW[1] + border_px]


def shift(view: np.ndarray, map_: np.ndarray) -> Peak:
    seen, known = np.ones(view.shape, np.bool_), np.ones(map_.shape, np.bool_)
    peak = best_shift(view, seen, map_, known, REACH_PX)
    assert peak is not None
    return peak


def test_a_view_is_found_where_it_was_cut_though_its_tones_are_others():
    ground = texture(3)
    rng = np.random.default_rng(0)
    for row, column in rng.integers(100, 500, (10, 2)).tolist():
        moved = np.float32([[1, 0, -7.5], [0, 1, 12.25]])
        view = cv2.warpAffine(piece(ground, row, column, 40), moved, None)[40:-40, 40:-40]
        peak = shift(255 - view, piece(ground, row, column, REACH_PX))
        assert peak.shift_uv == pytest.approx([7.5, -12.25], abs=0.3)
        assert decades_of_shift(peak.sigmas, REACH_PX) > MIN_DECADES


def test_unrelated_ground_never_stands_out():
    rng = np.random.default_rng(1)
    grounds = [texture(seed) for seed in (4, 5)]
    for _ in range(60):
        (r0, c0), (r1, c1) = rng.integers(100, 500, (2, 2)).tolist()
        peak = shift(piece(grounds[0], r0, c0), piece(grounds[1], r1, c1, REACH_PX))
        assert decades_of_shift(peak.sigmas, REACH_PX) < MIN_DECADES


def test_ground_that_repeats_itself_has_a_rival():
    ground = np.tile(texture(6)[:20, :20], (30, 30))
    peak = shift(piece(ground, 200, 200), piece(ground, 200, 200, REACH_PX))
    assert peak.rival_sigmas > 0.9 * peak.sigmas


def test_more_shifts_give_chance_more_to_choose_from():
    assert decades_of_shift(8.0, 60) < decades_of_shift(8.0, REACH_PX) - 0.5


def test_what_the_map_does_not_know_is_not_compared():
    ground = texture(7)
    map_ = piece(ground, 200, 200, REACH_PX)
    known = np.ones(map_.shape, np.bool_)
    known[:, : map_.shape[1] // 2] = False
    seen = np.ones(VIEW_HW, np.bool_)
    assert best_shift(piece(ground, 200, 200), seen, map_, known, REACH_PX) is None
