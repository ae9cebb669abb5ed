from pathlib import Path

import pytest
from hypothesis import settings
from map_samples import SiftStub, small_pack

from vwnav.maps.pack import MapPack

# Other work shares the cores: how long an example takes says nothing.
settings.register_profile("no deadline", deadline=None)
settings.load_profile("no deadline")


@pytest.fixture(scope="session")
def sift_pack_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A pack with SIFT features; copy it before damaging it."""
    return small_pack(tmp_path_factory.mktemp("packs") / "field.mbtiles", (SiftStub(),))


@pytest.fixture
def sift_pack(sift_pack_file: Path):
    with MapPack.open(sift_pack_file) as pack:
        yield pack
