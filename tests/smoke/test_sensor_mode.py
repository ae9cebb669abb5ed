"""A calibration knows the mode of the sensor that it was made in; another of one size shows."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from board_scenes import Lens, Studio

from vwnav.geometry.calibration import load_camera, save_camera
from vwnav.geometry.camera import Camera

PI = Path(__file__).parent / "pi"
LENS = Lens(640, 480, 490.0, 492.0, 325.3, 236.2, (-0.21, 0.06, 0.0008, -0.0005, 0.01))
WHOLE, CROPPED = (1640, 1232, 10, (0, 0, 3280, 2464)), (1920, 1080, 10, (680, 692, 1920, 1080))


@pytest.fixture
def pi(tmp_path, monkeypatch):
    """A Raspberry Pi camera by its plan; returns the folder of its pictures."""
    folder = tmp_path / "pi"
    folder.mkdir()
    monkeypatch.setenv("FAKE_PI", str(folder))

    def plan(modes, chosen=0, **more):
        text = json.dumps({"modes": modes, "chosen": chosen, **more})
        (folder / "plan.json").write_text(text)

    plan([WHOLE, CROPPED])
    return folder, plan


def show(folder, images) -> None:
    for number, image in enumerate(images):
        cv2.imwrite(str(folder / f"{number:02d}.png"), image)


@pytest.fixture
def board(pi):
    studio = Studio(LENS)
    show(pi[0], (studio.view(number) for number in range(24)))


def test_a_live_calibration_keeps_the_mode_and_what_it_saw_before_the_cable_was_off(
    vwnav, tmp_path, pi, board
):
    pi[1]([WHOLE, CROPPED], pulled=[15, 2])
    done = vwnav("calibrate", "camera", "picamera2:640x480", "-o", tmp_path / "c.toml", cwd=PI)
    assert done.code == 0, done.err
    assert "views are kept: waiting for it" in done.err
    camera = load_camera(tmp_path / "c.toml")
    assert camera.sensor_mode.told() == {
        "sensor": "imx219", "read_px": [1640, 1232], "bits": 10, "seen_px": [0, 0, 3280, 2464]
    }  # fmt: skip
    assert abs(camera.K[0, 0] / LENS.fx - 1) < 2e-3


@pytest.fixture
def calibration(tmp_path):
    camera = Camera.from_hfov(640, 480, 70.0)
    save_camera(camera, tmp_path / "old.toml")
    text = (tmp_path / "old.toml").read_text()
    mode = 'sensor = "imx219"\nread_px = [1640, 1232]\nbits = 10\nseen_px = [0, 0, 3280, 2464]\n'
    (tmp_path / "camera.toml").write_text(f"{text}[sensor_mode]\n{mode}")
    return tmp_path / "camera.toml"


@pytest.fixture
def noise(pi):
    images = (np.random.default_rng(i).integers(0, 255, (480, 640, 3), np.uint8) for i in range(60))
    show(pi[0], images)


def told(vwnav, calibration):
    run = vwnav(
        "doctor", "--json", "--camera", calibration, "--video", "picamera2:640x480", cwd=PI
    )  # fmt: skip
    return {each["name"]: each for each in json.loads(run.out)["checks"]}["camera"]


def test_the_calibrated_mode_is_asked_for_where_another_would_be_chosen(
    vwnav, calibration, pi, noise
):
    pi[1]([WHOLE, CROPPED], chosen=1)
    camera = told(vwnav, calibration)
    assert camera["verdict"] == "PASS"
    assert "reads 1640x1232 px" in camera["detail"]


def test_a_mode_of_the_same_size_that_sees_less_is_not_ready(vwnav, calibration, pi, noise):
    pi[1]([CROPPED])
    camera = told(vwnav, calibration)
    assert camera["verdict"] == "FAIL"
    assert "reads 1920x1080 px, not 1640x1232 px" in camera["detail"]
    assert "shows 1920x1080 px from 680, 692 on, not 3280x2464 px from 0, 0" in camera["detail"]
    assert "calibrate in this one" in camera["detail"]


def test_a_calibration_of_before_flies_in_any_mode(vwnav, calibration, pi, noise):
    pi[1]([CROPPED])
    assert told(vwnav, calibration.with_name("old.toml"))["verdict"] == "PASS"


def test_what_the_camera_is_in_is_shown_and_held_against_the_calibration(
    vwnav, calibration, pi, noise
):
    look = ("camera", "picamera2:640x480", "--seconds", "1", "--features", "orb")
    assert "reads 1640x1232 px" in vwnav(*look, cwd=PI).out
    pi[1]([CROPPED])
    done = vwnav(*look, "--camera", calibration, cwd=PI)
    assert done.code == 1
    assert "another mode than its calibration" in done.complaint
