"""A live camera's exposure is held: by picamera2, by V4L2's controls, and where neither can."""

import errno
import itertools
import json
import math
import re
import sys
import threading
import time
from contextlib import suppress
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from vwnav.calibration import look as looking
from vwnav.calibration.held_light import HeldLight
from vwnav.cameras.light import v4l2
from vwnav.cameras.light.control import Light
from vwnav.cameras.live import AskedImages, RealTimeSource, V4l2Grabber
from vwnav.cameras.picamera import PicameraGrabber
from vwnav.cameras.retimed import RetimedSource
from vwnav.cli.doctor import doctor
from vwnav.errors import PreflightError, SourceError
from vwnav.geometry.calibration import save_camera
from vwnav.geometry.camera import Camera

SCENE = 60.0  # grey levels of a linear sensor in a ms, with a gain of 1
PERIOD_S = 0.01


def waited_for(true, within_s=20.0) -> bool:
    until_s = time.monotonic() + within_s
    while not true() and time.monotonic() < until_s:
        time.sleep(0.02)
    return bool(true())


class FakePicamera:
    """picamera2 with an automatic that chooses 20 ms, until it is told otherwise."""

    refuses, hangs, known = False, None, True

    def __init__(self) -> None:
        self.camera_properties, self.told = {"Model": "imx296"}, []
        self.exposure_us, self.gain = 20_000, 1.0
        self.camera_controls = {"AeEnable": (False, True, True)}
        if self.known:
            self.camera_controls |= {"ExposureTime": (29, 15_534_385, 20_000)}
            self.camera_controls |= {"AnalogueGain": (1.0, 16.0, 1.0)}

    def create_video_configuration(self, *_, **__):
        return {}

    def configure(self, _) -> None: ...
    def start(self) -> None: ...
    def close(self) -> None: ...

    def camera_configuration(self):
        return {}

    def set_controls(self, controls) -> None:
        if self.hangs is not None:
            self.hangs.wait()
        self.told.append(controls)
        if self.refuses:
            raise RuntimeError("control ExposureTime is not advertised")
        if not controls["AeEnable"]:
            self.exposure_us, self.gain = controls["ExposureTime"], controls["AnalogueGain"]

    def capture_request(self, wait: float):
        time.sleep(PERIOD_S)
        level = min(SCENE * self.exposure_us * 1e-3 * self.gain, 255.0)
        metadata = {"SensorTimestamp": time.monotonic_ns(), "ExposureTime": self.exposure_us}
        metadata["AnalogueGain"] = self.gain
        image = np.full((48, 64, 3), level, np.uint8)
        return SimpleNamespace(
            make_array=lambda _: image, get_metadata=lambda: metadata, release=lambda: None
        )


@pytest.fixture
def pi(monkeypatch):
    """A fresh kind of fake camera, those that were opened, and a source of it."""
    opened, sources = [], []

    class Picamera(FakePicamera):
        def __init__(self) -> None:
            super().__init__()
            opened.append(self)

    def start() -> RealTimeSource:
        sources.append(RealTimeSource(lambda: PicameraGrabber(64, 48, 30.0)))
        return sources[-1]

    monkeypatch.setitem(sys.modules, "picamera2", SimpleNamespace(Picamera2=Picamera))
    yield Picamera, opened, start
    for source in sources:
        source.close()


def test_a_pi_camera_is_held_under_the_limit_and_let_go_in_the_end(pi):
    _, opened, start = pi
    source, said = start(), []
    keeper = source.hold_exposure(lambda: 0.001, said.append)
    camera = opened[0]
    assert waited_for(lambda: 80.0 < SCENE * camera.exposure_us * 1e-3 * camera.gain < 136.0)
    assert camera.exposure_us <= 1000
    assert camera.gain > 1.0
    assert all(told["AeEnable"] is False for told in camera.told)
    assert waited_for(lambda: keeper.light == Light(camera.exposure_us * 1e-6, camera.gain))
    source.close()
    assert camera.told[-1]["AeEnable"] is True
    assert said == []


def test_a_camera_that_refuses_flies_on_by_itself_and_that_is_said_once(pi):
    kind, opened, start = pi
    kind.refuses = True
    source, said = start(), []
    keeper = source.hold_exposure(lambda: 0.001, said.append)
    assert waited_for(lambda: said)
    assert "keeps its own exposure" in said[0]
    assert "it refuses another (control ExposureTime is not advertised)" in said[0]
    assert keeper.light is None
    assert opened[0].told[-1]["AeEnable"] is True
    told = len(opened[0].told)
    first = source.next_frame().index
    time.sleep(0.3)
    assert source.next_frame().index > first + 5
    assert len(opened[0].told) == told
    assert len(said) == 1


def test_a_camera_without_controls_says_so(pi):
    kind, _, start = pi
    kind.known = False
    keeper = start().hold_exposure(lambda: 0.001, lambda _: None)
    assert waited_for(lambda: keeper.trouble)
    assert keeper.trouble == "it has no control for that"


def test_a_command_that_hangs_holds_up_no_image_and_no_end(pi):
    kind, _, start = pi
    kind.hangs = threading.Event()
    source = start()
    source.hold_exposure(lambda: 0.001, lambda _: None)
    time.sleep(0.3)
    indices = [source.next_frame().index for _ in range(10)]
    assert all(a < b for a, b in itertools.pairwise(indices))
    began_s = time.monotonic()
    source.close()
    assert time.monotonic() - began_s < 4.0
    kind.hangs.set()


def test_a_limit_that_cannot_be_told_ends_no_images(pi):
    _, _, start = pi
    source, said = start(), []
    source.hold_exposure(lambda: 1.0 / 0.0, said.append)
    assert waited_for(lambda: said)
    assert source.next_frame() is not None


class Steady:
    """A stream: nothing of it can be set. It ends after so many images."""

    def __init__(self, count: int) -> None:
        self.left = count

    def grab(self):
        time.sleep(PERIOD_S)
        self.left -= 1
        return None if self.left < 0 else (time.monotonic(), np.zeros((48, 64), np.uint8))

    def close(self) -> None: ...


def test_a_stream_that_comes_back_says_it_no_second_time(monkeypatch):
    monkeypatch.setattr("vwnav.cameras.live._AGAIN_S", 0.05)
    opened, said = [], []

    def open_camera():
        opened.append(Steady(50))
        return opened[-1]

    source = RetimedSource(RealTimeSource(open_camera), 0.01)
    source.hold_exposure(lambda: 0.001, said.append)
    assert waited_for(lambda: len(opened) > 2)
    source.close()
    assert said == [
        "the camera keeps its own exposure, fast flight may blur pictures: "
        "it has no control for that"
    ]


class Device:
    """The controls of a V4L2 camera behind `ioctl`, and OpenCV's side of it."""

    def __init__(self) -> None:
        self.values = {v4l2.AUTO: 3, v4l2.EXPOSURE: 200, v4l2.GAIN: 0}
        self.ranges = {v4l2.AUTO: (0, 3, 1), v4l2.EXPOSURE: (1, 5000, 1), v4l2.GAIN: (0, 255, 1)}
        self.flags, self.told, self.asked = {}, [], 0

    def ioctl(self, _, request, data):
        number = int.from_bytes(data[:4], sys.byteorder)
        if number not in self.values:
            raise OSError(errno.EINVAL, "Invalid argument")
        if request == v4l2.QUERY:
            flags = self.flags.get(number, 0)
            return v4l2.QUERIED.pack(number, 1, b"name", *self.ranges[number], 0, flags)
        if request == v4l2.SET:
            value = v4l2.CONTROL.unpack(data)[1]
            if number == v4l2.EXPOSURE and self.values[v4l2.AUTO] != v4l2.MANUAL:
                raise OSError(errno.EACCES, "Permission denied")
            self.values[number] = value
            self.told.append((number, value))
        return v4l2.CONTROL.pack(number, self.values[number])

    @property
    def level(self) -> float:
        gain = 1.0 + 15.0 * self.values.get(v4l2.GAIN, 0) / 255.0
        return min(SCENE * 0.1 * self.values[v4l2.EXPOSURE] * gain, 255.0)

    def isOpened(self) -> bool:
        return True

    def set(self, *_) -> bool:
        return True

    def get(self, what) -> float:
        self.asked += what == cv2.CAP_PROP_EXPOSURE
        now = {cv2.CAP_PROP_FPS: 30.0, cv2.CAP_PROP_EXPOSURE: self.values.get(v4l2.EXPOSURE, 0)}
        now[cv2.CAP_PROP_POS_MSEC] = 1e3 * time.monotonic()
        return float(now.get(what, 0.0))

    def grab(self) -> bool:
        time.sleep(PERIOD_S)
        return True

    def retrieve(self):
        return True, np.full((48, 64, 3), self.level, np.uint8)

    def release(self) -> None: ...


@pytest.fixture
def device(monkeypatch):
    fake = Device()
    monkeypatch.setattr("vwnav.cameras.live.cv2.VideoCapture", lambda *_: fake)
    monkeypatch.setattr("vwnav.cameras.light.v4l2.fcntl.ioctl", fake.ioctl)
    return fake


def test_a_v4l2_camera_is_held_and_left_as_it_was_found(device):
    source = RealTimeSource(lambda: V4l2Grabber("/dev/null", AskedImages()))
    source.hold_exposure(lambda: 0.001, lambda _: None)
    assert waited_for(lambda: 80.0 < device.level < 136.0)
    assert device.told[0] == (v4l2.AUTO, v4l2.MANUAL)
    assert device.values[v4l2.EXPOSURE] <= 10
    assert device.values[v4l2.GAIN] > 0
    asked = device.asked
    source.next_frame()
    source.next_frame()
    assert device.asked == asked  # what hangs in the camera would hold images up
    source.close()
    assert device.values == {v4l2.AUTO: 3, v4l2.EXPOSURE: 200, v4l2.GAIN: 0}


def test_a_v4l2_camera_without_a_gain_has_its_exposure_held(device):
    del device.values[v4l2.GAIN]
    controls = V4l2Grabber("/dev/null", AskedImages()).light_controls()
    controls.set(Light(0.0034, 7.0))
    assert controls.now() == Light(pytest.approx(0.0034), 1.0)
    assert controls.span.most_gain == 1.0
    assert controls.span.longest_s == pytest.approx(1.0 / 30.0)
    controls.release()
    assert device.values == {v4l2.AUTO: 3, v4l2.EXPOSURE: 200}


@pytest.mark.parametrize("lacks", [v4l2.AUTO, v4l2.EXPOSURE])
def test_a_v4l2_camera_without_an_exposure_is_left_alone(device, lacks):
    del device.values[lacks]
    with pytest.raises(SourceError, match="it has no control for that"):
        V4l2Grabber("/dev/null", AskedImages()).light_controls()
    device.values[lacks], device.flags[lacks] = 1, 4
    with pytest.raises(SourceError, match="it can only be read"):
        V4l2Grabber("/dev/null", AskedImages()).light_controls()


def test_what_is_no_camera_has_no_controls():
    with pytest.raises(SourceError, match="it has no control for that"):
        v4l2.V4l2LightControls("/dev/null", 0.03)


@pytest.fixture
def calibration(tmp_path):
    save_camera(Camera.from_hfov(64, 48, 66.0), tmp_path / "camera.toml")
    return tmp_path / "camera.toml"


def test_vwnav_camera_tells_exposure_gain_and_blur(device, calibration, capsys):
    looking.look(looking.LookOptions("/dev/null", calibration, 50.0, 2.0, "sift", None))
    assert re.search(
        r"\d ms, gain 1\.0: 0\.\d px of blur at 8 m/s and 50 m", capsys.readouterr().out
    )


@pytest.mark.parametrize("lacks", [None, v4l2.AUTO])
def test_doctor_tells_whether_the_exposure_is_held(device, calibration, capsys, lacks):
    device.values.pop(lacks, None)
    with suppress(PreflightError):
        doctor(None, None, calibration, "/dev/null", None, as_json=True)
    line = next(
        check["detail"]
        for check in json.loads(capsys.readouterr().out)["checks"]
        if check["name"] == "camera"
    )
    told = "of blur at 8 m/s and 50 m" if lacks is None else "keeps its own exposure"
    assert told in line


def test_words_of_a_camera_that_is_left_to_itself_and_of_what_is_not_live():
    source = RealTimeSource(lambda: Steady(100))
    held = HeldLight(source, None)
    assert waited_for(lambda: "keeps its own exposure" in held.in_words())
    source.close()
    assert HeldLight(SimpleNamespace(), None).in_words() == ""


def test_without_a_calibration_nothing_limits_and_the_blur_is_not_told(pi):
    _, opened, start = pi
    held = HeldLight(start(), None)
    assert waited_for(lambda: "ms, gain" in held.in_words())
    assert held.in_words().endswith("--camera tells its blur")
    assert waited_for(lambda: opened[0].told)
    assert math.isfinite(opened[0].gain)
