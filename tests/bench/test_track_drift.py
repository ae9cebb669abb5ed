"""Drift against a track: of known turns and scales, and of files."""

import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.__main__ import main
from vwnav.bench.track_drift import compare, drift
from vwnav.errors import SourceError

TRACK = np.array([[0.0, 0.0], [0.0, 100.0], [50.0, 200.0], [50.0, 300.0]])


@given(st.floats(0.9, 1.1), st.floats(-0.3, 0.3))
def test_turn_and_scale_that_were_put_in_are_found(scale: float, turn_rad: float):
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    flown = TRACK @ np.array([[c, -s], [s, c]]) / scale  # turned back, and too short
    found = drift(flown, TRACK)
    assert found.scale == pytest.approx(scale)
    assert found.turn_rad == pytest.approx(turn_rad, abs=1e-9)
    assert found.end_ratio == pytest.approx(np.hypot(*(flown - TRACK)[-1]) / found.way_m)


def test_files_are_compared_at_the_tracks_moments(tmp_path):
    (tmp_path / "track.csv").write_text("t,lat,lon\n0,50,8\n1,50.001,8\n2,50.002,8\n")
    rows = "".join(f"{t},{50.0 + 0.00101 * t},8.0\n" for t in (0.0, 0.5, 1.0, 1.5, 2.0))
    (tmp_path / "flown.csv").write_text("t_s,lat_deg,lon_deg\n-1,,\n" + rows)
    found = compare(tmp_path / "flown.csv", tmp_path / "track.csv")
    assert found.end_ratio == pytest.approx(0.01, rel=1e-3)
    assert found.way_m == pytest.approx(222.5, abs=0.5)


def test_files_without_common_moments_are_refused(tmp_path):
    for name, start in (("a.csv", 0), ("b.csv", 100)):
        rows = "".join(f"{start + t},50,8\n" for t in range(4))
        (tmp_path / name).write_text("t,lat,lon\n" + rows)
    with pytest.raises(SourceError, match="moments"):
        compare(tmp_path / "a.csv", tmp_path / "b.csv")


def test_a_vehicle_that_stood_has_no_way_to_drift_on(tmp_path):
    (tmp_path / "a.csv").write_text("t,lat,lon\n" + "".join(f"{t},50,8\n" for t in range(4)))
    with pytest.raises(SourceError, match="hardly moves"):
        compare(tmp_path / "a.csv", tmp_path / "a.csv")


def test_the_command_prints_the_drift_and_refuses_what_is_no_track(tmp_path, monkeypatch, capsys):
    rows = "".join(f"{t},{50.0 + 0.001 * t},8.0\n" for t in range(4))
    (tmp_path / "a.csv").write_text("t,lat,lon\n" + rows)
    (tmp_path / "b.csv").write_text("what is this\n")
    argv = ["vwnav", "bench", "drift", str(tmp_path / "a.csv")]
    for other, code, said in (
        ("a.csv", 0, "0.00 %"),
        ("b.csv", 1, "no places"),
        ("c", 1, "cannot"),
    ):
        monkeypatch.setattr(sys, "argv", [*argv, str(tmp_path / other)])
        with pytest.raises(SystemExit) as done:
            main()
        printed = capsys.readouterr()
        assert (done.value.code or 0) == code
        assert said in printed.out + printed.err
