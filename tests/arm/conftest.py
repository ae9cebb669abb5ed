"""The emulated aarch64 tree of `deploy/aarch64.sh`."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
TREE = Path(os.environ.get("VWNAV_AARCH64", ROOT / ".aarch64")).resolve()

for room in ("watchdog", "maps"):  # the link peer and the large map serve here too
    sys.path.insert(0, str(ROOT / "tests" / room))


@dataclass(frozen=True)
class Emulated:
    """What a program said, and the most memory that it took, the emulator's own with it."""

    code: int
    out: str
    err: str
    peak_mb: float

    @property
    def said(self) -> Any:
        """Its line of JSON."""
        assert self.code == 0, self.err[-3000:]
        return json.loads(self.out.splitlines()[-1])


@pytest.fixture(scope="session")
def aarch64(tmp_path_factory) -> Callable[..., Emulated]:
    """Runs Python on an emulated processor; skipped where no tree was set up."""
    if not (TREE / "python").exists() or shutil.which("qemu-aarch64-static") is None:
        pytest.skip(f"no emulated aarch64 in {TREE}: deploy/aarch64.sh sets it up")
    folder = tmp_path_factory.mktemp("aarch64")

    def run(cpu: str, *arguments: object) -> Emulated:
        environment = os.environ | {"VWNAV_CPU": cpu, "VWNAV_SOURCE": str(ROOT), "COLUMNS": "200"}
        measured = Path(__file__).with_name("measured.py"), folder / "peak"
        command = [sys.executable, *measured, TREE / "python", *arguments]
        run = subprocess.run(
            [*map(str, command)], capture_output=True, text=True, env=environment, cwd=ROOT
        )
        peak_mb = float((folder / "peak").read_text())
        return Emulated(run.returncode, run.stdout, run.stderr, peak_mb)

    return run


@pytest.fixture(scope="session")
def here() -> Callable[..., subprocess.CompletedProcess[str]]:
    """Runs Python on this machine, as `aarch64` does on the other."""

    def run(*arguments: object) -> subprocess.CompletedProcess[str]:
        environment = os.environ | {"PYTHONPATH": str(ROOT), "COLUMNS": "200"}
        command = [sys.executable, *map(str, arguments)]
        return subprocess.run(command, capture_output=True, text=True, env=environment, cwd=ROOT)

    return run
