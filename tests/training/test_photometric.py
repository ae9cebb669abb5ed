import numpy as np
import pytest
import torch

from training import photometric
from training.photometric import PhotometricConfig

NAMES = list(PhotometricConfig.__dataclass_fields__)
NOTHING = dict.fromkeys(NAMES, 0.0)


@pytest.fixture
def view():
    return np.random.default_rng(0).integers(30, 220, (96, 96, 3)).astype(np.uint8)


@pytest.mark.parametrize("name", NAMES)
def test_each_change_alters_the_image_and_nothing_of_its_form(view, name):
    config = PhotometricConfig(**(NOTHING | {name: 1.0}))
    plain = photometric.photograph(view, np.random.default_rng(4), PhotometricConfig(**NOTHING))
    photo = photometric.photograph(view, np.random.default_rng(4), config)
    assert photo.shape == (96, 96)
    assert photo.dtype == np.uint8
    assert not np.array_equal(photo, plain)


def test_the_same_generator_gives_the_same_photograph(view):
    photos = [
        photometric.photograph(view, np.random.default_rng(9), PhotometricConfig())
        for _ in range(2)
    ]
    np.testing.assert_array_equal(*photos)


def test_some_tone_curves_are_not_monotone():
    curves = [photometric.random_tone_curve(np.random.default_rng(i)) for i in range(40)]
    falls = [(np.diff(c.astype(int)) < 0).any() for c in curves]
    assert 5 < sum(falls) < 40


def test_the_kornia_tail_keeps_shape_and_range():
    torch.manual_seed(0)
    out = photometric.batch_augmentation()(torch.rand(6, 1, 32, 32))
    assert out.shape == (6, 1, 32, 32)
    assert out.min() >= 0
    assert out.max() <= 1
