"""Where a calibration is to be written is looked at before anything is watched or fitted."""

import errno
import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from vwnav.calibration.board import write_board
from vwnav.calibration.from_board import calibrate_camera
from vwnav.calibration.from_flight import MountOptions, calibrate_mount
from vwnav.calibration.look import LookOptions, look
from vwnav.errors import CalibrationError, SourceError
from vwnav.vision.config import FeaturesConfig


def camera(output: Path) -> None:
    calibrate_camera("no such source", output)


def mount(output: Path) -> None:
    nowhere = output.parent / "nowhere"
    sift = FeaturesConfig(name="sift")
    calibrate_mount(MountOptions("none.mcap", nowhere, nowhere, None, False, sift, output))


@pytest.mark.parametrize("calibrate", [camera, mount])
@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("cam.yaml", "cam.yaml: a calibration is written as .toml or .json"),
        ("cam", "is written as .toml or .json"),
        ("nofolder/cam.toml", "no folder .*nofolder"),
        ("there.json", "is there already"),
    ],
)
def test_a_place_that_will_not_do_is_said_before_the_source_is_opened(
    tmp_path: Path, calibrate, name: str, says: str
):
    (tmp_path / "there.json").write_text("mine")
    with pytest.raises(CalibrationError, match=says):
        calibrate(tmp_path / name)
    assert (tmp_path / "there.json").read_text() == "mine"


def test_so_is_a_folder_that_may_not_be_written(tmp_path: Path, monkeypatch):
    monkeypatch.setattr(os, "access", lambda path, mode: path != tmp_path or mode != os.W_OK)
    with pytest.raises(CalibrationError, match="may not be written"):
        camera(tmp_path / "cam.toml")


@pytest.mark.parametrize("name", ["seen.txt", "nofolder/seen.jpg"])
def test_a_picture_of_what_the_camera_sees_needs_its_place_first_too(tmp_path: Path, name: str):
    options = LookOptions("no such source", None, 50.0, 3600.0, "sift", tmp_path / name)
    with pytest.raises(SourceError, match=r"give a .jpg or .png in a folder that exists"):
        look(options)


def test_its_name_may_be_of_any_bytes(tmp_path: Path):
    options = LookOptions("no such source", None, 50.0, 3600.0, "sift", tmp_path / "s\udcfc.png")
    with pytest.raises(SourceError, match="no pictures at"):
        look(options)


def test_a_picture_that_finds_no_room_leaves_no_half_of_it(tmp_path: Path, monkeypatch):
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    (tmp_path / "pictures").mkdir()
    cv2.imwrite(str(tmp_path / "pictures" / "a.png"), np.full((60, 80), 90, np.uint8))
    seen = tmp_path / "seen.jpg"
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match=r"No space left on device: .*seen\.jpg"):
        look(LookOptions(str(tmp_path / "pictures"), None, 50.0, 60.0, "orb", seen))
    assert [each.name for each in tmp_path.iterdir()] == ["pictures"]


def test_a_board_is_drawn_over_a_board_and_over_nothing_else(tmp_path):
    board, other = tmp_path / "board.pdf", tmp_path / "thesis.pdf"
    write_board(board, "a4")
    assert write_board(board, "a3").square_mm == 36
    other.write_bytes(b"%PDF-1.7 of another kind")
    with pytest.raises(CalibrationError, match="is there already"):
        write_board(other, "a4")
    assert other.read_bytes() == b"%PDF-1.7 of another kind"
