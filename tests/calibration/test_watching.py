"""A person shows the board to a live camera and ends it too early: what was shown is kept."""

import sys
from pathlib import Path

import numpy as np
import pytest

from vwnav.calibration import from_board
from vwnav.cameras.live import RealTimeSource
from vwnav.errors import CalibrationError
from vwnav.geometry.calibration import load_camera
from vwnav.types import Frame

sys.path.insert(0, str(Path(__file__).parents[1] / "smoke"))
from board_scenes import Lens, Studio

LENS = Lens(640, 480, 490.0, 492.0, 325.3, 236.2, (-0.21, 0.06, 0.0008, -0.0005, 0.01))
CTRL_C = None


class Shown(RealTimeSource):
    """A live camera that sees these images one after the other; None: Ctrl-C is pressed."""

    def __init__(self, images) -> None:
        self._images, self._number = iter(images), 0

    def next_frame(self):
        image = next(self._images)
        if image is CTRL_C:
            raise KeyboardInterrupt
        self._number += 1
        return Frame(0.1 * self._number, image, self._number)

    def close(self) -> None: ...


@pytest.fixture(scope="module")
def boards() -> dict[str, list[np.ndarray]]:
    studio = Studio(LENS)
    return {
        "flat": [studio.view(number, tilt_deg=0.0) for number in range(10)],
        "tilted": [studio.view(number) for number in range(24)],
    }


def calibrate(images, tmp_path, monkeypatch) -> Path:
    monkeypatch.setattr(from_board, "open_source", lambda _: Shown(images))
    from_board.calibrate_camera("/dev/video0", tmp_path / "camera.toml")
    return tmp_path / "camera.toml"


def test_who_ends_it_too_early_is_told_what_is_missing_and_goes_on(
    boards, tmp_path, monkeypatch, capsys
) -> None:
    shown = [*boards["flat"], CTRL_C, *boards["tilted"], CTRL_C]
    path = calibrate(shown, tmp_path, monkeypatch)
    assert abs(load_camera(path).K[0, 0] / LENS.fx - 1.0) < 2e-3
    said = capsys.readouterr().err
    assert said.count("tells no focal length") == 1
    assert "10 views are kept: go on, or Ctrl-C again gives them up" in said


def test_who_shows_nothing_more_gives_it_up_in_one_line(boards, tmp_path, monkeypatch) -> None:
    with pytest.raises(CalibrationError, match="tells no focal length"):
        calibrate([*boards["flat"], CTRL_C, CTRL_C], tmp_path, monkeypatch)
    assert not (tmp_path / "camera.toml").exists()
