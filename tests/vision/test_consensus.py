import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.vision.consensus import SimilarityBounds, vote

WIDE = SimilarityBounds(1.3, math.radians(20.0))
MIDDLE = np.array([160.0, 120.0])


def matches(seed: int, right: int, wrong: int, scale: float, turn_rad: float):
    """Matches of which some fit a similarity to half a pixel, and where the middle goes."""
    rng = np.random.default_rng(seed)
    uv_view = rng.uniform(0, [320, 240], (right + wrong, 2))
    c, s = scale * math.cos(turn_rad), scale * math.sin(turn_rad)
    center = rng.uniform(200, 600, 2)
    uv_map = (uv_view - MIDDLE) @ np.array([[c, s], [-s, c]]) + center
    uv_map += rng.normal(0, 0.5, uv_map.shape)
    uv_map[right:] = rng.uniform(0, 800, (wrong, 2))
    return uv_view, uv_map, center


@given(
    seed=st.integers(0, 10_000),
    scale=st.floats(0.85, 1.2),
    turn_deg=st.floats(-17, 17),
    wrong=st.integers(0, 300),
)
def test_twenty_right_matches_are_found_among_many_wrong_ones(seed, scale, turn_deg, wrong):
    uv_view, uv_map, center = matches(seed, 20, wrong, scale, math.radians(turn_deg))
    best = vote(uv_view, uv_map, MIDDLE, WIDE, 3.0, 0)[0]
    assert np.linalg.norm(best.center_uv - center) < 2.0
    assert np.count_nonzero(best.near[:20]) >= 18


def test_what_the_prior_excludes_is_not_voted_for():
    uv_view, uv_map, _ = matches(1, 40, 0, 1.0, math.radians(40.0))
    assert all(each.count < 10 for each in vote(uv_view, uv_map, MIDDLE, WIDE, 3.0, 0))


def test_two_places_are_both_voted_for():
    uv_view, uv_map, center = matches(2, 40, 0, 1.0, 0.0)
    uv_map[20:] += [100.0, 0.0]
    best, second = vote(uv_view, uv_map, MIDDLE, WIDE, 3.0, 0)[:2]
    found = sorted([best.center_uv[0], second.center_uv[0]])
    assert found == pytest.approx([center[0], center[0] + 100.0], abs=2.0)
    assert {best.count, second.count} == {20}


def test_votes_are_the_same_every_time():
    uv_view, uv_map, _ = matches(3, 30, 600, 1.0, 0.1)
    first, second = (vote(uv_view, uv_map, MIDDLE, WIDE, 3.0, 7) for _ in range(2))
    assert [c.H_map_view.tolist() for c in first] == [c.H_map_view.tolist() for c in second]


@pytest.mark.parametrize("count", [0, 1, 2])
def test_too_few_matches_vote_for_nothing(count):
    points = np.random.default_rng(0).uniform(0, 99, (count, 2))
    assert vote(points, points, MIDDLE, WIDE, 3.0, 0) == []


def test_matches_in_one_point_vote_for_nothing():
    points = np.full((30, 2), 50.0)
    assert vote(points, points, MIDDLE, WIDE, 3.0, 0) == []
