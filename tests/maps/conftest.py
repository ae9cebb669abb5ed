from pathlib import Path

import pytest
from map_samples import SiftStub, small_pack

from vwnav.maps.pack import MapPack


@pytest.fixture(scope="session")
def sift_pack_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A pack with SIFT features; copy it before damaging it."""
    return small_pack(tmp_path_factory.mktemp("packs") / "field.mbtiles", (SiftStub(),))


@pytest.fixture
def sift_pack(sift_pack_file: Path):
    with MapPack.open(sift_pack_file) as pack:
        yield pack
