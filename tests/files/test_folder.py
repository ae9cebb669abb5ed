"""What counts as the files of a folder."""

import os
from pathlib import Path

from vwnav.files.folder import files_in

HIDDEN = b"\0\5\x16\7\0\2\0\0Mac OS X        "  # how an AppleDouble file begins (RFC 1740)


def test_hidden_files_folders_and_what_is_no_file_are_left_out(tmp_path: Path) -> None:
    for name in ("b.JPG", "a.jpg", "notes.txt"):
        (tmp_path / name).write_bytes(b"\xff\xd8")
    (tmp_path / "._a.jpg").write_bytes(HIDDEN)
    (tmp_path / "dir.jpg").mkdir()
    os.mkfifo(tmp_path / "pipe.jpg")
    (tmp_path / "gone.jpg").symlink_to(tmp_path / "nowhere.jpg")
    (tmp_path / "linked.jpg").symlink_to(tmp_path / "a.jpg")
    found = [path.name for path in files_in(tmp_path, (".jpg",))]
    assert found == ["a.jpg", "b.JPG", "linked.jpg"]
