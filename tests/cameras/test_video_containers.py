"""Videos whose container counts otherwise than by pictures, or asks to be shown turned."""

import re
import struct
from pathlib import Path

import numpy as np
import pytest
from test_cameras import frames_before_error, frames_of, with_index_in_front, write_video

from vwnav.cameras.live import StreamGrabber
from vwnav.cameras.sources import open_source
from vwnav.cameras.video_file import VideoFile
from vwnav.errors import SourceError

COUNT = 30  # pictures, 20 a second


def video(path: Path) -> bytearray:
    """Of COUNT pictures in the container that the name says."""
    write_video(path, "MJPG" if path.suffix == ".avi" else "mp4v", COUNT)
    return bytearray(path.read_bytes())


def test_a_video_that_is_named_by_its_date_and_time_is_opened(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    name = "2026-11-28T12:00:05.mp4"
    video(Path("a.mp4"))
    Path("a.mp4").rename(name)
    assert len(frames_of(open_source(name))) == COUNT


def test_a_matroska_whose_sound_lasts_longer_is_whole(tmp_path):
    path = tmp_path / "a.mkv"
    data = video(path)
    at = data.index(b"\x44\x89\x88") + 3  # Duration (RFC 9559, 5.1.2.10), eight bytes
    (duration,) = struct.unpack_from(">d", data, at)
    struct.pack_into(">d", data, at, 1.5 * duration)
    path.write_bytes(data)
    assert len(frames_of(open_source(str(path)))) == COUNT


def test_an_avi_with_periods_without_a_picture_is_whole(tmp_path):
    path = tmp_path / "a.avi"
    data = video(path)
    movi, index = data.index(b"movi"), data.index(b"idx1")
    emptied = range(5, COUNT, 6)
    for number in emptied:
        entry = index + 8 + 16 * number
        offset, size = struct.unpack_from("<II", data, entry + 8)
        struct.pack_into("<I4sI", data, movi + offset + 4, 0, b"JUNK", size - 8)
        struct.pack_into("<I", data, entry + 12, 0)
    path.write_bytes(data)
    frames = frames_of(open_source(str(path)))
    assert len(frames) == COUNT - len(emptied)


def test_an_avi_that_promises_more_is_damaged(tmp_path):
    path = tmp_path / "a.avi"
    data = video(path)
    struct.pack_into("<I", data, data.index(b"strh") + 8 + 32, 2 * COUNT)
    path.write_bytes(data)
    words = rf"ends in the middle of picture {COUNT + 1} of {2 * COUNT}"
    assert len(frames_before_error(VideoFile(path), words)) == COUNT


def test_an_mp4_cut_without_coding_it_again_is_whole(tmp_path):
    """The pictures before the cut are in the file, as the later ones are coded on them."""
    path = tmp_path / "a.mp4"
    data = video(path)
    edits = data.index(b"elst") + 4
    timescale, _ = struct.unpack_from(">II", data, data.index(b"mdhd") + 4 + 12)
    (shown,) = struct.unpack_from(">I", data, edits + 8)
    struct.pack_into(">Ii", data, edits + 8, shown * 2 // 3, timescale // 2)
    path.write_bytes(data)
    assert 15 <= len(frames_of(open_source(str(path)))) < COUNT - 5


def test_an_mp4_whose_end_was_never_written_is_damaged(tmp_path):
    path = tmp_path / "a.mp4"
    data = bytearray(with_index_in_front(bytes(video(path))))
    keep = len(data) * 2 // 3
    path.write_bytes(data[:keep] + bytes(len(data) - keep))
    words = rf"ends in the middle of picture \d+ of {COUNT}"
    assert 5 < len(frames_before_error(VideoFile(path), words)) < COUNT


def test_a_video_with_a_broken_picture_in_its_middle_goes_on_after_it(tmp_path, caplog):
    path = tmp_path / "a.mp4"
    data = video(path)
    middle = len(data) // 2
    data[middle : middle + 3000] = bytes(3000)
    path.write_bytes(data)
    frames = frames_of(open_source(str(path)))
    assert COUNT - 3 <= len(frames) < COUNT
    assert frames[-1].t_s == pytest.approx((COUNT - 1) / 20, abs=0.01)
    (said,) = caplog.messages
    assert re.search(r"a\.mp4 is damaged about 0\.[78] s", said)


def test_a_video_that_is_broken_in_its_middle_and_at_its_end_is_damaged(tmp_path):
    path = tmp_path / "a.mp4"
    data = bytearray(with_index_in_front(bytes(video(path))))
    third = len(data) // 3
    data[third : third + 3000] = bytes(3000)
    data[2 * third :] = bytes(len(data) - 2 * third)
    path.write_bytes(data)
    words = rf"ends in the middle of picture \d+ of {COUNT}"
    assert 5 < len(frames_before_error(VideoFile(path), words)) < COUNT


def test_a_video_of_a_coding_that_is_not_known_says_which_and_what_to_do(tmp_path):
    path = tmp_path / "a.mp4"
    data = video(path).replace(b"mp4v", b"av01").replace(b"esds", b"free")
    path.write_bytes(data)
    words = r"not known here \(AV01\).*`ffmpeg -i a\.mp4 -c:v libx264 other\.mp4`"
    with pytest.raises(SourceError, match=words):
        VideoFile(path).next_frame()


@pytest.mark.parametrize("box", [b"mvhd", b"mdhd"])
def test_an_mp4_whose_index_makes_no_sense_ends_in_no_traceback(tmp_path, box):
    path = tmp_path / "a.mp4"
    data = video(path)
    at = data.index(box) + 4
    data[at : at + 24] = bytes(24)
    path.write_bytes(data)
    assert len(frames_of(open_source(str(path)))) > 0


@pytest.mark.parametrize("zeros", range(6, 20))
def test_a_matroska_that_ends_in_zeros_is_one_clear_line(tmp_path, zeros):
    (tmp_path / "a.mkv").write_bytes(b"\x1a\x45\xdf\xa3\x80" + bytes(zeros))
    with pytest.raises(SourceError, match="is not a video that can be opened"):
        VideoFile(tmp_path / "a.mkv")


@pytest.mark.parametrize("number", [0, 1, 10, COUNT - 2])
def test_a_stamp_of_the_far_future_dates_one_picture_alone(tmp_path, number):
    path = tmp_path / "a.mkv"
    data = video(path)
    before = [frame.t_s for frame in frames_of(open_source(str(path)))]
    # SimpleBlock (RFC 9559, 5.1.3.4): track 1, time in its cluster, flags, first bits of MPEG-4.
    block = re.compile(rb"\xa3[\x40-\x7f].\x81(..)[\x00\x80]\x00\x00\x01", re.DOTALL)
    times = [found.start(1) for found in block.finditer(data)]
    assert len(times) == COUNT
    struct.pack_into(">h", data, times[number], 32000)  # ms
    path.write_bytes(data)
    after = [frame.t_s for frame in frames_of(open_source(str(path)))]
    assert after == pytest.approx(before, abs=0.02)


def test_a_video_that_asks_to_be_turned_is_taken_as_it_was_taken(tmp_path, caplog):
    path = tmp_path / "a.mp4"
    data = video(path)
    as_taken = frames_of(open_source(str(path)))[0].image
    matrix = data.index(b"tkhd") + 4 + 40  # of version 0 (ISO/IEC 14496-12, 8.3.2)
    one = 1 << 16
    struct.pack_into(">9i", data, matrix, -one, 0, 0, 0, -one, 0, 160 * one, 120 * one, 1 << 30)
    path.write_bytes(data)
    turned = frames_of(open_source(str(path)))[0].image
    assert np.array_equal(turned, as_taken)
    assert np.array_equal(StreamGrabber(str(path)).grab()[1], as_taken)
    assert "turned by 180 degrees" in caplog.text
    assert caplog.text.count("\n") == 1
