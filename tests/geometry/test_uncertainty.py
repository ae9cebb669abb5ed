import cv2
import numpy as np
import pytest

from vwnav.geometry.homography import transform_points
from vwnav.geometry.uncertainty import homography_covariance, similarity_covariance

H_TRUE = np.array([[0.9, -0.2, 30.0], [0.2, 0.9, -12.0], [1e-4, -2e-4, 1.0]])
S_TRUE = np.array([[0.9, -0.2, 30.0], [0.2, 0.9, -12.0], [0.0, 0.0, 1.0]])
AT_UV = np.array([700.0, 100.0])


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
