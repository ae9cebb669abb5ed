import cv2
import pytest
from vision_scenes import ground_pack, texture

from vwnav.maps.pack import MapPack
from vwnav.types import FeatureExtractor
from vwnav.vision.features.load import load_features

cv2.setNumThreads(1)


@pytest.fixture(scope="session")
def sift() -> FeatureExtractor:
    return load_features("sift")


@pytest.fixture(scope="session")
def learned() -> FeatureExtractor:
    return load_features("learned")


@pytest.fixture(scope="session")
def orb() -> FeatureExtractor:
    return load_features("orb")


@pytest.fixture(params=["learned", "sift", "orb"])
def extractor(request: pytest.FixtureRequest) -> FeatureExtractor:
    return request.getfixturevalue(request.param)


@pytest.fixture(scope="session")
def ground():
    return texture(0)


@pytest.fixture(scope="session")
def pack(tmp_path_factory, ground, learned, sift, orb):
    path = tmp_path_factory.mktemp("packs") / "ground.mbtiles"
    with MapPack.open(ground_pack(path, ground, (learned, sift, orb))) as opened:
        yield opened
