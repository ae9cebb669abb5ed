"""Images from files, folders and live sources."""

import http.server
import itertools
import re
import sys
import threading
import time
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from vwnav.cameras.image_folder import ImageFolder
from vwnav.cameras.live import RealTimeSource
from vwnav.cameras.picamera import PicameraGrabber
from vwnav.cameras.retimed import RetimedSource
from vwnav.cameras.sources import open_source
from vwnav.cameras.video_container import is_bare_stream
from vwnav.cameras.video_file import VideoFile
from vwnav.errors import SourceError


def drawn(number: int, width: int = 160) -> np.ndarray:
    """A smooth image whose brightness tells its number."""
    image = np.zeros((120, width, 3), np.uint8)
    image[:] = 10 + 5 * number
    image[20:40, 20:40] = 255 - 5 * number
    return image


def write_video(path, fourcc: str, count: int = 30, fps: float = 20.0) -> None:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*fourcc), fps, (160, 120))
    assert writer.isOpened()
    for number in range(count):
        noise = np.random.default_rng(number).integers(0, 30, (120, 160, 3), np.uint8)
        writer.write(drawn(number) + noise)
    writer.release()


def frames_of(source) -> list:
    return list(iter(source.next_frame, None))


def frames_before_error(source, words: str) -> list:
    """All that comes before a SourceError, which has to match and to be one line."""
    frames, said = [], ""
    try:
        for frame in iter(source.next_frame, None):
            frames.append(frame)
    except SourceError as error:
        said = str(error)
    assert re.search(words, said), f"it ended after {len(frames)} frames, saying {said!r}"
    assert "\n" not in said
    return frames


@pytest.mark.parametrize(
    ("name", "fourcc"), [("a.mp4", "mp4v"), ("a.avi", "MJPG"), ("a.mkv", "mp4v")]
)
def test_a_video_is_read_whole_with_its_own_times(tmp_path, name, fourcc):
    write_video(tmp_path / name, fourcc)
    source = open_source(str(tmp_path / name))
    frames = frames_of(source)
    source.close()
    assert [f.index for f in frames] == list(range(30))
    assert [f.t_s for f in frames] == pytest.approx([i / 20.0 for i in range(30)], abs=1e-3)
    assert frames[7].image.shape == (120, 160, 3)
    assert abs(float(frames[7].image[100, 100].mean()) - 60.0) < 5.0


@pytest.mark.parametrize(("name", "fourcc"), [("a.avi", "MJPG"), ("a.mkv", "mp4v")])
def test_a_video_that_ends_in_an_image_gives_the_good_ones_then_one_clear_line(
    tmp_path, name, fourcc
):
    write_video(tmp_path / name, fourcc)
    whole = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(whole[: len(whole) // 2])
    frames = frames_before_error(VideoFile(tmp_path / name), "ends in the middle of picture")
    assert 5 < len(frames) < 20
    for number, frame in enumerate(frames):
        assert float(frame.image[80:, 80:].mean()) == pytest.approx(24.5 + 5 * number, abs=3.0)


@pytest.mark.parametrize("name", ["a.ts", "a.m2ts"])
def test_a_transport_stream_cut_off_within_a_packet_ends_with_an_error(tmp_path, name):
    write_video(tmp_path / name, "mp4v")
    assert len(frames_of(open_source(str(tmp_path / name)))) == 30
    whole = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(whole[: len(whole) // 2 + 50])
    frames = frames_before_error(VideoFile(tmp_path / name), "ends in the middle of picture")
    assert 5 < len(frames) < 20


def test_an_mp4_cut_anywhere_is_refused_in_one_line(tmp_path):
    write_video(tmp_path / "whole.mp4", "mp4v")
    whole = (tmp_path / "whole.mp4").read_bytes()
    for share in (0.02, 0.3, 0.9, 0.999):
        (tmp_path / "cut.mp4").write_bytes(whole[: int(len(whole) * share)])
        with pytest.raises(SourceError, match="not a video that can be opened: the file ends"):
            open_source(str(tmp_path / "cut.mp4"))


def with_index_in_front(whole: bytes) -> bytes:
    """An MP4 with `moov` before `mdat`, as phones and downloads have it; offsets shifted."""
    boxes, at = {}, 0
    while at < len(whole):
        length = int.from_bytes(whole[at : at + 4], "big")
        boxes[whole[at + 4 : at + 8]] = whole[at : at + length]
        at += length
    moov = bytearray(boxes[b"moov"])
    place = moov.index(b"stco")
    for i in range(int.from_bytes(moov[place + 8 : place + 12], "big")):
        entry = slice(place + 12 + 4 * i, place + 16 + 4 * i)
        moov[entry] = (int.from_bytes(moov[entry], "big") + len(moov)).to_bytes(4, "big")
    rest = b"".join(box for kind, box in boxes.items() if kind not in (b"ftyp", b"moov"))
    return boxes[b"ftyp"] + bytes(moov) + rest


def test_a_cut_mp4_whose_index_is_in_front_gives_the_good_images_first(tmp_path):
    path = tmp_path / "a.mp4"
    write_video(path, "mp4v")
    front = with_index_in_front(path.read_bytes())
    path.write_bytes(front)
    assert len(frames_of(open_source(str(path)))) == 30
    path.write_bytes(front[: int(len(front) * 0.7)])
    words = r"ends in the middle of picture \d+ of 30"
    assert 5 < len(frames_before_error(open_source(str(path)), words)) < 28


def test_a_stream_without_a_container_says_at_which_rate_it_is_taken(tmp_path, caplog):
    write_video(tmp_path / "a.avi", "mp4v")
    assert len(frames_of(open_source(str(tmp_path / "a.avi")))) == 30
    assert not caplog.records
    (tmp_path / "a.m4v").write_bytes(out_of_avi((tmp_path / "a.avi").read_bytes()))
    assert len(frames_of(open_source(str(tmp_path / "a.m4v")))) == 30
    (said,) = caplog.messages
    assert "a.m4v holds no times, and is taken as" in said


def out_of_avi(whole: bytes) -> bytes:
    """Its pictures as the encoder put them out."""
    at, found = whole.index(b"movi") + 4, b""
    while whole[at : at + 4] == b"00dc":
        length = int.from_bytes(whole[at + 4 : at + 8], "little")
        found += whole[at + 8 : at + 8 + length]
        at += 8 + length + length % 2
    return found


@pytest.mark.parametrize(
    ("head", "is_bare"),
    [
        (b"\x00\x00\x00\x01\x67\x42\x00\x1e", True),  # H.264
        (b"\x00\x00\x01\x40\x01\x0c\x01\xff", True),  # H.265
        (b"\x00\x00\x01\xba\x44\x00\x04\x00", False),  # MPEG program stream
        (b"\x00\x00\x00\x01mdat", False),  # a large MOV
        (b"\x00\x00\x00\x18ftyp", False),
        (b"", False),
    ],
)
def test_a_stream_without_a_container_is_known_by_its_start(head, is_bare, tmp_path):
    (tmp_path / "a").write_bytes(head)
    assert is_bare_stream(tmp_path / "a") == is_bare


@pytest.mark.parametrize("name", ["a\udcfc.mp4", "rtsp://127.0.0.1:1/\udcfc"])
def test_a_name_that_is_not_utf8_does_not_end_the_process(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a\udcfc.mp4").write_text("no video")
    with pytest.raises(SourceError, match="not UTF-8"):
        open_source(name)


def test_what_is_no_video_or_not_there_says_so(tmp_path):
    (tmp_path / "a.mp4").write_text("no video")
    with pytest.raises(SourceError, match="unknown format, or damaged"):
        open_source(str(tmp_path / "a.mp4"))
    with pytest.raises(SourceError, match="no pictures at"):
        open_source(str(tmp_path / "absent.mp4"))
    (tmp_path / "junk.jpg").write_bytes(np.random.default_rng(1).bytes(5000))
    with pytest.raises(SourceError, match=r"junk\.jpg holds no picture that can be read"):
        open_source(str(tmp_path / "junk.jpg")).next_frame()


def test_a_folder_is_read_in_natural_order_at_its_rate(tmp_path):
    for number in (10, 9, 1):
        cv2.imwrite(str(tmp_path / f"f{number}.png"), drawn(number))
    (tmp_path / "notes.txt").write_text("not a picture")
    frames = frames_of(open_source(str(tmp_path), fps=4.0))
    assert [int(f.image[100, 100, 0]) for f in frames] == [15, 55, 60]
    assert [f.t_s for f in frames] == [0.0, 0.25, 0.5]


def test_hidden_files_and_folders_are_no_pictures_of_a_folder(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), drawn(1))
    (tmp_path / "._a.png").write_bytes(b"\0\5\x16\7")
    (tmp_path / "dir.png").mkdir()
    assert len(frames_of(open_source(str(tmp_path)))) == 1


def with_exif_date(jpeg: bytes, date: str) -> bytes:
    """A JPEG with an Exif block of one tag, DateTimeOriginal."""
    text = date.encode() + b"\0"
    entry = b"\x03\x90\x02\x00" + len(text).to_bytes(4, "little") + (26).to_bytes(4, "little")
    tiff = b"II*\0\x08\0\0\0\x01\0" + entry + b"\0\0\0\0" + text
    block = b"Exif\0\0" + tiff
    return jpeg[:2] + b"\xff\xe1" + (len(block) + 2).to_bytes(2, "big") + block + jpeg[2:]


def test_times_come_from_exif_where_all_images_have_them(tmp_path):
    jpeg = cv2.imencode(".jpg", drawn(1))[1].tobytes()
    for number, second in enumerate((58, 59, 62)):
        date = f"2026:06:01 10:{second // 60:02d}:{second % 60:02d}"
        (tmp_path / f"{number}.jpg").write_bytes(with_exif_date(jpeg, date))
    assert [f.t_s for f in frames_of(ImageFolder(tmp_path, 1.0))] == [0.0, 1.0, 4.0]
    (tmp_path / "3.jpg").write_bytes(jpeg)
    assert [f.t_s for f in frames_of(ImageFolder(tmp_path, 1.0))] == [0.0, 1.0, 2.0, 3.0]


def test_a_broken_image_is_named(tmp_path):
    (tmp_path / "a.jpg").write_bytes(b"")
    with pytest.raises(SourceError, match=r"a\.jpg is not a picture"):
        ImageFolder(tmp_path, 1.0).next_frame()


def test_an_empty_folder_is_refused(tmp_path):
    with pytest.raises(SourceError, match="holds no picture"):
        open_source(str(tmp_path))


class SteadyGrabber:
    """A camera of 200 images a second that may break."""

    def __init__(self, count: int) -> None:
        self.numbers, self.closed = iter(range(count)), False

    def grab(self):
        time.sleep(0.005)
        number = next(self.numbers, None)
        return None if number is None else (float(number), drawn(number % 40))

    def close(self) -> None:
        self.closed = True


def test_a_live_camera_hands_out_the_newest_image_and_counts_the_others():
    grabber = SteadyGrabber(1000)
    source = RealTimeSource(lambda: grabber)
    first = source.next_frame()
    time.sleep(0.2)
    second = source.next_frame()
    assert second.index - first.index > 10
    assert source.dropped == second.index - first.index - 1
    source.close()
    assert grabber.closed
    assert source.next_frame() is None


def test_a_camera_that_stops_is_an_error_after_its_last_image():
    source = RealTimeSource(lambda: SteadyGrabber(1))
    assert source.next_frame().index == 0
    with pytest.raises(SourceError, match="no pictures any more"):
        source.next_frame()


def test_a_camera_that_hangs_is_an_error_in_time():
    class Hanging(SteadyGrabber):
        def grab(self):
            time.sleep(0.6)

    source = RealTimeSource(lambda: Hanging(1), timeout_s=0.2)
    with pytest.raises(SourceError, match="no pictures any more"):
        source.next_frame()


def frame_at_last(source):
    """Of a camera that fails for a while."""
    deadline = time.monotonic() + 20.0
    while time.monotonic() < deadline:
        try:
            return source.next_frame()
        except SourceError:
            time.sleep(0.02)
    return None


@pytest.mark.parametrize("pulled", ["ends", "raises"])
def test_a_camera_that_is_plugged_in_again_comes_back_by_itself(monkeypatch, pulled):
    """Pulled out after three images, not to be opened twice, then there again."""
    monkeypatch.setattr("vwnav.cameras.live._AGAIN_S", 0.05)
    opened = []

    class Pulled(SteadyGrabber):
        def grab(self):
            grabbed = super().grab()
            if grabbed is None and pulled == "raises":
                raise OSError("no such device")
            return grabbed

    def open_camera():
        opened.append(Pulled(3 if not opened else 1000))
        if len(opened) in (2, 3):
            raise SourceError("cannot open the camera")
        return opened[-1]

    source = RealTimeSource(open_camera)
    assert frames_before_error(source, "no pictures any more")
    frame = frame_at_last(source)
    assert frame is not None
    assert frame.index >= 3
    assert len(opened) == 4
    assert opened[0].closed
    source.close()
    assert opened[3].closed


def test_a_camera_that_is_not_there_yet_is_waited_for_in_flight(monkeypatch):
    monkeypatch.setattr("vwnav.cameras.live._AGAIN_S", 0.05)
    asked = []

    def open_camera():
        asked.append(time.monotonic())
        if len(asked) < 4:
            raise SourceError("cannot open the camera")
        return SteadyGrabber(1000)

    source = RealTimeSource(open_camera, at_once=False)
    began_s = time.monotonic()
    with pytest.raises(SourceError, match="no pictures any more"):
        source.next_frame()
    assert time.monotonic() - began_s < 1.0  # at once, not after the time to wait for an image
    assert frame_at_last(source) is not None
    assert len(asked) == 4
    source.close()


@pytest.mark.parametrize("name", ["/dev/video77:640x480", "rtsp://127.0.0.1:9/none"])
def test_a_camera_that_never_comes_can_be_given_up(name):
    with pytest.raises(SourceError):
        open_source(name)
    source = open_source(name, at_once=False)
    with pytest.raises(SourceError):
        source.next_frame()
    source.close()
    assert source.next_frame() is None


class MjpegHandler(http.server.BaseHTTPRequestHandler):
    def do_GET(self):
        self.send_response(200)
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=b")
        self.end_headers()
        for number in itertools.count():
            jpeg = cv2.imencode(".jpg", drawn(number % 40))[1].tobytes()
            head = f"--b\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
            try:
                self.wfile.write(head.encode() + jpeg + b"\r\n")
            except OSError:
                return
            time.sleep(0.02)

    def log_message(self, *_):
        pass


def test_a_network_stream_is_stamped_on_the_monotonic_clock():
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), MjpegHandler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    source = open_source(f"http://127.0.0.1:{server.server_port}/video.mjpg")
    frames = [source.next_frame() for _ in range(5)]
    assert frames[4].image.shape == (120, 160, 3)
    assert 0.0 < time.monotonic() - frames[4].t_s < 1.0
    assert all(a.t_s < b.t_s for a, b in itertools.pairwise(frames))
    source.close()
    server.shutdown()


def test_a_stream_nobody_sends_is_an_error():
    with pytest.raises(SourceError, match="cannot open the stream"):
        open_source("http://127.0.0.1:9/none")


def test_without_picamera2_it_says_how_to_get_it():
    with pytest.raises(SourceError, match="apt install python3-picamera2"):
        open_source("picamera2:640x480@30")


@pytest.mark.parametrize(
    ("breaks", "words"),
    [
        ("raise ValueError('numpy.dtype size changed')", "numpy.dtype size changed.*simplejpeg"),
        ("class Picamera2:\n    def __init__(self): raise OSError('no I2C')", "camera: no I2C"),
        (
            "class Picamera2:\n    def close(self): raise OSError('closed')\n"
            "    def create_video_configuration(self, *_, **__): ...\n"
            "    def configure(self, _): raise KeyError('main')",
            "camera: 'main'",
        ),
    ],
)
def test_whatever_keeps_picamera2_from_a_camera_is_one_line(tmp_path, monkeypatch, breaks, words):
    (tmp_path / "picamera2.py").write_text(breaks)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "picamera2", raising=False)
    with pytest.raises(SourceError, match=words) as said:
        open_source("picamera2:640x480")
    sys.modules.pop("picamera2", None)
    assert "\n" not in str(said.value)


class FakePicamera:
    """A Raspberry Pi camera as picamera2 has it, whose every image ends its first row at 5 s."""

    model, mode_wh = "imx219", (1640, 1232)

    def __init__(self) -> None:
        self.camera_properties = {"Model": self.model}

    def create_video_configuration(self, *_, **__):
        return {}

    def configure(self, _) -> None: ...
    def start(self) -> None: ...
    def close(self) -> None: ...

    def camera_configuration(self):
        return {"sensor": {"output_size": self.mode_wh}}

    def capture_request(self, wait: float):
        assert wait > 0.0, "a cable that is off would be waited for without end"
        return SimpleNamespace(
            make_array=lambda _: drawn(1),
            get_metadata=lambda: {"SensorTimestamp": 5_000_000_000, "ExposureTime": 4000},
            release=lambda: None,
        )


@pytest.mark.parametrize(
    ("model", "mode_wh", "readout_s"),
    [
        ("imx219", (1640, 1232), 0.02329),
        ("imx296", (1456, 1088), 0.0),
        ("imx477", (4056, 3040), 0.08686),
        ("imx477", (2028, 1520), 0.02305),
        ("imx477", (2028, 1080), 0.01638),
        ("imx477", (1332, 990), 0.00785),
        ("imx708", (4608, 2592), 0.06815),
        ("imx708_wide", (2304, 1296), 0.01732),
        ("imx708_wide_noir", (1536, 864), 0.00796),
        ("unheard of", (1640, 1232), 0.0),
        ("imx708", (640, 480), 0.0),
    ],
)
def test_a_pi_cameras_image_is_stamped_at_its_centre_row(monkeypatch, model, mode_wh, readout_s):
    """Rows of the time that the sensor's driver has; its stamp is the first row's end."""
    monkeypatch.setattr(FakePicamera, "model", model)
    monkeypatch.setattr(FakePicamera, "mode_wh", mode_wh)
    module = SimpleNamespace(Picamera2=FakePicamera)
    monkeypatch.setitem(sys.modules, "picamera2", module)
    grabbed = PicameraGrabber(1640, 1232, 30.0).grab()
    assert grabbed[0] == pytest.approx(5.0 - 0.002 + readout_s / 2, abs=1e-5)


def test_a_calibrated_offset_moves_every_stamp(tmp_path):
    for number in range(3):
        cv2.imwrite(str(tmp_path / f"{number}.png"), drawn(number))
    source = RetimedSource(open_source(str(tmp_path), fps=4.0), 0.07)
    assert [round(f.t_s, 6) for f in frames_of(source)] == [0.07, 0.32, 0.57]
    source.close()
