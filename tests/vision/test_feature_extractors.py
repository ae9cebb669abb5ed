import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from vision_scenes import texture

from vwnav.errors import ConfigError
from vwnav.types import FeatureExtractor
from vwnav.vision.features.load import load_features
from vwnav.vision.features.opencv import SiftFeatures

SCENE = texture(3, 480)


def found_again(uv0: np.ndarray, uv1: np.ndarray, within_px: float) -> float:
    """Share of the points uv1 that have one of uv0 near."""
    apart = np.linalg.norm(uv1[:, None] - uv0[None], axis=2)
    return float(np.mean(apart.min(axis=1) <= within_px))


def test_an_image_without_structure_has_no_features(extractor: FeatureExtractor):
    for gray_value in (0, 128, 255):
        found = extractor.extract(np.full((96, 128), gray_value, np.uint8), 500)
        assert len(found) == 0
        assert found.uv.shape == (0, 2)


@pytest.mark.parametrize("shape", [(1, 1), (3, 200), (15, 15), (33, 40)])
def test_tiny_images_are_no_error(extractor: FeatureExtractor, shape: tuple[int, int]):
    noise = np.random.default_rng(0).integers(0, 256, shape, np.uint8)
    found = extractor.extract(noise, 100)
    assert np.all(found.uv >= -0.5)
    assert np.all(found.uv <= np.array(shape[::-1]) - 0.5)


def test_what_is_no_gray_image_is_refused(extractor: FeatureExtractor):
    for wrong in (np.zeros((64, 64, 3), np.uint8), np.zeros((64, 64)), np.zeros((0, 9), np.uint8)):
        with pytest.raises(ValueError, match="expected a gray picture"):
            extractor.extract(wrong, 10)


@pytest.mark.parametrize("count", [0, 1, 50, 400])
def test_no_more_keypoints_than_asked_for_strongest_first(extractor: FeatureExtractor, count: int):
    found = extractor.extract(SCENE, count)
    assert len(found) <= count
    assert len(found) >= 0.8 * count
    assert np.all(np.diff(found.scores) <= 0.0)


def test_the_same_image_gives_the_same_features(extractor: FeatureExtractor):
    first, second = extractor.extract(SCENE, 300), extractor.extract(SCENE.copy(), 300)
    assert np.array_equal(first.uv, second.uv)
    assert np.array_equal(first.descriptors, second.descriptors)


def test_descriptors_are_of_unit_length_or_binary(extractor: FeatureExtractor):
    descriptors = extractor.extract(SCENE, 200).descriptors
    if descriptors.dtype == np.uint8:
        assert descriptors.shape == (200, 32)
    else:
        assert np.allclose(np.linalg.norm(descriptors, axis=1), 1.0, atol=1e-3)


extractor_named = functools.cache(load_features)


@settings(max_examples=12)
@given(
    cells_u=st.integers(0, 5),
    cells_v=st.integers(0, 5),
    name=st.sampled_from(["learned", "sift", "orb"]),
)
def test_shifting_the_image_shifts_the_keypoints(cells_u: int, cells_v: int, name: str):
    du, dv = 8 * cells_u, 8 * cells_v
    still = extractor_named(name).extract(SCENE[:240, :240].copy(), 900)
    moved = extractor_named(name).extract(SCENE[dv : 240 + dv, du : 240 + du].copy(), 250)
    inside = np.all(moved.uv + np.array([du, dv]) < 215, axis=1) & np.all(moved.uv > 25, axis=1)
    assert found_again(still.uv, moved.uv[inside] + np.array([du, dv]), 1.0) > 0.65


def test_keypoints_have_the_centre_convention(extractor: FeatureExtractor):
    """An image turned by half a turn has its keypoints at (w - 1 - u, h - 1 - v): no bias."""
    found = extractor.extract(SCENE, 600)
    turned = extractor.extract(np.ascontiguousarray(SCENE[::-1, ::-1]), 600)
    back = np.array(SCENE.shape[::-1]) - 1.0 - turned.uv
    apart = back[None] - found.uv[:, None]
    nearest = np.argmin(np.linalg.norm(apart, axis=2), axis=1)
    offset = apart[np.arange(len(nearest)), nearest]
    offset = offset[np.linalg.norm(offset, axis=1) < 1.5]
    assert len(offset) > 150
    assert np.all(np.abs(offset.mean(axis=0)) < 0.12)


def test_upright_and_rotated_sift_cannot_be_compared():
    assert SiftFeatures().feature_set_id != SiftFeatures(upright=False).feature_set_id


def test_rotated_sift_survives_a_quarter_turn_and_upright_does_not():
    from vwnav.vision.matching import match

    counts = {}
    for upright in (True, False):
        sift = SiftFeatures(upright=upright)
        first, second = sift.extract(SCENE, 300), sift.extract(np.rot90(SCENE).copy(), 300)
        pairs = match(first, second)
        turned = np.stack([first.uv[:, 1], SCENE.shape[1] - 1 - first.uv[:, 0]], axis=1)
        error = np.linalg.norm(turned[pairs[:, 0]] - second.uv[pairs[:, 1]], axis=1)
        counts[upright] = int(np.count_nonzero(error < 1.0))
    assert counts[False] > 100
    assert counts[True] < 0.2 * counts[False]


def test_an_unknown_name_lists_the_known_ones():
    with pytest.raises(ConfigError, match="learned, sift, orb"):
        load_features("surf")
