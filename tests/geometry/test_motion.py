import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.geometry.camera import Camera
from vwnav.geometry.motion import decompose_ground_homography, ground_translation
from vwnav.geometry.rotations import rotation_from_vector

CAMERA = Camera.from_hfov(640, 480, 70.0)
UV = np.array([[u, v] for u in (0.0, 320.0, 639.0) for v in (0.0, 240.0, 479.0)])
OPTICAL_AXIS = np.array([0.0, 0.0, 1.0])
seeds = st.integers(0, 2**31)


def motion(rng: np.random.Generator, length: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(R_1_0, t_1_0 in units of the distance, normal) of a drone that looks down."""
    R = rotation_from_vector(rng.uniform(-0.1, 0.1, 3))
    t = rng.normal(size=3)
    normal = np.array([*rng.uniform(-0.15, 0.15, 2), 1.0])
    return R, t / np.linalg.norm(t) * length, normal / np.linalg.norm(normal)


def homography(R: np.ndarray, t: np.ndarray, normal: np.ndarray) -> np.ndarray:
    H = CAMERA.K @ (R + np.outer(t, normal)) @ np.linalg.inv(CAMERA.K)
    return H / H[2, 2]


@given(seeds, st.floats(0.02, 0.4))
def test_the_motion_that_was_flown_is_chosen(seed: int, length: float) -> None:
    rng = np.random.default_rng(seed)
    R, t, normal = motion(rng, length)
    found = decompose_ground_homography(homography(R, t, normal), CAMERA.K, UV, normal)
    np.testing.assert_allclose(found.R_1_0, R, atol=1e-5)
    np.testing.assert_allclose(found.t_1_0, t, atol=1e-5)
    np.testing.assert_allclose(found.normal_0, normal, atol=1e-4)


def test_an_attitude_good_to_two_degrees_chooses_the_motion() -> None:
    right, rng = 0, np.random.default_rng(2)
    for _ in range(300):
        R, t, normal = motion(rng, rng.uniform(0.05, 0.3))
        down = normal + rng.normal(0.0, 0.03, 3)
        found = decompose_ground_homography(homography(R, t, normal), CAMERA.K, UV, down)
        right += np.linalg.norm(found.t_1_0 - t) < 1e-4
        # Straight up or down two solutions nearly coincide, and either will do.
        assert np.linalg.norm(found.t_1_0 - t) < 0.15 * np.linalg.norm(t)
    assert right > 280


def test_continuity_chooses_where_the_attitude_is_unknown() -> None:
    right, rng = 0, np.random.default_rng(1)
    for _ in range(200):
        R, t, normal = motion(rng, rng.uniform(0.05, 0.3))
        before = decompose_ground_homography(homography(R, t * 0.9, normal), CAMERA.K, UV, normal)
        H = homography(R, t, normal)
        found = decompose_ground_homography(H, CAMERA.K, UV, OPTICAL_AXIS, before, 0.3)
        right += np.linalg.norm(found.t_1_0 - t) < 1e-4
    assert right >= 196


@given(seeds)
def test_all_points_lie_before_both_cameras(seed: int) -> None:
    R, t, normal = motion(np.random.default_rng(seed), 0.3)
    found = decompose_ground_homography(homography(R, t, normal), CAMERA.K, UV, OPTICAL_AXIS)
    rays = CAMERA.bearings(UV)
    towards = rays @ found.normal_0
    points_1 = rays / towards[:, None] @ found.R_1_0.T + found.t_1_0
    assert (towards > 0.0).all()
    assert (points_1[:, 2] > 0.0).all()


@given(seeds)
def test_pure_rotation_has_no_translation(seed: int) -> None:
    R = rotation_from_vector(np.random.default_rng(seed).uniform(-0.2, 0.2, 3))
    H = homography(R, np.zeros(3), OPTICAL_AXIS)
    found = decompose_ground_homography(H, CAMERA.K, UV, OPTICAL_AXIS)
    np.testing.assert_allclose(found.R_1_0, R, atol=1e-6)
    np.testing.assert_allclose(found.t_1_0, 0.0, atol=1e-6)


@given(seeds, st.floats(1e-5, 1e-3))
def test_slow_flight_is_not_taken_for_hovering(seed: int, length: float) -> None:
    R, t, normal = motion(np.random.default_rng(seed), length)
    found = decompose_ground_homography(homography(R, t, normal), CAMERA.K, UV, normal)
    np.testing.assert_allclose(found.t_1_0, t, atol=0.01 * length)


@given(seeds, st.floats(0.05, 0.4))
def test_the_choice_is_one_of_the_decompositions_of_opencv(seed: int, length: float) -> None:
    R, t, normal = motion(np.random.default_rng(seed), length)
    H = homography(R, t, normal)
    found = decompose_ground_homography(H, CAMERA.K, UV, OPTICAL_AXIS)
    _, rotations, translations, _ = cv2.decomposeHomographyMat(H, CAMERA.K)
    away = [
        np.abs(R_cv - found.R_1_0).max() + np.abs(t_cv.ravel() - found.t_1_0).max()
        for R_cv, t_cv in zip(rotations, translations, strict=True)
    ]
    assert min(away) < 1e-6


@given(seeds, st.floats(0.0, 0.4), st.floats(0.1, 10.0))
def test_translation_is_exact_when_attitude_is_known(
    seed: int, length: float, factor: float
) -> None:
    R, t, normal = motion(np.random.default_rng(seed), length)
    H = homography(R, t, normal) * factor
    np.testing.assert_allclose(ground_translation(H, CAMERA.K, R, normal), t, atol=1e-9)


@pytest.mark.parametrize("H", [np.zeros((3, 3)), np.full((3, 3), np.nan), np.diag([1.0, 1.0, 0.0])])
def test_what_is_no_motion_gives_none(H: np.ndarray) -> None:
    assert decompose_ground_homography(H, CAMERA.K, UV, OPTICAL_AXIS) is None


def test_mirrored_ground_gives_none() -> None:
    H = np.diag([-1.0, 1.0, 1.0]) @ homography(*motion(np.random.default_rng(0), 0.3))
    assert decompose_ground_homography(H, CAMERA.K, UV, OPTICAL_AXIS) is None
