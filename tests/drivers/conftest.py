"""The link peer of the watchdog's tests serves here too."""

import os
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "safety"))


@pytest.fixture(scope="session")
def data() -> Path:
    """The data folder, or a skip that says why."""
    folder = Path(os.environ.get("VWNAV_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no data folder at {folder}: set VWNAV_DATA")
    return folder
