import numpy as np
import pytest
from map_samples import textured

from vwnav.geometry.geodesy import Window
from vwnav.maps.build.collar import find_collar
from vwnav.maps.image import MapImage


def collar_mask(bgr: np.ndarray) -> np.ndarray:
    image = MapImage(bgr, np.ones(bgr.shape[:2], bool))
    collar = find_collar(image.crop, (bgr.shape[1], bgr.shape[0]))
    if collar is None:
        return np.zeros(bgr.shape[:2], bool)
    return collar.at(bgr, Window(0, 0, bgr.shape[1], bgr.shape[0]))


@pytest.mark.parametrize("value", [0, 3, 255])
def test_a_corner_of_black_or_white_is_found_but_for_its_pointed_tips(value: int):
    bgr = textured(700, 531).copy()
    v, u = np.mgrid[:700, :531]
    corner = 2 * u + v < 500
    bgr[corner] = value
    found = collar_mask(bgr)
    assert not (found & ~corner).any()
    missed_v, missed_u = np.nonzero(corner & ~found)
    assert np.minimum(missed_v, missed_u).max(initial=0) < 8


def test_dark_and_bright_places_inside_the_image_stay():
    bgr = textured(400, 400).copy()
    bgr[100:200, 100:200] = 0
    bgr[250:300, 250:300] = 255
    assert not collar_mask(bgr).any()


def test_an_image_without_a_collar_has_none():
    image = MapImage(textured(300, 300), np.ones((300, 300), bool))
    assert find_collar(image.crop, (300, 300)) is None


def test_any_window_gives_the_same_collar():
    bgr = textured(300, 300).copy()
    bgr[:, 210:] = 0
    whole = collar_mask(bgr)
    collar = find_collar(MapImage(bgr, np.ones((300, 300), bool)).crop, (300, 300))
    part = collar.at(bgr[33:77, 190:250], Window(190, 33, 250, 77))
    assert np.array_equal(part, whole[33:77, 190:250])
