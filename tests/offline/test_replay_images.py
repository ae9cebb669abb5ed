"""What `vwnav replay` of pictures leaves where it does not come to its end."""

import signal
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from vwnav.__main__ import app
from vwnav.pipeline import Pipeline

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "vision"))
from vision_scenes import ground_pack, texture


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A folder with a map and two black pictures: each is looked at in no time."""
    ground_pack(tmp_path / "map.mbtiles", texture(0, 200), ())
    (tmp_path / "pictures").mkdir()
    for name in ("a.png", "b.png"):
        cv2.imwrite(str(tmp_path / "pictures" / name), np.zeros((48, 64), np.uint8))
    return tmp_path


def replay(scene: Path, *more: object):
    options = ("--map", scene / "map.mbtiles", "--features", "orb", "--hfov-deg", "70", *more)
    words = ("replay", scene / "pictures", *options, "-o", scene / "out")
    return CliRunner().invoke(app, list(map(str, words)))


def kill() -> BaseException:
    signal.raise_signal(signal.SIGTERM)
    return AssertionError("nothing has ended it")


def close_terminal() -> BaseException:
    signal.raise_signal(signal.SIGHUP)
    return AssertionError("nothing has ended it")


@pytest.mark.parametrize("ends", [KeyboardInterrupt, MemoryError, kill, close_terminal])
def test_a_replay_that_is_broken_off_leaves_nothing_and_can_be_asked_for_again(
    scene: Path, monkeypatch, ends: Callable[[], BaseException]
):
    whole_step = Pipeline.step

    def step(self, frame):
        if frame.index == 1:
            raise ends()
        return whole_step(self, frame)

    with monkeypatch.context() as during:
        during.setattr(Pipeline, "step", step)
        assert replay(scene).exit_code != 0
    assert not list((scene / "out").iterdir())
    done = replay(scene)
    assert "none of 2 pictures was located" in str(done.exception)
    assert (scene / "out" / "trajectory.csv").exists()


@pytest.mark.parametrize("t0_s", [1.7e9, 60.0, -60.0])
def test_telemetry_of_another_time_is_said_to_be_that(scene: Path, t0_s: float):
    times = [t0_s + 0.1 * i for i in range(20)]
    rows = "\n".join(f"{t_s:.3f},0,0,90" for t_s in times)
    (scene / "t.csv").write_text(f"t_s,roll_deg,pitch_deg,yaw_deg\n{rows}\n")
    said = str(replay(scene, "--telemetry", scene / "t.csv").exception)
    span = f"it goes from {t0_s:.1f} to {t0_s + 1.9:.1f} s, the pictures from 0 to"
    assert "t.csv tells no attitude of 2 of 2 pictures" in said
    assert span in said
