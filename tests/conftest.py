"""Settings of all tests."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

# Before numpy loads, as the command does it, and for the processes that tests start.
os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")

# Laws are about values, not about how busy the machine is; and the same code gets the same verdict.
settings.register_profile("any_machine", deadline=None, derandomize=True)
# `make test-long`: other examples each time. What one finds becomes an @example of its law.
settings.register_profile("searching", deadline=None)
# Each mutant runs them anew; a law that needs luck to kill one would make the number a dice roll.
settings.register_profile(
    "mutants", deadline=None, max_examples=10, derandomize=True, database=None
)
settings.load_profile("any_machine")


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """The folder of real data; the test is skipped where it is absent."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("VWNAV_DATA", beside))
    if not folder.is_dir():
        pytest.skip(f"no real data at {folder}; set VWNAV_DATA")
    return folder
