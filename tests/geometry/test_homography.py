import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from vwnav.geometry.homography import (
    estimate_homography,
    grown_homography,
    jacobian_at,
    transform_points,
)
from vwnav.geometry.similarity import estimate_similarity

SIZE_PX = 600.0
seeds = st.integers(0, 2**31)
anything = arrays(
    np.float64,
    st.tuples(st.integers(0, 12), st.just(2)),
    elements=st.one_of(st.floats(-1e6, 1e6), st.sampled_from([0.0, 1.0, np.nan, np.inf])),
)


def similarity(rng: np.random.Generator) -> np.ndarray:
    scale, angle = np.exp(rng.uniform(-0.4, 0.4)), rng.uniform(-np.pi, np.pi)
    a, b = scale * np.cos(angle), scale * np.sin(angle)
    u, v = rng.uniform(-300.0, 300.0, 2)
    return np.array([[a, -b, u], [b, a, v], [0.0, 0.0, 1.0]])


def homography(rng: np.random.Generator) -> np.ndarray:
    return similarity(rng) @ np.array([[1, 0, 0], [0, 1, 0], [*rng.uniform(-4e-4, 4e-4, 2), 1]])


def pairs(
    rng: np.random.Generator, H: np.ndarray, count: int, inliers: int, noise_px: float = 0.5
) -> tuple[np.ndarray, np.ndarray]:
    uv0 = rng.uniform(0.0, SIZE_PX, (count, 2))
    uv1 = transform_points(H, uv0) + rng.normal(0.0, noise_px, (count, 2))
    wrong = rng.uniform(uv1.min(), uv1.max(), (count - inliers, 2))
    near = np.linalg.norm(wrong - uv1[inliers:], axis=1) < 5.0  # by chance: those would be right
    uv1[inliers:] = np.where(near[:, None], wrong + 20.0, wrong)
    return uv0, uv1


def worst_px(H: np.ndarray, H_true: np.ndarray) -> float:
    corners = np.array([[0, 0], [SIZE_PX, 0], [0, SIZE_PX], [SIZE_PX, SIZE_PX]])
    return float(np.abs(transform_points(H, corners) - transform_points(H_true, corners)).max())


@given(seeds)
def test_homography_is_found_exactly_among_half_outliers(seed: int) -> None:
    rng = np.random.default_rng(seed)
    H = homography(rng)
    fit = estimate_homography(*pairs(rng, H, 120, 60, noise_px=0.0), 1.0, seed)
    assert fit is not None
    assert worst_px(fit.H, H) < 0.01
    assert fit.inliers[:60].all()


@given(seeds)
def test_noisy_homography_is_as_good_as_its_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    H = homography(rng)
    fit = estimate_homography(*pairs(rng, H, 200, 100), 3.0, seed)
    assert fit is not None
    assert worst_px(fit.H, H) < 2.5
    assert fit.count > 90


@given(seeds)
def test_a_homography_grown_out_of_a_similarity_is_as_good_as_a_sampled_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    near = similarity(rng)
    H = near @ np.array([[1, 0, 0], [0, 1, 0], [*rng.uniform(-5e-5, 5e-5, 2), 1]])
    uv0, uv1 = pairs(rng, H, 160, 120)
    grown, sampled = grown_homography(uv0, uv1, near, 3.0), estimate_homography(uv0, uv1, 3.0, seed)
    assert grown is not None
    assert sampled is not None
    assert worst_px(grown.H, H) < 1.5 * worst_px(sampled.H, H) + 0.5
    assert grown.count > 110


@pytest.mark.parametrize("inliers", [5, 7, 10])
def test_similarity_is_found_with_few_inliers_among_a_hundred(inliers: int) -> None:
    found = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        H = similarity(rng)
        uv0, uv1 = pairs(rng, H, 100, inliers)
        fit = estimate_similarity(uv0, uv1, 2.5, seed, scale_bounds=(0.5, 2.0))
        found += fit is not None and worst_px(fit.H, H) < 6.0
    assert found >= {5: 57, 7: 59, 10: 60}[inliers]


@given(seeds)
def test_similarity_is_exact_without_noise_and_keeps_its_form(seed: int) -> None:
    rng = np.random.default_rng(seed)
    H = similarity(rng)
    fit = estimate_similarity(*pairs(rng, H, 300, 40, noise_px=0.0), 1.0, seed)
    assert fit is not None
    assert worst_px(fit.H, H) < 0.2
    assert fit.H[0, 0] == fit.H[1, 1]
    assert fit.H[0, 1] == -fit.H[1, 0]
    np.testing.assert_array_equal(fit.H[2], [0.0, 0.0, 1.0])


@pytest.mark.parametrize("estimate", [estimate_homography, estimate_similarity])
def test_far_from_the_origin_no_digit_is_lost(estimate) -> None:
    rng = np.random.default_rng(3)
    uv0, uv1 = pairs(rng, similarity(rng), 60, 60, noise_px=0.0)
    fit = estimate(uv0, uv1 + 5e7, 1.0, 0)
    np.testing.assert_allclose(transform_points(fit.H, uv0), uv1 + 5e7, atol=0.01, rtol=0)


@pytest.mark.parametrize("estimate", [estimate_homography, estimate_similarity])
def test_the_same_seed_gives_the_same_fit(estimate) -> None:
    rng = np.random.default_rng(5)
    uv0, uv1 = pairs(rng, homography(rng), 300, 90)
    first, second = (estimate(uv0, uv1, 3.0, 17) for _ in range(2))
    np.testing.assert_array_equal(first.H, second.H)
    np.testing.assert_array_equal(first.inliers, second.inliers)


@given(anything, anything, seeds)
def test_any_input_gives_a_finite_fit_or_none(uv0: np.ndarray, uv1: np.ndarray, seed: int) -> None:
    n = min(len(uv0), len(uv1))
    for estimate in (estimate_homography, estimate_similarity):
        fit = estimate(uv0[:n], uv1[:n], 2.0, seed)
        assert fit is None or (np.isfinite(fit.H).all() and fit.inliers.shape == (n,))


@pytest.mark.parametrize("estimate", [estimate_homography, estimate_similarity])
@pytest.mark.parametrize("points", [np.ones((50, 2)), np.zeros((0, 2)), np.full((9, 2), np.nan)])
def test_points_without_extent_give_none(estimate, points: np.ndarray) -> None:
    assert estimate(points, points, 2.0, 0) is None


def test_points_on_a_line_give_no_homography_but_a_similarity() -> None:
    line = np.linspace(0.0, 500.0, 40)[:, None] * [1.0, 0.3]
    assert estimate_homography(line, line + 3.0, 2.0, 0) is None
    assert estimate_similarity(line, line + 3.0, 2.0, 0) is not None


def test_mirrored_points_give_no_homography() -> None:
    uv0 = np.random.default_rng(0).uniform(0.0, SIZE_PX, (60, 2))
    assert estimate_homography(uv0, uv0 * [1.0, -1.0], 1.0, 0) is None


@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_three_pairs_are_too_few_for_a_homography(count: int) -> None:
    uv = np.random.default_rng(0).uniform(0.0, SIZE_PX, (count, 2))
    assert estimate_homography(uv, uv, 2.0, 0) is None


def test_pairs_that_are_not_finite_are_outliers() -> None:
    rng = np.random.default_rng(2)
    H = homography(rng)
    uv0, uv1 = pairs(rng, H, 50, 50)
    uv1[7] = np.nan
    fit = estimate_homography(uv0, uv1, 3.0, 0)
    assert fit is not None
    assert not fit.inliers[7]


def test_unequal_numbers_of_points_are_a_bug_of_the_caller() -> None:
    with pytest.raises(ValueError, match="equal length"):
        estimate_homography(np.zeros((4, 2)), np.zeros((5, 2)), 2.0, 0)


@given(seeds)
def test_jacobian_is_the_difference_quotient(seed: int) -> None:
    rng = np.random.default_rng(seed)
    H, uv = homography(rng), rng.uniform(0.0, SIZE_PX, 2)
    steps = 1e-4 * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
    moved = transform_points(H, uv + steps)
    quotient = np.column_stack([moved[0] - moved[1], moved[2] - moved[3]]) / 2e-4
    np.testing.assert_allclose(jacobian_at(H, uv), quotient, atol=1e-6)
