"""What is asked of a live camera by its name, and what comes of it."""

import errno
import itertools
import logging
import shutil
import sys
import threading
import time

import cv2
import numpy as np
import pytest
from rtsp_server import FPS, RtspServer, bright, steadily

from vwnav.cameras import gstreamer, v4l2_crop
from vwnav.cameras.gstreamer import GstreamerGrabber
from vwnav.cameras.live import AskedImages, StreamGrabber, V4l2Grabber
from vwnav.cameras.sources import open_source
from vwnav.cameras.stream_times import StreamTimes
from vwnav.errors import SourceError
from vwnav.geometry.sensor_mode import SensorMode

FOURCC = {name: float(cv2.VideoWriter.fourcc(*name)) for name in ("MJPG", "YUYV", "GREY")}
YUYV = np.arange(480 * 640 * 2, dtype=np.uint8).reshape(480, 640, 2)


class FakeVideo:
    """A camera as OpenCV has it, of 640x480 at 25 a second, in all three formats."""

    sizes, formats, rates = [(640, 480), (1920, 1080)], list(FOURCC), [25.0, 30.0]

    def __init__(self, device, _) -> None:
        self.device, self.open = device, True
        self.now = {cv2.CAP_PROP_FOURCC: FOURCC["YUYV"], cv2.CAP_PROP_FPS: 25.0}
        self.now |= {cv2.CAP_PROP_FRAME_WIDTH: 640.0, cv2.CAP_PROP_FRAME_HEIGHT: 480.0}
        self.now[cv2.CAP_PROP_CONVERT_RGB] = 1.0

    def isOpened(self) -> bool:
        return self.open

    def set(self, what, value) -> bool:
        known = {
            cv2.CAP_PROP_FOURCC: [FOURCC[name] for name in self.formats],
            cv2.CAP_PROP_FRAME_WIDTH: [w for w, _ in self.sizes],
            cv2.CAP_PROP_FRAME_HEIGHT: [h for _, h in self.sizes],
            cv2.CAP_PROP_FPS: self.rates,
        }
        if value in known.get(what, [value]):
            self.now[what] = float(value)
        return True

    def get(self, what) -> float:
        return self.now.get(what, 0.0)

    def grab(self) -> bool:
        return True

    def retrieve(self):
        if self.now[cv2.CAP_PROP_CONVERT_RGB]:
            return True, np.zeros((480, 640, 3), np.uint8)
        gray = self.now[cv2.CAP_PROP_FOURCC] == FOURCC["GREY"]
        return True, YUYV[..., 0] if gray else YUYV

    def release(self) -> None:
        self.open = False


@pytest.fixture
def camera(monkeypatch):
    """A fresh kind of fake camera, and those that were opened."""
    opened = []

    class Video(FakeVideo):
        def __init__(self, *words) -> None:
            super().__init__(*words)
            opened.append(self)

    monkeypatch.setattr("vwnav.cameras.live.cv2.VideoCapture", Video)
    return Video, opened


@pytest.mark.parametrize("pixels", ["YUYV", "GREY"])
def test_luminance_is_taken_as_it_comes(camera, pixels):
    _, opened = camera
    source = open_source(f"/dev/null:640x480@30:{pixels}")
    image = source.next_frame().image
    source.close()
    assert np.array_equal(image, YUYV[..., 0])
    assert opened[0].device == "/dev/null"
    assert opened[0].get(cv2.CAP_PROP_FPS) == 30.0


def test_motion_jpeg_comes_in_colour_and_is_what_is_asked_where_nothing_is(camera):
    _, opened = camera
    grabber = V4l2Grabber("/dev/null", AskedImages())
    assert grabber.grab()[1].shape == (480, 640, 3)
    assert opened[0].get(cv2.CAP_PROP_FOURCC) == FOURCC["MJPG"]
    assert opened[0].get(cv2.CAP_PROP_FRAME_WIDTH) == 1920


def test_another_size_or_format_is_refused_in_one_line(camera):
    kind, opened = camera
    with pytest.raises(SourceError, match="gives 640x480@30:MJPG, which is not") as said:
        open_source("/dev/null:800x600@30:MJPG")
    assert "v4l2-ctl -d /dev/null --list-formats-ext" in str(said.value)
    assert "\n" not in str(said.value)
    kind.formats = ["YUYV"]
    with pytest.raises(SourceError, match="640x480@30:YUYV, which is not"):
        open_source("/dev/null:640x480@30:GREY")
    assert not any(each.open for each in opened)


def test_the_calibrated_format_is_taken_where_none_is_asked(camera):
    _, opened = camera
    mode = SensorMode(pixels="YUYV")
    source = open_source("/dev/null:640x480", mode=mode)
    source.next_frame()
    assert source.sensor_mode == mode
    source.close()
    asked = open_source("/dev/null:640x480:GREY", mode=mode)
    asked.next_frame()
    assert "pixels GREY, not YUYV" in mode.trouble_with(asked.sensor_mode)
    asked.close()
    assert [each.get(cv2.CAP_PROP_FOURCC) for each in opened] == [FOURCC["YUYV"], FOURCC["GREY"]]


@pytest.mark.parametrize(
    ("answer", "seen_px"),
    [
        ((1, 0, 0, 680, 692, 1920, 1080), (680, 692, 1920, 1080)),
        ((1, 0, 0, -4, 0, 1920, 1080), None),
        ((1, 0, 0, 0, 0, 0, 0), None),
        (None, None),
    ],
)
def test_the_part_of_the_sensor_is_known_where_the_driver_tells_it(
    camera, monkeypatch, answer, seen_px
):
    def ioctl(_, request, asked):
        assert request == v4l2_crop.GET_SELECTION
        assert v4l2_crop.SELECTION.unpack(asked)[:2] == (1, 0)  # of captured images, the crop
        if answer is None:
            raise OSError(errno.ENOTTY, "Inappropriate ioctl for device")
        return v4l2_crop.SELECTION.pack(*answer)

    monkeypatch.setattr("vwnav.cameras.v4l2_crop.fcntl.ioctl", ioctl)
    grabber = V4l2Grabber("/dev/null", AskedImages(pixels="GREY"))
    assert grabber.sensor_mode == SensorMode(pixels="GREY", seen_px=seen_px)


def test_another_rate_is_told_and_flown(camera, caplog):
    with caplog.at_level(logging.WARNING):
        open_source("/dev/null:640x480@60:GREY").close()
    assert "gives 640x480@25:GREY, not 60 pictures a second" in caplog.text


def test_a_picture_that_is_cut_off_is_passed_over(camera):
    kind, opened = camera
    broken = itertools.chain([False, True, True, False], itertools.repeat(True))
    whole = kind.retrieve
    kind.retrieve = lambda self: whole(self) if next(broken) else (False, None)
    source = open_source("/dev/null")
    images = [source.next_frame().image.shape for _ in range(5)]
    source.close()
    assert images == [(480, 640, 3)] * 5
    assert len(opened) == 1


def test_a_camera_whose_pictures_are_all_cut_off_has_failed(camera):
    kind, _ = camera
    kind.retrieve = lambda self: (False, None)
    assert V4l2Grabber("/dev/null", AskedImages()).grab() is None


@pytest.mark.parametrize(
    "name", ["gst:640x480@0:nix", "gst:0x480:nix", "picamera2:640x0", "/dev/null:640x480@0"]
)
def test_what_asks_for_nothing_is_one_clear_line(camera, name):
    with pytest.raises(SourceError, match="asks for 0: width, height and rate"):
        open_source(name)


def test_names_with_colons_are_names(camera, tmp_path):
    with pytest.raises(SourceError, match="no pictures at"):
        open_source("/dev/v4l/by-path/pci-0000:01:00.0-usb-0:1.3:1.0-video-index0:640x480")


def test_a_pipeline_of_gstreamer_comes_through_a_pipe(tmp_path, monkeypatch):
    """The program's place is taken by one that writes what it would, and its words."""
    launch = tmp_path / "gst-launch-1.0"
    launch.write_text(
        f"#!{sys.executable}\n"
        "import struct, sys, pathlib, time\n"
        f"pathlib.Path({str(tmp_path / 'said')!r}).write_text(' '.join(sys.argv[1:]))\n"
        "for n in range(200):\n"
        "    header = struct.pack('>4xHIQ44x', 1, 160 * 120, n * 10_000_000)\n"
        "    sys.stdout.buffer.write(struct.pack('>4xHIQ44x', 2, 5, 0) + b'video')\n"
        "    sys.stdout.buffer.write(header + (bytes([n] * 158) + b'xx') * 120)\n"
        "    sys.stdout.flush(); time.sleep(0.01)\n"
    )
    launch.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    source = open_source("gst:158x120@30:videotestsrc pattern=ball ! queue")
    frames = [source.next_frame() for _ in range(4)]
    source.close()
    assert [frame.image.shape for frame in frames] == [(120, 158)] * 4
    # The first of the pipe may have lain ready: nobody knows how old it is.
    assert all(np.all(frame.image == frame.index + 1) for frame in frames)
    said = (tmp_path / "said").read_text()
    assert said.startswith("-q videotestsrc pattern=ball ! queue ! videoconvert")
    assert "format=GRAY8,width=158,height=120 ! gdppay ! fdsink" in said


def test_a_pipeline_that_fails_says_why_in_one_line(tmp_path, monkeypatch):
    launch = tmp_path / "gst-launch-1.0"
    launch.write_text("#!/bin/sh\necho 'WARNING: erroneous pipeline: no element \"nix\"' >&2\n")
    launch.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    with pytest.raises(SourceError, match=r'gives no picture: .* no element "nix"$'):
        open_source("gst:640x480:nix")
    launch.write_text("#!/bin/sh\necho 'WARNING: erroneous pipeline: no element \"gdppay\"' >&2\n")
    with pytest.raises(SourceError, match=r"gdppay\": `sudo apt install .*plugins-bad"):
        open_source("gst:640x480:libcamerasrc")
    monkeypatch.setenv("PATH", str(tmp_path / "nothing"))
    with pytest.raises(SourceError, match="sudo apt install gstreamer"):
        open_source("gst:640x480:nix")
    with pytest.raises(SourceError, match="does not say its size"):
        open_source("gst:videotestsrc")


def test_a_pipeline_that_runs_and_gives_nothing_is_not_waited_for(tmp_path, monkeypatch):
    launch = tmp_path / "gst-launch-1.0"
    launch.write_text("#!/bin/sh\nexec sleep 60\n")
    launch.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    monkeypatch.setattr(gstreamer, "_BEGINS_S", 0.3)
    with pytest.raises(SourceError, match="it runs, and gave none"):
        open_source("gst:640x480:libcamerasrc")


def test_a_pipeline_whose_quotes_do_not_close_is_one_clear_line(tmp_path, monkeypatch):
    launch = tmp_path / "gst-launch-1.0"
    launch.write_text("#!/bin/sh\n")
    launch.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    with pytest.raises(SourceError, match="No closing quotation"):
        open_source("gst:640x480:libcamerasrc camera-name='imx")


GSTREAMER = pytest.mark.skipif(
    shutil.which("gst-launch-1.0") is None, reason="GStreamer is not installed"
)


@GSTREAMER
def test_the_real_gstreamer_gives_images():
    source = open_source("gst:322x240@30:videotestsrc is-live=true pattern=white")
    frames = [source.next_frame() for _ in range(3)]
    source.close()
    assert frames[2].image.shape == (240, 322)
    assert frames[2].image.min() > 200


@GSTREAMER
def test_an_image_of_the_real_gstreamer_that_is_read_late_keeps_its_time():
    grabber = GstreamerGrabber("videotestsrc is-live=true ! queue", 322, 240, 30.0)
    times_s = [grabber.grab()[0] for _ in range(60)]
    time.sleep(0.5)  # a busy processor: what came meanwhile waits
    times_s += [grabber.grab()[0] for _ in range(10)]
    grabber.close()
    gaps_s = np.diff(times_s[30:])
    assert np.allclose(gaps_s, 1 / 30, atol=0.02)


@pytest.mark.parametrize(
    "broken", ["b'x' * 5000", "struct.pack('>4xHIQ44x', 1, 99, 0) + b'x' * 99"]
)
def test_what_a_pipe_says_and_is_no_image_is_one_clear_line(tmp_path, monkeypatch, broken):
    launch = tmp_path / "gst-launch-1.0"
    launch.write_text(
        f"#!{sys.executable}\nimport struct, sys\nsys.stdout.buffer.write({broken})\n"
    )
    launch.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    with pytest.raises(SourceError, match="gives no picture: it ended"):
        open_source("gst:640x480:libcamerasrc")


def test_an_rtsp_camera_is_seen():
    with RtspServer(lambda: steadily(bright), (160, 120)) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        source = open_source(server.url)
        frames = [source.next_frame() for _ in range(4)]
        source.close()
        server.shutdown()
    assert frames[3].image.shape == (120, 160, 3)
    assert 0.0 < time.monotonic() - frames[3].t_s < 1.0
    levels = [float(frame.image.mean()) for frame in frames]
    assert all(abs(level % 5.0 - 0.0) < 1.5 or abs(level % 5.0 - 5.0) < 1.5 for level in levels)
    assert len(set(levels)) == 4


def test_an_rtsp_image_that_lay_ready_while_the_stream_was_opened_is_not_taken_for_a_new_one():
    """FFmpeg reads for half a second and more before it hands out the first image."""
    begun = []

    def numbered(number):
        if number == 0:
            begun[:] = [time.monotonic()]
        image = np.zeros((120, 160, 3), np.uint8)
        for digit in range(4):  # of three bits each, in four stripes
            image[:, 40 * digit : 40 * (digit + 1)] = 16 + 32 * (number >> 3 * digit & 7)
        return image

    def number_in(image):
        levels = [image[40:80, 40 * digit + 10 : 40 * digit + 30].mean() for digit in range(4)]
        return sum(round((level - 16) / 32) << 3 * digit for digit, level in enumerate(levels))

    with RtspServer(lambda: steadily(numbered), (160, 120)) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        for _ in range(2):  # pulled out, and back
            grabber = StreamGrabber(server.url)
            for _ in range(5):
                t_s, image = grabber.grab()
                sent_s = begun[0] + number_in(image) / FPS
                assert t_s == pytest.approx(sent_s - 1.0 / FPS, abs=0.1)
            grabber.close()
        server.shutdown()


def test_stamps_that_run_ahead_of_every_clock_keep_no_image_back_for_ever():
    """A camera that counts seconds where it means frames: as if all of it had lain ready."""
    times = StreamTimes()
    sent = [(t_s, times.sent_s(30.0 * t_s, t_s)) for t_s in np.arange(150) / 30.0]
    kept_back = [t_s for t_s, sent_s in sent if sent_s is None]
    assert 2.9 < max(kept_back) < 3.1
    assert all(sent_s == t_s for t_s, sent_s in sent if t_s > 3.1)


def test_an_rtsp_image_that_is_read_late_keeps_the_time_at_which_it_was_sent():
    with RtspServer(lambda: steadily(bright), (160, 120)) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        grabber = StreamGrabber(server.url)
        dates_s = [grabber.grab()[0] for _ in range(60)]
        old_s = []
        for _ in range(15):
            dates_s.append(grabber.grab()[0])
            old_s.append(time.monotonic() - dates_s[-1])
        assert min(old_s) < 0.1  # what FFmpeg had read beforehand has not set the clock
        time.sleep(0.5)  # a busy processor: what came meanwhile waits
        dates_s.append(grabber.grab()[0])
        assert time.monotonic() - dates_s[-1] > 0.4
        dates_s += [grabber.grab()[0] for _ in range(9)]
        grabber.close()
        server.shutdown()
    assert np.allclose(np.diff(dates_s[60:]), 1.0 / FPS, atol=0.02)
