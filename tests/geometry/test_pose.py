import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vwnav.geometry.camera import rectification
from vwnav.geometry.homography import estimate_homography, transform_points
from vwnav.geometry.pose import PoseErrors, pose_from_rectified
from vwnav.geometry.rotations import quat_from_rotation, rotation_from_euler, wrap_pi
from vwnav.geometry.similarity import estimate_similarity

seeds = st.integers(0, 2**31)
EXACT = PoseErrors(sigma_px=0.5, sigma_tilt_rad=0.0, sigma_lean_rad=0.0)
LEANING = PoseErrors(sigma_px=0.5, sigma_tilt_rad=0.0, sigma_lean_rad=0.09)


def error_ne_m(pose, shot) -> np.ndarray:
    east_px, south_px = pose.nadir_px - shot.nadir_px
    return np.array([-south_px / shot.px_per_m[1], east_px / shot.px_per_m[0]])


def turned(yaw_rad: float) -> np.ndarray:
    return rotation_from_euler(0.0, 0.0, yaw_rad)


def exact_pose(shot, errors: PoseErrors):
    """The pose out of exact matches and the true attitude."""
    view = rectification(shot.camera.K, (640, 480), shot.R_ned_camera, shot.agl_m, 0.3)
    uv_rect = transform_points(view.H_rect_frame, shot.uv)
    H = estimate_homography(uv_rect, shot.map_px, 2.0, 0).H
    return pose_from_rectified(H, view, uv_rect, shot.map_px, shot.px_per_m, errors)


@given(seeds, st.floats(20.0, 200.0), st.floats(-0.3, 0.3), st.floats(0.8, 1.2))
def test_nadir_view_gives_position_heading_and_height(
    shot_of, seed: int, agl_m: float, yaw_error_rad: float, agl_ratio: float
) -> None:
    shot = shot_of(np.random.default_rng(seed), agl_m=agl_m)
    # Heading and height are assumed wrong: the map puts them right.
    R_assumed = turned(-yaw_error_rad) @ shot.R_ned_camera
    view = rectification(shot.camera.K, (640, 480), R_assumed, agl_m / agl_ratio, 0.3)
    uv_rect = transform_points(view.H_rect_frame, shot.uv)
    fit = estimate_homography(uv_rect, shot.map_px, 2.0, seed)
    pose = pose_from_rectified(fit.H, view, uv_rect, shot.map_px, shot.px_per_m, EXACT)
    assert np.linalg.norm(error_ne_m(pose, shot)) < 0.01
    assert wrap_pi(pose.yaw_correction_rad - yaw_error_rad) == pytest.approx(0.0, abs=1e-3)
    assert pose.scale_ratio == pytest.approx(agl_ratio, rel=1e-3)
    assert pose.agl_m == pytest.approx(agl_m, rel=1e-3)


@given(seeds)
def test_similarity_of_the_nadir_view_serves_as_well(shot_of, seed: int) -> None:
    shot = shot_of(np.random.default_rng(seed))
    view = rectification(shot.camera.K, (640, 480), shot.R_ned_camera, 55.0, 0.3)
    uv_rect = transform_points(view.H_rect_frame, shot.uv)
    fit = estimate_similarity(uv_rect, shot.map_px, 2.0, seed)
    pose = pose_from_rectified(fit.H, view, uv_rect, shot.map_px, shot.px_per_m, EXACT)
    # A similarity cannot stretch north against east as the map does: 0.4 % of some 30 m here.
    assert np.linalg.norm(error_ne_m(pose, shot)) < 0.15
    assert pose.agl_m == pytest.approx(50.0, rel=2e-3)


def noisy_pose(shot, rng: np.random.Generator, sigma_px: float, sigma_tilt_rad: float):
    """The pose out of one noisy set of matches and one wrong attitude."""
    tilt = rotation_from_euler(*rng.normal(0.0, sigma_tilt_rad, 2), 0.0)
    yaw = np.arctan2(shot.R_ned_camera[1, 0], shot.R_ned_camera[0, 0])
    R_assumed = turned(yaw) @ tilt @ turned(-yaw) @ shot.R_ned_camera
    view = rectification(shot.camera.K, (640, 480), R_assumed, shot.agl_m, 0.3)
    uv_rect = transform_points(view.H_rect_frame, shot.uv)
    uv_map = shot.map_px + rng.normal(0.0, sigma_px, shot.map_px.shape)
    H = estimate_homography(uv_rect, uv_map, 10.0 * sigma_px, 0).H
    errors = PoseErrors(sigma_px=sigma_px, sigma_tilt_rad=sigma_tilt_rad)
    return pose_from_rectified(H, view, uv_rect, uv_map, shot.px_per_m, errors)


@pytest.mark.parametrize(("sigma_px", "sigma_tilt_rad"), [(0.7, 0.0), (0.7, 0.02), (0.1, 0.03)])
def test_stated_covariances_are_those_of_many_trials(
    shot_of, sigma_px: float, sigma_tilt_rad: float
) -> None:
    rng = np.random.default_rng(4)
    shot = shot_of(rng, tilt_rad=0.05)
    poses = [noisy_pose(shot, rng, sigma_px, sigma_tilt_rad) for _ in range(400)]
    errors_m = np.array([error_ne_m(pose, shot) for pose in poses])
    nees = [
        e @ np.linalg.solve(p.covariance_ne_m2, e) for e, p in zip(errors_m, poses, strict=True)
    ]
    assert np.mean(nees) == pytest.approx(2.0, rel=0.2)
    if sigma_tilt_rad == 0.0:
        yaw_nees = [(p.yaw_correction_rad / p.sigma_yaw_rad) ** 2 for p in poses]
        agl_nees = [((p.agl_m - shot.agl_m) / p.sigma_agl_m) ** 2 for p in poses]
        assert np.mean(yaw_nees) == pytest.approx(1.0, rel=0.25)
        assert np.mean(agl_nees) == pytest.approx(1.0, rel=0.25)


@settings(max_examples=20)
@given(st.floats(20.0, 200.0), st.floats(0.0, 0.1))
def test_tilt_error_counts_as_height_times_its_angle(
    shot_of, agl_m: float, sigma_tilt_rad: float
) -> None:
    shot = shot_of(np.random.default_rng(0), agl_m=agl_m)
    still, tilted = (
        exact_pose(shot, errors).covariance_ne_m2
        for errors in (EXACT, PoseErrors(sigma_px=0.5, sigma_tilt_rad=sigma_tilt_rad))
    )
    expected = (agl_m * sigma_tilt_rad) ** 2 * np.eye(2)
    np.testing.assert_allclose(tilted - still, expected, rtol=1e-3, atol=1e-9)


def test_error_of_the_map_adds_to_the_covariance(shot_of) -> None:
    shot = shot_of(np.random.default_rng(0))
    errors = PoseErrors(sigma_px=1e-3, sigma_tilt_rad=0.0, sigma_georeference_m=1.5)
    pose = exact_pose(shot, errors)
    np.testing.assert_allclose(pose.covariance_ne_m2, 2.25 * np.eye(2), atol=1e-3)


def one_sided(shot_of, seed: int):
    """A tilted image taken for level, with inliers on its left half only."""
    shot = shot_of(np.random.default_rng(seed), points=160)
    level = turned(0.3) @ shot.camera.R_body_camera
    view = rectification(shot.camera.K, (640, 480), level, shot.agl_m, 0.3)
    left = shot.uv[:, 0] < 300.0
    uv_rect = transform_points(view.H_rect_frame, shot.uv[left])
    return shot, view, uv_rect, shot.map_px[left]


def heading_without_tilt(shot) -> float:
    """Twist about down: the heading once the shortest rotation has levelled the camera."""
    quat = quat_from_rotation(shot.R_ned_camera @ shot.camera.R_body_camera.T)
    return 2.0 * float(np.arctan2(quat[3], quat[0]))


@given(seeds)
def test_heading_and_scale_of_a_tilted_image_are_those_of_its_middle(shot_of, seed: int) -> None:
    shot, view, uv_rect, map_px = one_sided(shot_of, seed)
    fit = estimate_homography(uv_rect, map_px, 2.0, seed)
    seen = fit.H, view, uv_rect, map_px, shot.px_per_m, LEANING
    pose = pose_from_rectified(*seen)
    assert wrap_pi(0.3 + pose.yaw_correction_rad - heading_without_tilt(shot)) == pytest.approx(
        0.0, abs=2e-3
    )
    axis_down = shot.R_ned_camera[2, 2]
    lengths = shot.agl_m / axis_down * np.array([1.0, 1.0 / axis_down])
    assert pose.agl_m == pytest.approx(float(lengths.mean()), rel=5e-3)


def test_the_sigmas_in_the_middle_are_what_noise_on_the_pairs_does(shot_of) -> None:
    shot, view, uv_rect, map_px = one_sided(shot_of, 3)
    rng = np.random.default_rng(0)
    yaws, ratios, sigmas = [], [], []
    for _ in range(200):
        noisy_px = map_px + 0.5 * rng.normal(size=map_px.shape)
        H = estimate_homography(uv_rect, noisy_px, 5.0, 0).H
        seen = H, view, uv_rect, noisy_px, shot.px_per_m, LEANING
        pose = pose_from_rectified(*seen)
        yaws.append(pose.yaw_correction_rad)
        ratios.append(pose.scale_ratio)
        sigmas.append((pose.sigma_yaw_rad, pose.sigma_agl_m / pose.agl_m))
    sigma_yaw_rad, sigma_ratio = np.mean(sigmas, axis=0)
    assert np.std(yaws) == pytest.approx(sigma_yaw_rad, rel=0.2)
    assert np.std(ratios) / np.mean(ratios) == pytest.approx(sigma_ratio, rel=0.2)


@given(seeds)
def test_a_similarity_on_one_side_of_a_tilted_image_knows_its_heading_less(
    shot_of, seed: int
) -> None:
    shot, view, uv_rect, map_px = one_sided(shot_of, seed)
    fit = estimate_similarity(uv_rect, map_px, 60.0, seed)
    seen = fit.H, view, uv_rect, map_px, shot.px_per_m, LEANING
    pose = pose_from_rectified(*seen)
    error_rad = wrap_pi(0.3 + pose.yaw_correction_rad - heading_without_tilt(shot))
    assert abs(error_rad) < 4.0 * pose.sigma_yaw_rad


def test_so_it_does_its_place(shot_of) -> None:
    """Without what a lean does from there to the middle it was 8 sigmas off, NEES 6.9."""
    nees = []
    for seed in range(100):
        shot, view, uv_rect, map_px = one_sided(shot_of, seed)
        everywhere = transform_points(view.H_rect_frame, shot.uv)
        H = estimate_homography(everywhere, shot.map_px, 2.0, seed).H
        fit = estimate_similarity(uv_rect, map_px, 60.0, seed)
        pose = pose_from_rectified(fit.H, view, uv_rect, map_px, shot.px_per_m, LEANING)
        east_px, south_px = pose.nadir_px - transform_points(H, view.nadir_uv)[0]
        off_m = np.array([-south_px / shot.px_per_m[1], east_px / shot.px_per_m[0]])
        nees.append(off_m @ np.linalg.solve(pose.covariance_ne_m2, off_m))
    assert np.mean(nees) < 3.0
    assert np.sqrt(np.max(nees)) < 3.5
