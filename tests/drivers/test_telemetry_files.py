"""Recorded telemetry: CSV, ULog, tlog."""

import gzip
import itertools
import math

import numpy as np
import pytest

from vwnav.drivers.telemetry_files import load_telemetry
from vwnav.errors import SourceError
from vwnav.geometry.rotations import (
    euler_from_rotation,
    rotation_from_quat,
    vector_from_rotation,
)


def csv_of(tmp_path, text: str, start_s: float = 0.0):
    path = tmp_path / "telemetry.csv"
    path.write_text(text)
    return load_telemetry(path, start_s)


def angles_deg(sensors) -> list[float]:
    angles = euler_from_rotation(rotation_from_quat(sensors.attitude.quat_wxyz))
    return [math.degrees(angle) for angle in angles]


def test_csv_is_interpolated_at_the_time_of_a_picture(tmp_path):
    telemetry = csv_of(
        tmp_path,
        "t_s, roll_deg,pitch_deg,yaw_deg,height_m,agl_m\n0,0,0,350,10,12\n1,0,20,10,20,14\n",
    )
    sensors = telemetry.at(0.5)
    assert angles_deg(sensors) == pytest.approx([0.0, 10.0, 0.0], abs=2.0)
    assert (sensors.height_m, sensors.height_t_s) == (15.0, 0.5)
    assert sensors.attitude.t_s == 0.5


def test_agl_becomes_the_range_along_the_tilted_axis(tmp_path):
    telemetry = csv_of(tmp_path, "t_s,roll_deg,agl_m\n0,60,10\n1,60,10\n")
    assert telemetry.at(0.5).rangefinder_m is None  # too oblique to be turned into a range
    telemetry = csv_of(tmp_path, "t_s,roll_deg,agl_m\n0,45,10\n1,45,10\n")
    assert telemetry.at(0.5).rangefinder_m == pytest.approx(10.0 * math.sqrt(2.0))


def test_any_subset_of_columns_and_empty_cells_will_do(tmp_path):
    telemetry = csv_of(tmp_path, "t_s,note,height_m\n0,a,\n0.5,b,3\n1,c,4\n")
    assert telemetry.at(0.75).height_m == 3.5
    assert telemetry.at(0.2).height_m is None
    assert telemetry.at(0.75).attitude is None


def test_the_start_of_the_video_is_an_offset(tmp_path):
    telemetry = csv_of(tmp_path, "t_s,height_m\n100,1\n101,2\n", start_s=100.5)
    assert telemetry.at(0.0).height_m == 1.5
    assert telemetry.at(0.0).height_t_s == 0.0


def test_outside_and_in_gaps_nothing_is_invented(tmp_path):
    telemetry = csv_of(tmp_path, "t_s,height_m,yaw_deg\n1,1,5\n2,2,5\n9,3,5\n")
    for t_s in (0.5, 5.0, 9.5):
        assert telemetry.at(t_s).height_m is None
        assert telemetry.at(t_s).attitude is None
    assert telemetry.at(9.0).height_m == 3.0


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


def test_ulog_attitude_is_near_its_ground_truth_and_height_near_the_range(data):
    path = data / "mavlink/px4-1.18_agp_1hz_300ms_gpsdenied.ulg"
    telemetry = load_telemetry(path)
    truth = pytest.importorskip("pyulog").ULog(str(path), ["vehicle_attitude_groundtruth"])
    topic = truth.data_list[0].data
    for row in range(500, 4000, 500):
        t_s = topic["timestamp"][row] / 1e6 - telemetry.start_s
        quat = telemetry.at(t_s).attitude.quat_wxyz
        dot = sum(quat[i] * topic[f"q[{i}]"][row] for i in range(4))
        assert abs(dot) > math.cos(math.radians(3.0))
    sensors = telemetry.at(40.0)
    tilt = rotation_from_quat(sensors.attitude.quat_wxyz)[2, 2]
    assert sensors.height_m == pytest.approx(sensors.rangefinder_m * tilt, abs=1.0)
    assert not sensors.on_ground
    assert telemetry.at(1.0).on_ground


@pytest.mark.parametrize("name", ["px4-1.16dev_offboard_loss", "px4-1.18_nominal"])
def test_tlog_height_agrees_with_its_rangefinder(data, name):
    telemetry = load_telemetry(data / f"mavlink/{name}.tlog.gz")
    hover = [t for t in range(20, 40) if telemetry.at(t).rangefinder_m]
    for t_s in hover:
        sensors = telemetry.at(t_s)
        tilt = rotation_from_quat(sensors.attitude.quat_wxyz)[2, 2]
        assert sensors.height_m == pytest.approx(sensors.rangefinder_m * tilt, abs=0.8)
    assert len(hover) > 10


@pytest.mark.parametrize(
    "name", ["px4-1.18_agp_1hz_300ms_gpsdenied.ulg", "px4-1.18_nominal.tlog.gz"]
)
def test_the_imu_of_a_log_comes_once_each_and_turns_as_the_attitude_does(data, name):
    telemetry = load_telemetry(data / "mavlink" / name)
    samples = [s for t in range(30, 50) for s in telemetry.at(t + 1.0, float(t)).imu]
    assert telemetry.at(40.0).imu == ()
    times_s = np.array([sample.t_s for sample in samples])
    assert np.all(np.diff(times_s) > 0.0)
    assert 30.0 < times_s[0] < 30.1
    assert 49.9 < times_s[-1] <= 50.0
    rates = np.array([sample.rates_rad_s for sample in samples])
    counted = np.trapezoid(rates, times_s, axis=0)
    quats = [telemetry.at(t).attitude.quat_wxyz for t in np.arange(30.0, 50.0, 0.02)]
    turns = [
        vector_from_rotation(rotation_from_quat(a).T @ rotation_from_quat(b))
        for a, b in itertools.pairwise(quats)
    ]
    assert counted == pytest.approx(np.sum(turns, axis=0), abs=math.radians(5.0))


def test_a_tlog_that_is_cut_off_gives_what_is_there(data, tmp_path):
    whole = gzip.decompress((data / "mavlink/px4-1.18_battery.tlog.gz").read_bytes())
    (tmp_path / "cut.tlog").write_bytes(whole[: len(whole) // 3])
    telemetry = load_telemetry(tmp_path / "cut.tlog")
    assert telemetry.at(10.0).attitude is not None
    assert telemetry.at(90.0).attitude is None
