"""`vwnav doctor --camera --video`: what `fly` would refuse or warn of before it arms."""

import http.server
import itertools
import json
import threading
import time
from contextlib import contextmanager

import cv2
import numpy as np
import pytest

from vwnav.geometry.calibration import save_camera
from vwnav.geometry.camera import Camera


@pytest.fixture
def calibration(tmp_path):
    save_camera(Camera.from_hfov(640, 480, 70.0), tmp_path / "camera.toml")
    return tmp_path / "camera.toml"


def noise(number: int, width: int = 640, height: int = 480) -> np.ndarray:
    return np.random.default_rng(number).integers(0, 255, (height, width, 3), np.uint8)


def black(number: int) -> np.ndarray:
    return noise(number) // 100


def folder_of(path, images) -> str:
    path.mkdir()
    for number, image in enumerate(images):
        cv2.imwrite(str(path / f"{number}.png"), image)
    return str(path)


@contextmanager
def camera_of(draw, fps: float):
    """URL of a camera of the network, whose images `draw` makes of their numbers."""

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=b")
            self.end_headers()
            for number in itertools.count():
                jpeg = cv2.imencode(".jpg", draw(number))[1].tobytes()
                head = f"--b\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
                try:
                    self.wfile.write(head.encode() + jpeg + b"\r\n")
                except OSError:
                    return
                time.sleep(1.0 / fps)

        def log_message(self, *_):
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}/video.mjpg"
    server.shutdown()


def told(vwnav, *words) -> tuple[int, dict[str, str]]:
    """How it ended; its line about the camera."""
    run = vwnav("doctor", "--json", *words)
    checks = {each["name"]: each for each in json.loads(run.out)["checks"]}
    return run.code, checks["camera"]


@pytest.mark.parametrize(
    ("size_wh", "words"),
    [((320, 240), "another mode"), ((640, 360), "of another shape"), ((480, 640), "shape")],
)
def test_a_calibration_of_another_mode_of_the_camera_is_not_ready(
    vwnav, calibration, tmp_path, size_wh, words
):
    images = folder_of(tmp_path / "images", [noise(i, *size_wh) for i in range(3)])
    code, camera = told(vwnav, "--camera", calibration, "--video", images)
    assert (code, camera["verdict"]) == (3, "FAIL")
    assert "pictures of 640 x 480 px" in camera["detail"]
    assert f"are {size_wh[0]} x {size_wh[1]} px" in camera["detail"]
    assert words in camera["detail"]


def test_kept_pictures_that_fit_are_told_from_a_camera(vwnav, calibration, tmp_path):
    images = folder_of(tmp_path / "images", [noise(i) for i in range(3)])
    code, camera = told(vwnav, "--camera", calibration, "--video", images)
    assert (code, camera["verdict"]) == (0, "WARN")
    assert "kept pictures" in camera["detail"]


def test_a_camera_that_fits_passes_with_its_rate(vwnav, calibration):
    with camera_of(noise, 15.0) as url:
        code, camera = told(vwnav, "--camera", calibration, "--video", url)
        assert (code, camera["verdict"]) == (0, "PASS"), camera
        assert "640 x 480 px" in camera["detail"]
        assert "a second" in camera["detail"]


def test_whether_pictures_fit_is_not_known_without_a_calibration(vwnav):
    with camera_of(noise, 15.0) as url:
        code, camera = told(vwnav, "--video", url)
    assert (code, camera["verdict"]) == (0, "WARN")
    assert "--camera" in camera["detail"]


@pytest.mark.parametrize(
    ("draw", "fps", "verdict", "words"),
    [
        (noise, 3.0, "WARN", "10 a second are wanted"),
        (black, 15.0, "WARN", "black"),
        (lambda _: noise(1), 15.0, "FAIL", "repeats its pictures"),
    ],
)
def test_what_fly_says_of_a_camera_doctor_says(vwnav, calibration, draw, fps, verdict, words):
    with camera_of(draw, fps) as url:
        code, camera = told(vwnav, "--camera", calibration, "--video", url)
    assert (code, camera["verdict"]) == (3 if verdict == "FAIL" else 0, verdict)
    assert words in camera["detail"]


def test_a_camera_that_does_not_open_is_not_ready(vwnav, calibration):
    code, camera = told(vwnav, "--camera", calibration, "--video", "/dev/video-none")
    assert (code, camera["verdict"]) == (3, "FAIL")
