import cv2
import pytest

from export.parity import drawn_images
from training.data import scene


@pytest.fixture(scope="session")
def drawn_scenes():
    """Six drawn places, seen once each: enough to train a little without any data."""
    images = [cv2.resize(p, (320, 320)) for p in drawn_images(6)]
    return [scene("single", "drawn", [cv2.cvtColor(p, cv2.COLOR_GRAY2BGR)]) for p in images]
