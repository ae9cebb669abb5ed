import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from vwnav.vision.matching import _log10_tail, log10_nfa, occupied_cells


@given(n=st.integers(3, 90), k=st.integers(1, 90), p=st.floats(1e-3, 0.2))
def test_the_tail_is_that_of_the_binomial_distribution(n, k, p):
    if n * p < k <= n:
        expected = stats.binom.logsf(k - 1, n, p) / np.log(10.0)
        assert _log10_tail(n, k, p) == pytest.approx(expected, rel=1e-6, abs=1e-9)


def agreement(seed: int, right: int, wrong: int):
    rng = np.random.default_rng(seed)
    uv_view = rng.uniform(0, 300, (right + wrong, 2))
    uv_map = uv_view + rng.normal(0, 1.0, uv_view.shape)
    uv_map[right:] = rng.uniform(-150, 450, (wrong, 2))
    agree = np.linalg.norm(uv_map - uv_view, axis=1) < 3.0
    return log10_nfa(np.eye(3), uv_view, uv_map, agree, 3.0)


def test_unrelated_matches_are_never_significant():
    assert min(agreement(seed, 0, 200) for seed in range(200)) > -3.0


def test_more_right_matches_are_more_significant():
    values = [agreement(0, right, 200) for right in (6, 12, 24, 48)]
    assert values == sorted(values, reverse=True)
    assert values[-1] < -30.0


def test_matches_of_one_spot_occupy_one_cell():
    uv = np.random.default_rng(0).uniform(16.0, 31.0, (50, 2))
    assert occupied_cells(uv) == 1
    assert occupied_cells(uv * 10.0) > 30
