import numpy as np
import pytest
from bench_scenes import features, ground

from vwnav.bench.features import methods
from vwnav.errors import ConfigError, ModelError
from vwnav.types import Features
from vwnav.vision.matching import match


@pytest.fixture
def no_xfeat(monkeypatch):
    def absent():
        raise ConfigError("xfeat is left out")

    monkeypatch.setattr(methods, "load_xfeat", absent)


@pytest.mark.usefixtures("no_xfeat")
def test_every_released_size_and_the_classics_are_there_and_what_is_not_is_said():
    sets, skipped = methods.feature_sets([])
    names = [each.name for each in sets]
    assert {"vwnav_default", "sift", "sift_turning", "orb"} <= set(names)
    assert skipped == ["xfeat is left out"]
    assert len({method.name for each in sets for method in each.methods}) >= 6


@pytest.mark.usefixtures("no_xfeat")
def test_a_missing_model_is_an_error(tmp_path):
    with pytest.raises(ModelError, match="no model"):
        methods.feature_sets([tmp_path / "vwnav_other.onnx"])


@pytest.mark.usefixtures("no_xfeat")
def test_every_set_finds_its_own_image_again():
    gray = ground()[:, :, 0]
    sets, _ = methods.feature_sets([])
    for each in sets:
        found = each.extract(gray[:384, :384].copy(), 200)
        assert 50 < len(found) <= 200, each.name
        assert (np.diff(found.scores) <= 0).all(), each.name
        for method in each.methods:
            index = method.match(found, found)
            assert len(index) > 40, method.name
            uv = found.uv[index[:, 0]] - found.uv[index[:, 1]]
            assert np.median(np.abs(uv)) == 0.0, method.name


def test_descriptors_of_a_map_pack_match_as_before():
    here = features(np.random.default_rng(3).uniform(0, 100, (300, 2)))
    noise = np.random.default_rng(4).normal(0.0, 0.06, here.descriptors.shape)
    noisy = (here.descriptors + noise).astype(np.float32)
    noisy /= np.linalg.norm(noisy, axis=1, keepdims=True)
    there = Features(here.uv, noisy, here.scores)
    before, after = match(here, there), methods.match_packed(here, there)
    assert len(before) > 250
    assert {tuple(pair) for pair in before} == {tuple(pair) for pair in after}


def test_the_ratio_test_keeps_only_what_is_clearly_nearest():
    codes = np.array([[1.0, 0.0], [0.0, 1.0]], np.float32)
    near = np.array([[0.0, 1.0], [0.05, 0.9987]], np.float32)
    map_codes = np.concatenate([near, [[0.999, 0.0447]]]).astype(np.float32)
    frame = Features(np.zeros((2, 2), np.float32), codes, np.ones(2, np.float32))
    map_ = Features(np.zeros((3, 2), np.float32), map_codes, np.ones(3, np.float32))
    assert methods.match_by_ratio(frame, map_).tolist() == [[0, 2], [1, 0]]
    map_ = Features(map_.uv, np.concatenate([near[:1], near[:1], map_codes[2:]]), map_.scores)
    assert methods.match_by_ratio(frame, map_).tolist() == [[0, 2]]
