import math

import numpy as np
import pytest

from vwnav.types import Features
from vwnav.vision.matching import share_alike

SHIFT_PX = np.array([120.0, 30.0])


def features(uv, seed: int, of: np.ndarray | None = None) -> Features:
    """At places (n, 2), with descriptors of their own or, where `of` names them, of others."""
    directions = np.random.default_rng(seed).normal(size=(500, 64)).astype(np.float32)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    named = np.arange(len(uv)) if of is None else of
    return Features(np.asarray(uv, np.float32), directions[named], np.ones(len(uv), np.float32))


def scattered(seed: int, n: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0.0, 400.0, (n, 2))


def likeness(n: int) -> np.ndarray:
    return np.full(n, 0.7, np.float32)


@pytest.mark.parametrize("within_px", [300.0, math.inf])
def test_what_stands_there_twice_is_alike(within_px):
    uv = scattered(0, 60)
    twice = features(np.vstack([uv, uv + SHIFT_PX]), 1, np.tile(np.arange(60), 2))
    assert share_alike(features(uv, 1), likeness(60), twice, within_px) == 1.0


def test_half_of_it_is_half_alike():
    uv = scattered(0, 60)
    half = np.vstack([uv, uv[:30] + SHIFT_PX])
    others = features(half, 1, np.concatenate([np.arange(60), np.arange(30)]))
    assert share_alike(features(uv, 1), likeness(60), others, math.inf) == pytest.approx(
        0.5, abs=0.05
    )


def test_like_things_that_lie_otherwise_are_not_alike():
    uv = scattered(0, 60)
    others = features(np.vstack([uv, scattered(5, 60)]), 1, np.tile(np.arange(60), 2))
    assert share_alike(features(uv, 1), likeness(60), others, math.inf) < 0.15


def test_neither_itself_nor_what_is_too_far_off_counts():
    uv = scattered(0, 60)
    twice = features(np.vstack([uv, uv + SHIFT_PX]), 1, np.tile(np.arange(60), 2))
    assert share_alike(features(uv, 1), likeness(60), twice, 100.0) == 0.0
    assert share_alike(features(uv, 1), likeness(60), features(uv, 1), math.inf) == 0.0


def test_features_that_are_all_alike_by_half_are_not_alike():
    """SIFT's descriptors have no negative values: unrelated ones are alike by half and more."""
    rng = np.random.default_rng(2)
    descriptors = np.sqrt(rng.dirichlet(np.full(128, 0.5), 300)).astype(np.float32)
    uv = rng.uniform(0.0, 60.0, (300, 2)).astype(np.float32)
    everything = Features(uv, descriptors, np.ones(300, np.float32))
    some = Features(uv[:12], descriptors[:12], np.ones(12, np.float32))
    assert share_alike(some, np.full(12, 0.9, np.float32), everything, 30.0) < 0.3
