"""A file is written whole or not at all."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from vwnav.errors import CalibrationError
from vwnav.files.whole import write_whole
from vwnav.geometry.calibration import save_camera
from vwnav.geometry.camera import Camera

LIMITED = """
import resource, signal, sys
from pathlib import Path
from vwnav.files.whole import write_whole
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))
try:
    write_whole(Path(sys.argv[1]), "x" * 50_000)
except OSError as error:
    sys.exit(0 if error.filename == sys.argv[1] else 2)
"""


def test_what_is_written_reads_back_and_nothing_lies_beside_it(tmp_path: Path):
    write_whole(tmp_path / "a.txt", "grün\n")
    assert (tmp_path / "a.txt").read_text(encoding="utf-8") == "grün\n"
    assert [each.name for each in tmp_path.iterdir()] == ["a.txt"]


def test_without_room_the_old_file_stays_and_the_error_names_it(tmp_path: Path):
    path = tmp_path / "a.txt"
    path.write_text("old")
    assert subprocess.run([sys.executable, "-c", LIMITED, path]).returncode == 0
    assert path.read_text() == "old"
    assert [each.name for each in tmp_path.iterdir()] == ["a.txt"]


@pytest.mark.parametrize("name", ["camera.toml", "camera.json"])
def test_a_calibration_that_finds_no_room_leaves_no_half_of_it(
    tmp_path: Path, monkeypatch, name: str
):
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(CalibrationError, match="No space left"):
        save_camera(Camera.from_hfov(640, 480, 70.0), tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_where_nothing_can_be_written_the_error_names_the_file_that_was_asked_for(
    tmp_path: Path, monkeypatch
):
    def read_only(path: Path, *_, **__) -> None:
        raise OSError(errno.EROFS, "Read-only file system", str(path))

    monkeypatch.setattr(Path, "open", read_only)
    monkeypatch.setattr(Path, "unlink", read_only)
    with pytest.raises(OSError, match="Read-only") as refused:
        write_whole(tmp_path / "a.txt", "x")
    assert refused.value.filename == str(tmp_path / "a.txt")
