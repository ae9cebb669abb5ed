import cv2
import kornia
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from training import warps

SIZE = 64
seeds = st.integers(0, 2**32 - 1)


def random_view(seed):
    return warps.random_relative_view(np.random.default_rng(seed), warps.WarpConfig(), SIZE)


def smooth_image(seed=0, size=96):
    noise = np.random.default_rng(seed).normal(size=(size, size))
    smooth = cv2.GaussianBlur(noise, (0, 0), 3)
    return cv2.normalize(smooth, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)


@settings(max_examples=50, deadline=None)
@given(seed=seeds)
def test_points_carried_there_and_back_are_where_they_were(seed):
    H = random_view(seed)
    points = np.random.default_rng(seed).uniform(0, SIZE, (20, 2))
    back = warps.warp_points(np.linalg.inv(H), warps.warp_points(H, points))
    np.testing.assert_allclose(back, points, atol=1e-6)


@settings(max_examples=50, deadline=None)
@given(seed=seeds)
def test_points_are_carried_as_kornia_carries_them(seed):
    H = random_view(seed)
    points = np.random.default_rng(seed).uniform(0, SIZE, (20, 2))
    expected = kornia.geometry.transform_points(
        torch.from_numpy(H)[None], torch.from_numpy(points)[None]
    )
    np.testing.assert_allclose(warps.warp_points(H, points), expected[0].numpy(), atol=1e-6)


def test_a_view_shows_what_kornia_shows():
    image = smooth_image()
    H_source_view = warps.centred(warps.similarity(0.3, 0.8), np.full(2, 47.5), np.full(2, 31.5))
    ours = warps.view(image, H_source_view, SIZE).astype(np.float32)
    source = torch.from_numpy(image).float()[None, None]
    H_view_source = torch.from_numpy(np.linalg.inv(H_source_view)).float()[None]
    theirs = kornia.geometry.warp_perspective(
        source, H_view_source, (SIZE, SIZE), align_corners=True
    )
    np.testing.assert_allclose(ours, theirs[0, 0].numpy(), atol=1.5)


def test_a_shrunk_view_stays_in_its_place():
    # A bright square, seen three times smaller, keeps its centre: the half-pixel rule.
    image = np.zeros((300, 300), np.uint8)
    image[120:180, 90:150] = 255
    H_source_view = warps.centred(warps.similarity(0.0, 3.0), np.full(2, 149.5), np.full(2, 31.5))
    seen = warps.view(image, H_source_view, SIZE)
    moments = cv2.moments(seen)
    centre = np.array([moments["m10"], moments["m01"]]) / moments["m00"]
    expected = warps.warp_points(np.linalg.inv(H_source_view), np.array([[119.5, 149.5]]))[0]
    np.testing.assert_allclose(centre, expected, atol=0.02)


@given(angle=st.floats(-3, 3), scale=st.floats(0.3, 3))
def test_local_scale_of_a_similarity_is_its_scale(angle, scale):
    H = warps.similarity(angle, scale)
    assert warps.local_scale(H, np.array([5.0, 7.0])) == pytest.approx(scale, rel=1e-6)


@settings(max_examples=50, deadline=None)
@given(seed=seeds)
def test_a_crop_lies_inside_of_its_source(seed):
    rng = np.random.default_rng(seed)
    H = warps.random_crop_frame(rng, (200, 150), SIZE, (0.7, 2.0))
    centre = warps.warp_points(H, np.full((1, 2), (SIZE - 1) / 2))[0]
    assert warps.local_scale(H, np.full(2, (SIZE - 1) / 2)) <= 2.0 + 1e-6
    assert (centre > 0).all()
    assert (centre < [200, 150]).all()


def test_relative_views_turn_and_scale_as_configured():
    views = [random_view(seed) for seed in range(400)]
    angles = [np.degrees(np.arctan2(H[1, 0], H[0, 0])) for H in views]
    scales = [warps.local_scale(H, np.full(2, (SIZE - 1) / 2)) for H in views]
    assert 9 < np.std(angles) < 17
    assert 0.65 < min(scales) < 0.8
    assert 1.25 < max(scales) < 1.5


def test_a_bent_view_shows_points_where_relief_puts_them():
    size, rng = 256, np.random.default_rng(4)
    scenery = cv2.resize(rng.integers(0, 255, (32, 32)).astype(np.uint8), (size, size))
    H_1_0 = warps.random_relative_view(rng, warps.WarpConfig(), size)
    relief = warps.random_relief(rng, size, 3.0)
    flat = warps.view(scenery, np.linalg.inv(H_1_0), size)
    bent = warps.bent(flat, H_1_0, relief)
    uv0 = rng.uniform(60, 196, (1, 200, 2))
    planar = warps.warp_points(H_1_0, uv0[0])[None]
    there = planar + warps.relief_at(relief, uv0, size)

    def seen(image, uv):
        return cv2.remap(image, uv.astype(np.float32), None, cv2.INTER_LINEAR)[0].astype(float)

    truth = seen(scenery, uv0)
    assert np.abs(seen(bent, there) - truth).mean() < 3.0
    assert np.abs(seen(bent, planar) - truth).mean() > 6.0


def test_relief_moves_things_along_one_direction_and_not_far():
    for seed in range(10):
        relief = warps.random_relief(np.random.default_rng(seed), 320, 2.5).reshape(-1, 2)
        singular = np.linalg.svd(relief, compute_uv=False)
        assert singular[1] < 1e-3 * singular[0]
        assert np.abs(relief).max() < 20.0
