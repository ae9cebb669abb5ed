import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vwnav.maps.codec import (
    decode_features,
    decode_tile,
    descriptor_kind,
    encode_features,
    encode_tile,
)
from vwnav.maps.image import MapImage
from vwnav.types import Features

seeds = st.integers(0, 2**32 - 1)


def random_features(seed: int, count: int, *, negative: bool) -> Features:
    rng = np.random.default_rng(seed)
    descriptors = rng.normal(size=(count, 64))
    descriptors = descriptors if negative else np.abs(descriptors)
    descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True)
    uv = rng.uniform(-0.5, 255.5, (count, 2)).astype(np.float32)
    return Features(uv, descriptors.astype(np.float32), rng.random(count, np.float32))


@given(seeds, st.integers(0, 40), st.booleans())
def test_float_features_come_back_with_unit_length_and_nearly_unchanged(seed, count, negative):
    features = random_features(seed, count, negative=negative)
    kind = "int8" if negative else "uint8"
    back = decode_features(encode_features(features, kind), count, 64, kind)
    # At the far edge there is no step to round up to: the last one stands for half a step more.
    allowed = np.where(features.uv > 255.5 - 1.0 / 256, 1.0, 0.5) / 256
    assert np.all(np.abs(back.uv - features.uv) <= allowed + 1e-4)
    assert np.array_equal(back.scores, features.scores)
    cosines = (back.descriptors * features.descriptors).sum(axis=1)
    assert cosines.min(initial=1.0) > 0.9998


@given(seeds, st.integers(0, 40))
def test_binary_features_come_back_exactly(seed: int, count: int):
    rng = np.random.default_rng(seed)
    bits = rng.integers(0, 256, (count, 32), np.uint8)
    features = Features(np.zeros((count, 2), np.float32), bits, np.ones(count, np.float32))
    back = decode_features(encode_features(features, "binary"), count, 32, "binary")
    assert np.array_equal(back.descriptors, bits)
    assert back.descriptors.dtype == np.uint8


def test_a_descriptor_of_zeros_stays_zeros():
    features = Features(
        np.zeros((1, 2), np.float32), np.zeros((1, 8), np.float32), np.zeros(1, np.float32)
    )
    back = decode_features(encode_features(features, "int8"), 1, 8, "int8")
    assert not back.descriptors.any()


@pytest.mark.parametrize(("kind", "negative"), [("uint8", True), ("binary", False)])
def test_descriptors_of_another_kind_are_refused(kind, negative: bool):
    with pytest.raises(ValueError, match="expected"):
        encode_features(random_features(1, 3, negative=negative), kind)


def test_a_blob_of_another_length_is_refused():
    with pytest.raises(ValueError, match="expected 3 keypoints"):
        decode_features(b"short", 3, 64, "int8")


def test_every_feature_set_has_its_kind():
    kinds = {name: descriptor_kind(name) for name in ("learned", "sift", "orb")}
    assert kinds == {"learned": "int8", "sift": "uint8", "orb": "binary"}


@settings(max_examples=15)
@given(seeds, st.booleans())
def test_a_tile_comes_back_exactly_with_its_mask(seed: int, complete: bool):
    rng = np.random.default_rng(seed)
    bgr = rng.integers(0, 256, (256, 256, 3), np.uint8)
    mask = np.ones((256, 256), bool) if complete else rng.random((256, 256)) < 0.5
    back = decode_tile(encode_tile(MapImage(bgr, mask)))
    assert np.array_equal(back.mask, mask)
    assert np.array_equal(back.bgr[mask], bgr[mask])
    assert not back.bgr[~mask].any()


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"no picture",
        encode_tile(MapImage(np.zeros((256, 256, 3), np.uint8), np.ones((256, 256), bool)))[:40],
    ],
)
def test_what_is_no_tile_is_refused(data: bytes):
    with pytest.raises(ValueError, match="no picture"):
        decode_tile(data)
