import numpy as np
import pytest
from bench_scenes import features, fixed, scene

from vwnav.bench.features.methods import FeatureSet, Method
from vwnav.bench.features.scenes import ReferenceMap
from vwnav.bench.features.scoring import (
    Judge,
    area_under_curve,
    map_features,
    masked_features,
    score,
)
from vwnav.geometry.homography import transform_points

TURN = np.array([[0.98, -0.15, 9.0], [0.15, 0.98, -7.0], [0.0, 0.0, 1.0]])


def places(count: int = 60) -> np.ndarray:
    return np.random.default_rng(1).uniform(10, 110, (count, 2))


def outcome(H_1_0, uv0, uv1, **kwargs):
    there, here = features(uv1), features(uv0)
    return next(Judge([fixed("drawn", there, here)]).judge(scene(H_1_0, **kwargs)))


def test_area_under_curve_by_hand():
    # Errors 1 and 3 of four: the curve rises to 1/4 at 1 and to 2/4 at 3, then stays.
    errors = np.array([3.0, 1.0, np.inf, 9.0])
    by_hand = (0.5 * 1 * 0.25) + 2 * (0.25 + 0.5) / 2 + 2 * 0.5
    assert area_under_curve(errors, 5.0) == pytest.approx(by_hand / 5.0)


def test_area_under_curve_is_one_without_errors_and_zero_with_nothing_found():
    assert area_under_curve(np.zeros(3), 1.0) == pytest.approx(1.0)
    assert area_under_curve(np.full(3, np.inf), 5.0) == 0.0


def test_right_matches_give_the_true_homography_and_place():
    found = outcome(np.eye(3), places(), places())
    assert found.right.all()
    assert found.corner_error_px == pytest.approx(0.0, abs=1e-3)
    assert found.place_error == pytest.approx(0.0, abs=1e-3)
    assert found.repeated == 1.0


def test_a_place_is_off_by_what_the_map_is_off():
    found = outcome(None, places(), places() + np.array([4.0, 3.0]), unit_per_px=0.3)
    assert found.place_error == pytest.approx(0.3 * 5.0, abs=1e-3)
    assert found.right.all()  # they agree with each other
    assert found.corner_error_px is None


def test_without_a_label_right_matches_say_what_repeats():
    # The feature set is asked for the map, the image, and the map and the image of 1000.
    found = outcome(None, places(), places() + np.array([1.0, 0.5]))
    assert found.repeatable.repeated == 1.0
    assert found.repeatable.above_chance > 0.5


def test_where_nobody_finds_the_place_nothing_is_said_of_repetition():
    assert outcome(None, np.zeros((0, 2)), np.zeros((0, 2))).repeatable is None


def test_a_similarity_is_found_among_wrong_matches():
    uv1 = transform_points(TURN, places())
    uv1[::3] = np.random.default_rng(2).uniform(0, 127, uv1[::3].shape)
    found = outcome(TURN, places(), uv1)
    assert found.right.sum() == pytest.approx(40, abs=1)
    middle = np.full(2, 63.5)
    expected = np.linalg.norm(transform_points(TURN, middle)[0] - middle)
    assert found.place_error == pytest.approx(expected, abs=0.05)


def test_nothing_matched_is_a_result():
    found = outcome(np.eye(3), np.zeros((0, 2)), np.zeros((0, 2)))
    assert np.isinf(found.place_error)
    result = score([found])
    assert (result.inliers, result.precision, result.located_far) == (0.0, 0.0, 0.0)
    assert result.reprojection_px is None
    assert result.auc == {"1_px": 0.0, "3_px": 0.0, "5_px": 0.0}


def test_scores_are_means_over_scenes():
    good = outcome(np.eye(3), places(), places())
    lost = outcome(np.eye(3), np.zeros((0, 2)), np.zeros((0, 2)))
    result = score([good, lost])
    assert (result.scenes, result.inliers, result.located_near) == (2, 30.0, 0.5)
    assert result.precision == 0.5


def test_keypoints_off_the_ground_are_dropped_and_replaced():
    mask = np.ones((96, 96), np.bool_)
    mask[:, :48] = False
    grid = np.stack(np.meshgrid(np.arange(96), np.arange(96)), axis=-1).reshape(-1, 2)
    everywhere = FeatureSet("grid", lambda gray, count: features(grid), [Method("grid")])
    found = masked_features(everywhere, np.zeros((96, 96), np.uint8), mask, 500)
    assert len(found) == 500
    assert found.uv[:, 0].min() >= 48


def test_a_large_map_is_extracted_without_gaps_or_doubles():
    side = 1152  # two blocks
    blank = np.zeros((side, side), np.uint8)
    marks = np.stack(np.meshgrid(np.arange(4, side, 40), np.arange(4, side, 40)), axis=-1)
    for u, v in marks.reshape(-1, 2):
        blank[v, u] = 255

    def bright(gray, count):
        rows, columns = np.nonzero(gray)
        return features(np.stack([columns, rows], axis=1))

    map_ = ReferenceMap(blank, np.ones_like(blank, np.bool_), 1000, 1.0, "px")
    found = map_features(FeatureSet("bright", bright, [Method("bright")]), map_)
    assert {tuple(uv) for uv in found.uv.astype(int)} == {tuple(uv) for uv in marks.reshape(-1, 2)}
    assert len(found) == marks[..., 0].size
