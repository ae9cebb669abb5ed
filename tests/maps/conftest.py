import os
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


@pytest.fixture
def data_folder() -> Path:
    """The folder of real data; the test is skipped where it is absent."""
    beside = Path(__file__).resolve().parents[3] / "shared" / "data"
    folder = Path(os.environ.get("VWNAV_DATA", beside))
    if not folder.is_dir():
        pytest.skip(f"no real data at {folder}; set VWNAV_DATA")
    return folder
