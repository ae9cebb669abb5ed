"""Recordings: written beside the flight, readable also when the writer was killed."""

import resource
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from mcap.reader import make_reader

from vwnav.cameras.sources import open_source
from vwnav.errors import SourceError, VwnavError
from vwnav.recording import recorder as recorder_room
from vwnav.recording.reader import RecordedFrames, is_cut_off, read_recording
from vwnav.recording.recorder import Recorder, plain
from vwnav.recording.telemetry_files import load_telemetry
from vwnav.types import Attitude, Frame, Height, MapFix, Rejected, RejectReason, Stationary
from vwnav.vehicle import FlightMode, VehicleState, VelocitySetpoint

IMAGE = np.full((120, 160), 90, np.uint8)


def fix(t_s: float) -> MapFix:
    covariance = np.diag([1.0, 4.0])
    return MapFix(t_s, 60.0, 22.0, covariance, 0.1, 0.01, 50.0, None, "nadir", "learned")


def record(path, seconds: float = 3.0) -> None:
    recorder = Recorder(path, {"ekf": {"sigma_m": 1.0}}, image_rate_hz=2.0)
    for i in range(int(seconds * 30)):
        t_s = i / 30
        recorder.frame(Frame(t_s, IMAGE, i))
        recorder.outcome(fix(t_s) if i % 2 else Rejected(t_s, RejectReason.FEW_MATCHES))
        recorder.setpoint(t_s, VelocitySetpoint(1.0, 2.0, float("nan")))
        time.sleep(0.002)  # a flight is not faster than the disk
    recorder.event(seconds, "landing")
    recorder.close()


def test_what_is_recorded_is_read_back(tmp_path):
    record(tmp_path / "a.mcap")
    records = list(read_recording(tmp_path / "a.mcap"))
    fixes = [r.content for r in records if r.topic == "/fix"]
    assert len(fixes) == 90
    assert (fixes[0]["kind"], fixes[0]["reason"]) == ("rejected", "few_matches")
    assert (fixes[1]["kind"], fixes[1]["covariance_ne_m2"]) == ("fix", [[1.0, 0.0], [0.0, 4.0]])
    setpoint = next(r for r in records if r.topic == "/setpoint")
    assert setpoint.content["down_m_s"] is None
    assert records[-1].content == {"t_s": 3.0, "text": "landing"}
    assert records[-1].t_s == 3.0


def test_a_recording_whose_file_is_made_later_keeps_nobody_waiting_and_has_all(
    tmp_path, monkeypatch
):
    """As on a disk that hangs for a while."""
    goes_on, make = threading.Event(), recorder_room.make_folder

    def make_later(folder) -> None:
        goes_on.wait(60.0)
        make(folder)

    monkeypatch.setattr(recorder_room, "make_folder", make_later)
    path, began_s = tmp_path / "run" / "a.mcap", time.monotonic()
    recorder = Recorder(path, {}, at_once=False)
    recorder.frame(Frame(0.0, IMAGE, 0))
    for i in range(100):
        recorder.outcome(fix(i / 10))
    assert time.monotonic() - began_s < 5.0
    assert not path.exists()
    goes_on.set()
    recorder.close()
    kept = [r.topic for r in read_recording(path)]
    assert kept.count("/fix") == 100


def test_a_recording_that_is_made_later_and_cannot_be_is_said(tmp_path, caplog):
    (tmp_path / "run").write_text("a file")
    recorder = Recorder(tmp_path / "run" / "a.mcap", {}, at_once=False)
    recorder.event(0.0, "on route")
    recorder.close()
    assert "recording has stopped, the flight goes on: cannot record to" in caplog.text


def test_images_come_back_at_no_more_than_the_rate(tmp_path):
    record(tmp_path / "a.mcap")
    source = RecordedFrames(tmp_path / "a.mcap")
    frames = list(iter(source.next_frame, None))
    source.close()
    assert [f.t_s for f in frames] == pytest.approx([0.0, 0.5, 1.0, 1.5, 2.0, 2.5], abs=0.05)
    assert frames[1].index == 15
    assert abs(int(frames[1].image[60, 80]) - 90) < 3


def test_a_recording_is_a_source_of_images_with_its_own_telemetry(tmp_path):
    recorder = Recorder(tmp_path / "a.mcap", {}, image_rate_hz=100.0)
    for i in range(4):
        attitude = Attitude(50.0 + i, np.array([1.0, 0.0, 0.0, 0.0]))
        flags = (True, True, True, FlightMode.OFFBOARD, attitude, 10.0 * i, 50.0 + i, None, 0.9)
        recorder.vehicle(VehicleState(50.0 + i, *flags, False, True, True, 0.1))
        recorder.frame(Frame(50.5 + i, IMAGE, i))
    recorder.close()
    telemetry = load_telemetry(tmp_path / "a.mcap")
    told = telemetry.measurements(50.5)
    assert [seen for seen in told if isinstance(seen, Height)][1] == Height(51.0, 10.0)
    assert not any(isinstance(seen, Stationary) for seen in told)
    assert open_source(str(tmp_path / "a.mcap")).next_frame().t_s == 50.5


def test_any_mcap_reader_opens_it_with_the_configuration(tmp_path):
    record(tmp_path / "a.mcap")
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file)
        assert reader.get_summary().statistics.message_count > 150
        metadata = {m.name: m.metadata for m in reader.iter_metadata()}
    assert metadata["config"]["json"] == '{"ekf": {"sigma_m": 1.0}}'
    assert float(metadata["started"]["wall_clock_s"]) > 1e9


KILLED = """
import sys, time, os
from pathlib import Path
from vwnav.cameras.sources import open_source
from vwnav.recording.recorder import Recorder
recorder = Recorder(Path(sys.argv[1]), {})
for i in range(60):
    recorder.event(i / 20, str(i))
    time.sleep(0.05)
os.kill(os.getpid(), 9)
"""


def test_a_killed_recorder_leaves_all_but_the_last_second(tmp_path):
    path = tmp_path / "killed.mcap"
    done = subprocess.run([sys.executable, "-c", KILLED, str(path)])
    assert done.returncode == -9
    texts = [r.content["text"] for r in read_recording(path)]
    assert len(texts) >= 35
    assert texts == [str(i) for i in range(len(texts))]


def test_the_flight_never_waits_for_the_disk(tmp_path):
    recorder = Recorder(tmp_path / "a.mcap", {}, image_rate_hz=1000.0)
    big = np.random.default_rng(0).integers(0, 255, (1080, 1920), np.uint8)
    start_s = time.perf_counter()
    for i in range(30_000):
        recorder.frame(Frame(i / 1000, big, i))
        recorder.event(i / 1000, "x")
    assert time.perf_counter() - start_s < 7.5  # a quarter of a millisecond each
    assert recorder.dropped > 0
    recorder.close()


FULL_DISK = """
import resource, sys, time
from pathlib import Path
from vwnav.recording.recorder import Recorder
recorder = Recorder(Path(sys.argv[1]), {})
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
for i in range(260):
    recorder.sequence("/filter", i / 100, lambda i=i: {"text": str(hash(str(i))), "number": i})
    recorder.event(i / 100, str(i))
    time.sleep(0.01)
recorder.close()
print("landed")
"""


def test_a_full_disk_ends_the_recording_with_one_line_and_not_the_flight(tmp_path):
    path = tmp_path / "full.mcap"
    done = subprocess.run(
        [sys.executable, "-c", FULL_DISK, str(path)], capture_output=True, text=True
    )
    assert (done.returncode, done.stdout) == (0, "landed\n")
    assert done.stderr.count("\n") == 1
    assert "recording has stopped, the flight goes on" in done.stderr
    numbers = [r.content["number"] for r in read_recording(path, frozenset({"/filter"}))]
    assert numbers == list(range(len(numbers)))
    assert len(numbers) > 50
    assert is_cut_off(path)


def test_a_sequence_ends_where_the_disk_falls_too_far_behind(tmp_path, caplog):
    recorder = Recorder(tmp_path / "a.mcap", {})
    stalled = threading.Event()
    recorder.sequence("/filter", 0.0, lambda: {"number": 0, "late": stalled.wait()})
    for i in range(1, 30_000):
        recorder.sequence("/filter", i / 100, lambda i=i: {"number": i})
    stalled.set()
    dropped = -1
    while dropped < recorder.dropped:  # until the disk has caught up and takes messages again
        dropped = recorder.dropped
        time.sleep(0.1)
        recorder.event(300.0, "x")
    recorder.sequence("/filter", 301.0, lambda: {"number": -1})
    recorder.close()
    filtered = read_recording(tmp_path / "a.mcap", frozenset({"/filter"}))
    numbers = [r.content["number"] for r in filtered]
    assert numbers == list(range(len(numbers)))
    assert 10_000 < len(numbers) < 30_000
    assert sum("cannot be replayed" in r.message for r in caplog.records) == 1


def test_a_stamp_that_is_no_time_does_not_end_the_recording(tmp_path):
    recorder = Recorder(tmp_path / "a.mcap", {})
    for t_s in (float("nan"), float("inf"), -1e300, 1e300, 2.0):
        recorder.event(t_s, "x")
    recorder.close()
    assert [r.t_s for r in read_recording(tmp_path / "a.mcap")] == [0.0, 0.0, 0.0, 9e9, 2.0]


@pytest.mark.parametrize("share", [0.02, 0.3, 0.7, 0.99])
def test_a_recording_cut_off_anywhere_is_read_to_there(tmp_path, share):
    record(tmp_path / "a.mcap")
    whole = (tmp_path / "a.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: int(share * len(whole))])
    stamps = [r.t_s for r in read_recording(tmp_path / "a.mcap")]
    kept = [r.t_s for r in read_recording(tmp_path / "cut.mcap")]
    assert kept == stamps[: len(kept)]
    assert (is_cut_off(tmp_path / "cut.mcap"), is_cut_off(tmp_path / "a.mcap")) == (True, False)


def test_a_file_is_never_overwritten(tmp_path):
    (tmp_path / "a.mcap").write_bytes(b"precious")
    with pytest.raises(VwnavError, match="cannot record to"):
        Recorder(tmp_path / "a.mcap", {})
    assert (tmp_path / "a.mcap").read_bytes() == b"precious"


def test_a_disk_that_is_full_from_the_start_is_said(tmp_path):
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20, limits[1]))
    try:
        with pytest.raises(VwnavError, match=r"cannot record to .*a\.mcap; is there room"):
            Recorder(tmp_path / "a.mcap", {"long": "0123456789" * 10})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def test_what_is_no_recording_says_so(tmp_path):
    (tmp_path / "a.mcap").write_bytes(b"no recording, but long enough to look at")
    with pytest.raises(SourceError, match="not an MCAP file"):
        list(read_recording(tmp_path / "a.mcap"))
    with pytest.raises(SourceError, match="cannot read"):
        list(read_recording(tmp_path / "b.mcap"))


def test_plain_values_have_no_nan_and_no_arrays():
    value = {"a": np.float32(2.0), "b": (np.nan, np.inf), "c": RejectReason.PRIOR, 3: np.eye(1)}
    assert plain(value) == {"a": 2.0, "b": [None, None], "c": "prior", "3": [[1.0]]}
