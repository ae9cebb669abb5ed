"""Recorded telemetry: CSV, ULog, tlog."""

import gzip
import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.errors import SourceError
from vwnav.geometry.rotations import (
    euler_from_rotation,
    rotation_from_quat,
    vector_from_rotation,
)
from vwnav.recording import recorded_telemetry
from vwnav.recording.reader import VEHICLE_TOPIC, Record
from vwnav.recording.telemetry_files import load_telemetry
from vwnav.recording.telemetry_log import TelemetryLog, rising
from vwnav.types import Attitude, Height, ImuSample, Range, Stationary


def csv_of(tmp_path, text: str, start_s: float = 0.0):
    path = tmp_path / "telemetry.csv"
    path.write_text(text)
    return load_telemetry(path, start_s)


def of(kind, told) -> list:
    return [seen for seen in told if isinstance(seen, kind)]


def angles_deg(attitude) -> list[float]:
    angles = euler_from_rotation(rotation_from_quat(attitude.quat_wxyz))
    return [math.degrees(angle) for angle in angles]


def test_csv_rows_are_measurements_in_order_of_time(tmp_path):
    told = csv_of(
        tmp_path,
        "t_s, roll_deg,pitch_deg,yaw_deg,height_m,agl_m\n0,0,0,350,10,12\n0.1,0,20,10,20,14\n",
    ).measurements(0.0)
    assert [type(seen) for seen in told] == [Attitude, Height, Range] * 2
    assert [seen.t_s for seen in told] == [0.0] * 3 + [0.1] * 3
    assert angles_deg(told[3]) == pytest.approx([0.0, 20.0, 10.0])
    assert told[4].height_m == 20.0


def test_attitudes_a_second_apart_are_filled_up_so_that_each_image_has_one(tmp_path):
    told = csv_of(tmp_path, "t_s,pitch_deg,yaw_deg\n0,0,350\n1,20,10\n9,0,0\n").measurements(0.0)
    assert [seen.t_s for seen in told] == pytest.approx([*np.arange(0.0, 1.05, 0.1), 9.0])
    assert angles_deg(told[5]) == pytest.approx([0.0, 10.0, 0.0], abs=2.0)


@pytest.mark.parametrize("strange_s", [1e6, -50.0, 7.05])
def test_a_row_of_another_time_silences_none_that_follow(tmp_path, caplog, strange_s):
    """Of each kind: attitudes, heights, ranges."""
    rows = [f"{0.1 * i:.1f},0,{i},10,12" for i in range(100)]
    rows.insert(30, f"{strange_s},0,0,10,12")
    text = "\n".join(["t_s,roll_deg,yaw_deg,height_m,agl_m", *rows])
    told = csv_of(tmp_path, text).measurements(0.0)
    for kind in (Attitude, Height, Range):
        assert [seen.t_s for seen in of(kind, told)] == pytest.approx(np.arange(100) * 0.1)
    assert "3 measurements left out, whose time is not of those about them" in caplog.text


def test_an_arming_of_another_time_does_not_hold_for_the_flight():
    log = TelemetryLog()
    for t_s in np.arange(0.0, 10.0, 0.1):
        log.add(Height(t_s, 0.0))
    for t_s, armed in ((0.0, False), (1e6, True), (2.0, True), (8.0, False)):
        log.add_armed(t_s, armed)
    stands_s = [seen.t_s for seen in of(Stationary, log.measurements(0.0))]
    assert not [t_s for t_s in stands_s if 2.0 <= t_s < 8.0]
    assert max(stands_s) > 9.0


@given(
    st.lists(st.floats(0.0, 100.0), max_size=40, unique=True),
    st.lists(st.tuples(st.integers(0, 40), st.floats(-1e9, 1e9)), max_size=3),
)
def test_so_many_strange_times_cost_no_more_than_as_many_others(times_s, strange):
    shown_s = sorted(times_s)
    for at, t_s in strange:
        shown_s.insert(at, t_s)
    kept = rising(shown_s)
    assert len(kept) >= len(times_s)
    assert all(shown_s[a] < shown_s[b] for a, b in itertools.pairwise(kept))


def test_agl_becomes_the_range_along_the_tilted_axis(tmp_path):
    told = csv_of(tmp_path, "t_s,roll_deg,agl_m\n0,61,10\n0.1,61,10\n").measurements(0.0)
    assert of(Range, told) == []  # too oblique to be turned into a range
    told = csv_of(tmp_path, "t_s,roll_deg,agl_m\n0,45,10\n0.1,45,10\n").measurements(0.0)
    assert of(Range, told)[0].distance_m == pytest.approx(10.0 * math.sqrt(2.0))


def test_any_subset_of_columns_and_empty_cells_will_do(tmp_path):
    told = csv_of(tmp_path, "t_s,note,height_m\n0,a,\n0.5,b,3\n1,c,4\n").measurements(0.0)
    assert told == [Height(0.5, 3.0), Height(1.0, 4.0)]


def test_an_attitude_of_which_an_angle_is_empty_is_none(tmp_path):
    log = csv_of(tmp_path, "t_s,roll_deg,yaw_deg\n0,1,2\n0.1,,2\n0.2,1,2\n")
    assert [seen.t_s for seen in log.measurements(0.0)] == [0.0, 0.2]


def test_the_start_of_the_video_is_an_offset_and_times_are_the_images_own(tmp_path):
    log = csv_of(tmp_path, "t_s,height_m\n100,1\n101,2\n", start_s=100.5)
    assert log.measurements(0.0) == [Height(-0.5, 1.0), Height(0.5, 2.0)]
    assert log.measurements(7.0)[0].t_s == 6.5


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "needs a column t_s"),
        ("time,height\n1,2\n", "needs a column t_s"),
        ("t_s,other\n1,2\n", "at least one of"),
        ("t_s,height_m\n1,high\n", "line 2: height_m is 'high'"),
        ("t_s,height_m\n1,nan\n", "not a number"),
        ("t_s,height_m\n,3\n", "line 2: no t_s"),
        ("t_s,height_m\n", "neither attitude nor height"),
    ],
)
def test_a_wrong_csv_is_one_clear_line(tmp_path, text, words):
    with pytest.raises(SourceError, match=words) as error:
        csv_of(tmp_path, text)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", ["absent.csv", "telemetry.txt"])
def test_a_missing_or_foreign_file_is_refused(tmp_path, name):
    (tmp_path / "telemetry.txt").write_text("hello")
    with pytest.raises(SourceError, match=r"no telemetry file|no telemetry that vwnav reads"):
        load_telemetry(tmp_path / name)


@pytest.mark.parametrize("name", ["a.ulg", "a.tlog", "a.tlog.gz"])
def test_a_damaged_log_is_one_clear_line(tmp_path, name):
    for content in (b"", b"garbage" * 100, gzip.compress(b"\0" * 5000)[:40]):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(SourceError, match=r"damaged|is not a") as error:
            load_telemetry(tmp_path / name)
        assert "\n" not in str(error.value)


def test_a_recording_that_lacks_what_is_read_is_one_clear_line(tmp_path, monkeypatch):
    told = [Record(VEHICLE_TOPIC, 1.0, {"attitude": None, "armed": True})]
    monkeypatch.setattr(recorded_telemetry, "read_recording", lambda *_: told)
    (tmp_path / "a.mcap").touch()
    with pytest.raises(SourceError, match="its telemetry has no 'height_m'"):
        load_telemetry(tmp_path / "a.mcap")


def near(attitudes, t_s):
    return min(attitudes, key=lambda seen: abs(seen.t_s - t_s))


def heights_match_ranges(told, after_s: float, before_s: float, abs_m: float) -> int:
    attitudes, heights = of(Attitude, told), of(Height, told)
    ranges = [seen for seen in of(Range, told) if after_s < seen.t_s < before_s][::5]
    for seen in ranges:
        tilt = rotation_from_quat(near(attitudes, seen.t_s).quat_wxyz)[2, 2]
        height_m = near(heights, seen.t_s).height_m
        assert height_m == pytest.approx(seen.distance_m * tilt, abs=abs_m)
    return len(ranges)


def test_ulog_attitude_is_near_its_ground_truth_and_height_near_the_range(data_folder):
    path = data_folder / "mavlink/px4-1.18_agp_1hz_300ms_gpsdenied.ulg"
    log = load_telemetry(path)
    told = log.measurements(log.start_s)  # on the log's own clock
    truth = pytest.importorskip("pyulog").ULog(str(path), ["vehicle_attitude_groundtruth"])
    topic, attitudes = truth.data_list[0].data, of(Attitude, told)
    for row in range(500, 4000, 500):
        quat = near(attitudes, topic["timestamp"][row] / 1e6).quat_wxyz
        dot = sum(quat[i] * topic[f"q[{i}]"][row] for i in range(4))
        assert abs(dot) > math.cos(math.radians(3.0))
    assert heights_match_ranges(log.measurements(0.0), 39.0, 41.0, 1.0) > 0
    standing = [seen.t_s - log.start_s for seen in of(Stationary, told)]
    assert min(standing) < 1.0
    assert not any(20.0 < t_s < 60.0 for t_s in standing)


@pytest.mark.parametrize("name", ["px4-1.16dev_offboard_loss", "px4-1.18_nominal"])
def test_tlog_height_agrees_with_its_rangefinder(data_folder, name):
    told = load_telemetry(data_folder / f"mavlink/{name}.tlog.gz").measurements(0.0)
    assert heights_match_ranges(told, 20.0, 40.0, 0.8) > 10


@pytest.mark.parametrize(
    "name", ["px4-1.18_agp_1hz_300ms_gpsdenied.ulg", "px4-1.18_nominal.tlog.gz"]
)
def test_the_imu_of_a_log_turns_as_its_attitude_does(data_folder, name):
    told = load_telemetry(data_folder / "mavlink" / name).measurements(0.0)
    told = [seen for seen in told if 30.0 < seen.t_s <= 50.0]
    samples, attitudes = of(ImuSample, told), of(Attitude, told)
    times_s = np.array([sample.t_s for sample in samples])
    assert np.all(np.diff(times_s) > 0.0)
    rates = np.array([sample.rates_rad_s for sample in samples])
    counted = np.trapezoid(rates, times_s, axis=0)
    turns = [
        vector_from_rotation(rotation_from_quat(a.quat_wxyz).T @ rotation_from_quat(b.quat_wxyz))
        for a, b in itertools.pairwise(attitudes)
    ]
    assert counted == pytest.approx(np.sum(turns, axis=0), abs=math.radians(5.0))


def test_a_tlog_that_is_cut_off_gives_what_is_there(data_folder, tmp_path):
    whole = gzip.decompress((data_folder / "mavlink/px4-1.18_battery.tlog.gz").read_bytes())
    (tmp_path / "cut.tlog").write_bytes(whole[: len(whole) // 3])
    attitudes = of(Attitude, load_telemetry(tmp_path / "cut.tlog").measurements(0.0))
    assert 10.0 < attitudes[-1].t_s < 90.0
