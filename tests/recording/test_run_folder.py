"""The run folder: rows as they happen, whole files or none."""

import csv
import os
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from vwnav.errors import VwnavError
from vwnav.geometry.geodesy import LocalFrame
from vwnav.recording.run_folder import COLUMNS, TrajectoryWriter, make_run_folder, write_json
from vwnav.seams import StepResult
from vwnav.types import Estimate, MapFix, Rejected, RejectReason

HOME = LocalFrame(60.4, 22.5, 0.0)


def step(t_s, estimate=None, outcome=None):
    nothing = Rejected(t_s, RejectReason.NOT_TRIED)
    return StepResult(t_s, nothing, outcome or nothing, estimate)


def estimate():
    return Estimate(
        t_s=0.0,
        position_ned_m=np.array([1.0, 2.0, -50.0]),
        velocity_ned_m_s=np.array([3.0, 4.0, 5.0]),
        covariance=np.diag([1.0, 4.0, 9.0, 1.0, 1.0, 1.0]),
        quat_wxyz=np.array([1.0, 0.0, 0.0, 0.0]),
        sigma_yaw_rad=0.1,
        agl_m=50.0,
        sigma_agl_m=1.0,
        t_last_fix_s=None,
        reset_counter=0,
    )


def rows_of(folder, steps):
    writer = TrajectoryWriter(folder / "trajectory.csv", HOME, steps[0].t_s)
    for each in steps:
        writer.write(each)
    writer.close()
    with (folder / "trajectory.csv").open() as file:
        return list(csv.DictReader(file))


def test_time_counts_from_the_first_image_and_the_unknown_is_empty(tmp_path):
    first, second = rows_of(tmp_path, [step(100.0), step(100.5)])
    assert (first["t_s"], second["t_s"]) == ("0.0000", "0.5000")
    assert {value for name, value in first.items() if name != "t_s"} == {""}
    assert list(first) == COLUMNS


def test_an_estimate_fills_its_columns(tmp_path):
    (row,) = rows_of(tmp_path, [step(0.0, estimate())])
    values = [float(row[n]) for n in ("north_m", "down_m", "vd_m_s", "sigma_e_m")]
    assert values == [1.0, -50.0, 5.0, 2.0]
    lat, lon, _ = HOME.to_geodetic(np.array([1.0, 2.0, -50.0]))
    assert float(row["lat_deg"]) == pytest.approx(float(lat), abs=1e-8)
    assert float(row["lon_deg"]) == pytest.approx(float(lon), abs=1e-8)


def test_a_fix_and_a_rejection_say_so(tmp_path):
    fix = MapFix(0.0, 60.5, 22.6, np.eye(2), 0.5, 0.1, None, None, "nadir", "sift")
    rejected = Rejected(0.1, RejectReason.FEW_INLIERS, "", "learned")
    rows = rows_of(tmp_path, [step(0.0, outcome=fix), step(0.1, outcome=rejected)])
    assert [r["fix_status"] for r in rows] == ["fix", "few_inliers"]
    assert [r["features"] for r in rows] == ["sift", "learned"]
    assert rows[1]["fix_lat_deg"] == ""


def test_a_killed_run_keeps_its_rows_under_another_name(tmp_path):
    writer = TrajectoryWriter(tmp_path / "trajectory.csv", HOME, 0.0)
    writer.write(step(0.0))
    assert not (tmp_path / "trajectory.csv").exists()
    until_s = time.monotonic() + 20.0
    while len((tmp_path / "trajectory.csv.part").read_text().splitlines()) < 2:
        assert time.monotonic() < until_s
        time.sleep(0.01)
    writer.close()


def test_rows_whose_file_is_made_later_keep_nobody_waiting(tmp_path):
    writer = TrajectoryWriter(tmp_path / "run" / "trajectory.csv", HOME, 0.0, at_once=False)
    writer.write(step(0.0))
    writer.close()
    assert len((tmp_path / "run" / "trajectory.csv").read_text().splitlines()) == 2


def test_rows_whose_file_cannot_be_made_later_say_so_at_the_end(tmp_path):
    (tmp_path / "run").write_text("a file")
    writer = TrajectoryWriter(tmp_path / "run" / "trajectory.csv", HOME, 0.0, at_once=False)
    with pytest.raises(OSError, match="run"):
        writer.close()


def test_a_full_disk_is_said_with_the_files_name_from_the_first_line_on(tmp_path):
    (tmp_path / "trajectory.csv.part").symlink_to("/dev/full")
    with pytest.raises(OSError, match=r"trajectory\.csv\.part"):
        TrajectoryWriter(tmp_path / "trajectory.csv", HOME, 0.0)


def test_rows_end_where_the_disk_does_not_answer_for_minutes(tmp_path, monkeypatch):
    answers = threading.Event()
    monkeypatch.setattr(os, "fsync", lambda handle: answers.wait(60.0))
    writer = TrajectoryWriter(tmp_path / "trajectory.csv", HOME, 0.0)
    one = step(0.0)

    def write_for_long() -> None:
        for _ in range(30_000):
            writer.write(one)

    with pytest.raises(TimeoutError, match="does not answer"):
        write_for_long()
    answers.set()
    with pytest.raises(TimeoutError):
        writer.close()
    assert [each.name for each in tmp_path.iterdir()] == ["trajectory.csv.part"]


def test_a_folder_with_a_run_is_refused(tmp_path):
    (tmp_path / "trajectory.csv").touch()
    with pytest.raises(VwnavError, match="-o"):
        make_run_folder(tmp_path, "fly")


MAKES = (
    "import sys; from pathlib import Path; from vwnav.recording.run_folder import make_run_folder\n"
    "sys.stdin.readline()\n"
    "print(make_run_folder(Path(sys.argv[1]) if sys.argv[1:] else None, 'fly'), flush=True)\n"
    "sys.stdin.readline()\n"
)


@contextmanager
def runs(count, *words, cwd):
    """So many processes that make a run folder once they read a line, and end at the second."""
    command, pipe = [sys.executable, "-c", MAKES, *map(str, words)], subprocess.PIPE
    env = os.environ | {"PYTHONPATH": str(Path(__file__).resolve().parents[2])}
    started = [
        subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True, cwd=cwd, env=env)
        for _ in range(count)
    ]
    yield started
    for each in started:
        each.communicate(timeout=60.0)


def makes(process) -> str:
    process.stdin.write("\n")
    process.stdin.flush()
    return process.stdout.readline().strip()


def test_a_folder_that_another_run_has_is_refused_until_that_ends_in_whatever_way(tmp_path):
    folder = tmp_path / "run"
    with runs(1, folder, cwd=tmp_path) as (first,):
        assert makes(first) == str(folder)
        with pytest.raises(VwnavError, match=r"another run writes to .*; give another folder"):
            make_run_folder(folder, "fly")
        first.kill()
        first.wait()
        assert make_run_folder(folder, "fly") == folder
        assert make_run_folder(folder, "fly") == folder  # it is ours


def test_runs_that_start_at_one_time_have_a_folder_each(tmp_path):
    with runs(5, cwd=tmp_path) as started:
        for each in started:
            each.stdin.write("\n")
            each.stdin.flush()
        made = [each.stdout.readline().strip() for each in started]
    assert len({*made}) == 5
    assert {tmp_path / each for each in made} == {*(tmp_path / "runs").iterdir()}


def test_a_folder_that_appears_meanwhile_is_not_shared(tmp_path, monkeypatch):
    """Both have seen that the first name is free."""
    monkeypatch.chdir(tmp_path)
    first = make_run_folder(None, "fly")
    monkeypatch.setattr(Path, "exists", lambda path: False)
    assert make_run_folder(None, "fly") != first


def test_json_never_holds_a_nan(tmp_path):
    with pytest.raises(ValueError, match="JSON"):
        write_json(tmp_path / "run.json", {"x": float("nan")})
    assert not list(tmp_path.iterdir())
