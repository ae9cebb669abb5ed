"""Old flights leave before the disk is full; the present one and what vwnav did not name stay."""

import os
import time
from datetime import datetime

import pytest

from vwnav.config import load_config
from vwnav.errors import ConfigError, VwnavError
from vwnav.recording import run_folder
from vwnav.recording.disk.budget import GB, DiskBudget, RecordingConfig
from vwnav.recording.reader import is_cut_off, read_recording
from vwnav.recording.recorder import Recorder
from vwnav.recording.run_folder import make_run_folder

KILOBYTE = 1000


@pytest.fixture
def runs(tmp_path):
    """Four flights of 100 kB, the last of which is the present one, and what is none of them."""
    for name in ("fly-20260101-120000", "fly-20260102-120000", "fly-20260102-120000-2",
                 "fly-20260103-120000", "fly-over-the-lake", "bench-20250101-120000"):  # fmt: skip
        (tmp_path / name / "successor").mkdir(parents=True)
        (tmp_path / name / "flight.mcap").write_bytes(bytes(90 * KILOBYTE))
        (tmp_path / name / "successor" / "flight.mcap").write_bytes(bytes(10 * KILOBYTE))
    return tmp_path


def budget(runs, kilobytes: float, free_gb=lambda: 100.0, removes: bool = True) -> DiskBudget:
    config = RecordingConfig(most_gb=kilobytes * KILOBYTE / GB, keep_free_gb=2.0)
    present = runs / "fly-20260103-120000"
    return DiskBudget(present, config, removes, lambda folder: int(free_gb() * GB))


def left(runs) -> list[str]:
    return sorted(each.name for each in runs.iterdir() if each.name.startswith("fly-2"))


@pytest.mark.parametrize(
    ("kilobytes", "removed"), [(400, 0), (399, 1), (300, 1), (250, 2), (100, 3), (50, 3)]
)
def test_the_oldest_leave_until_the_rest_keep_the_bound(runs, kilobytes, removed):
    before = left(runs)
    assert budget(runs, kilobytes).make_room() == before[:removed]
    assert left(runs) == before[removed:]
    assert (runs / "fly-over-the-lake" / "flight.mcap").exists()
    assert (runs / "bench-20250101-120000" / "flight.mcap").exists()


def test_they_leave_until_enough_of_the_disk_is_free(runs):
    free_gb = lambda: 2.5 - 0.4 * (len(left(runs)) - 2)  # noqa: E731
    assert budget(runs, 1e6, free_gb).make_room() == ["fly-20260101-120000"]


def test_recording_stops_where_nothing_more_can_be_removed(runs):
    with pytest.raises(VwnavError, match=r"only 1\.5 GB of the disk are free"):
        budget(runs, 1e6, lambda: 1.5).keep(1.0)
    assert left(runs) == ["fly-20260103-120000"]
    with pytest.raises(VwnavError, match="flights take more than"):
        budget(runs, 50).keep(1.0)


def test_a_file_that_is_renamed_while_it_is_counted_ends_no_recording(runs, monkeypatch):
    """`trajectory.csv.part` becomes `trajectory.csv`, a successor's log is removed, ..."""
    walk = os.walk

    def listed_before(folder):
        for path, folders, names in walk(folder):
            yield path, folders, [*names, "trajectory.csv.part"]

    monkeypatch.setattr(os, "walk", listed_before)
    assert budget(runs, 400).make_room() == []
    budget(runs, 400).keep(0.0)


def test_beside_a_folder_that_was_named_nothing_is_removed(runs):
    before = left(runs)
    named = budget(runs, 50, removes=False)
    named.keep(1.0)
    assert (named.make_room(), left(runs)) == ([], before)


def test_the_recorder_keeps_the_budget_in_flight_and_ends_its_file_where_it_cannot(runs, caplog):
    free = [3.0]
    path = runs / "fly-20260103-120000" / "new.mcap"
    recorder = Recorder(path, {}, budget=budget(runs, 300, lambda: free[0]))
    recorder.event(1.0, "kept")
    until_s = time.monotonic() + 20.0
    while len(left(runs)) > 2:  # 300 kB and the new one's: two of four stay
        assert time.monotonic() < until_s
        time.sleep(0.02)
    recorder.close()

    free[0] = 1.0
    full = Recorder(runs / "fly-20260103-120000" / "full.mcap", {},
                    budget=budget(runs, 300, lambda: free[0]))  # fmt: skip
    while not caplog.records:
        full.event(1.0, "lost")
        assert time.monotonic() < until_s
        time.sleep(0.02)
    full.close()
    assert "recording has stopped, the flight goes on: only 1.0 GB" in caplog.text
    assert not is_cut_off(runs / "fly-20260103-120000" / "full.mcap")
    assert [r.content["text"] for r in read_recording(path)] == ["kept"]


def test_the_bounds_are_settings(tmp_path):
    path = tmp_path / "c.toml"
    path.write_text("[recording]\nmost_gb = 4.5\nkeep_free_gb = 0.5\n")
    assert load_config(path).recording == RecordingConfig(most_gb=4.5, keep_free_gb=0.5)
    path.write_text("[recording]\nmost_gb = 0\n")
    with pytest.raises(ConfigError, match=r"recording\.most_gb = 0: expected above 0"):
        load_config(path)


def test_two_flights_of_one_second_have_a_folder_each(tmp_path, monkeypatch):
    class Stopped(datetime):
        @classmethod
        def now(cls, tz=None):
            return cls(2026, 1, 1, 12)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(run_folder, "datetime", Stopped)
    names = [make_run_folder(None, "fly").name for _ in range(3)]
    assert names == ["fly-20260101-120000", "fly-20260101-120000-2", "fly-20260101-120000-3"]
