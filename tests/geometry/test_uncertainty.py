import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.geometry.homography import transform_points
from vwnav.geometry.pose import linearised, regional_covariance, scatter_covariance, with_regions

H_TRUE = np.array([[0.9, -0.2, 30.0], [0.2, 0.9, -12.0], [1e-4, -2e-4, 1.0]])
S_TRUE = np.array([[0.9, -0.2, 30.0], [0.2, 0.9, -12.0], [0.0, 0.0, 1.0]])
AT_UV = np.array([700.0, 100.0])
MIDDLE = np.array([150.0, 150.0])


def homography_covariance(uv0, uv1, H, sigma_px, at_uv):
    fit = linearised(uv0, uv1, H, at_uv, homography=True)
    return None if fit is None else scatter_covariance(fit, sigma_px)


def similarity_covariance(uv0, uv1, H, sigma_px, at_uv):
    fit = linearised(uv0, uv1, H, at_uv, homography=False)
    return None if fit is None else scatter_covariance(fit, sigma_px)


def regional(uv0, uv1, H):
    fit = linearised(uv0, uv1, H, MIDDLE, homography=bool(np.any(H[2, :2])))
    return regional_covariance(fit)


def fit_homography(uv0: np.ndarray, uv1: np.ndarray) -> np.ndarray:
    return cv2.findHomography(uv0, uv1, 0)[0]


def fit_similarity(uv0: np.ndarray, uv1: np.ndarray) -> np.ndarray:
    (x, y), one, zero = uv0.T, np.ones(len(uv0)), np.zeros(len(uv0))
    design = np.vstack([np.column_stack([x, -y, one, zero]), np.column_stack([y, x, zero, one])])
    a, b, u, v = np.linalg.lstsq(design, uv1.T.ravel(), rcond=None)[0]
    return np.array([[a, -b, u], [b, a, v], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize(
    ("H", "fit", "covariance"),
    [
        (H_TRUE, fit_homography, homography_covariance),
        (S_TRUE, fit_similarity, similarity_covariance),
    ],
)
def test_covariance_is_that_of_many_noisy_fits(H, fit, covariance) -> None:
    rng = np.random.default_rng(0)
    uv0 = rng.uniform(0.0, 500.0, (60, 2))
    uv1 = transform_points(H, uv0)
    mapped = np.vstack(
        [
            transform_points(fit(uv0, uv1 + rng.normal(0, 0.7, uv1.shape)), AT_UV)
            for _ in range(1500)
        ]
    )
    expected = np.cov(mapped.T)
    ours = covariance(uv0, uv1, H, 0.7, AT_UV)
    np.testing.assert_allclose(ours, expected, atol=0.12 * np.trace(expected))


@pytest.mark.parametrize("covariance", [homography_covariance, similarity_covariance])
def test_scatter_beyond_the_stated_error_enlarges_the_covariance(covariance) -> None:
    rng = np.random.default_rng(1)
    uv0 = rng.uniform(0.0, 500.0, (200, 2))
    uv1 = transform_points(S_TRUE, uv0)
    calm = covariance(uv0, uv1, S_TRUE, 0.5, AT_UV)
    rough = covariance(uv0, uv1 + rng.normal(0.0, 2.0, uv1.shape), S_TRUE, 0.5, AT_UV)
    assert np.trace(rough) == pytest.approx(16.0 * np.trace(calm), rel=0.25)


def test_points_that_fix_nothing_give_none() -> None:
    line = np.linspace(0.0, 500.0, 40)[:, None] * [1.0, 0.3]
    assert homography_covariance(line, line, np.eye(3), 1.0, AT_UV) is None
    assert similarity_covariance(np.ones((9, 2)), np.ones((9, 2)), np.eye(3), 1.0, AT_UV) is None
    assert homography_covariance(line[:3], line[:3], np.eye(3), 1.0, AT_UV) is None


FITS = [(fit_homography, homography_covariance), (fit_similarity, similarity_covariance)]


def leaning(fit, seed: int, lean_px: float):
    """Pairs whose truth is the identity, half a pixel of noise, a corner shifted; and their fit."""
    rng = np.random.default_rng(seed)
    uv0 = rng.uniform(0.0, 300.0, (120, 2))
    uv1 = uv0 + rng.normal(0.0, 0.5, uv0.shape)
    uv1[(uv0 < 150.0).all(axis=1)] += [lean_px, 0.0]
    return uv0, uv1, fit(uv0, uv1)


@pytest.mark.parametrize(("fit", "covariance"), FITS)
def test_regions_left_out_show_scatter_as_the_fit_does(fit, covariance):
    """Of errors that nothing shares both tell the same, on average."""
    told = []
    for seed in range(60):
        uv0, uv1, H = leaning(fit, seed, 0.0)
        both = (regional(uv0, uv1, H), covariance(uv0, uv1, H, 0.0, MIDDLE))
        told.append([np.trace(each) for each in both])
    of_regions, of_scatter = np.mean(told, axis=0)
    assert 0.6 < of_regions / of_scatter < 2.5


@pytest.mark.parametrize(("fit", "covariance"), FITS)
def test_what_a_region_shares_is_in_the_covariance(fit, covariance):
    """A corner of houses that lean by three pixels moves the fit; its scatter hardly says so."""
    of_scatter, of_both = [], []
    for seed in range(60):
        uv0, uv1, H = leaning(fit, seed, 3.0)
        error = transform_points(H, MIDDLE)[0] - MIDDLE
        scatter = covariance(uv0, uv1, H, 0.0, MIDDLE)
        both = with_regions(scatter, regional(uv0, uv1, H))
        of_scatter.append(error @ np.linalg.solve(scatter, error))
        of_both.append(error @ np.linalg.solve(both, error))
    assert np.mean(of_scatter) > 8.0  # two are honest
    assert np.mean(of_both) < 3.0


@given(st.integers(0, 10_000))
def test_regions_only_ever_enlarge_a_covariance(seed):
    rng = np.random.default_rng(seed)
    one, other = (A @ A.T + 1e-3 * np.eye(2) for A in rng.normal(size=(2, 2, 2)))
    told = with_regions(one, other)
    assert np.linalg.eigvalsh(told - one).min() > -1e-9 * np.trace(told)
    assert np.linalg.eigvalsh(one + other - told).min() > -1e-9 * np.trace(told)
    assert with_regions(one, 1e6 * other) == pytest.approx(1e6 * other, rel=0.2)
