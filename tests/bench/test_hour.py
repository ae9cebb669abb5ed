"""An hour in the air: memory stays what it was, the height within its sigmas, a recording whole."""

import json
import signal
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest

from vwnav.recording.reader import is_cut_off, read_recording

pytestmark = pytest.mark.long

HOUR_S = 3600
FLIGHT = Path(__file__).with_name("hour_of_flight.py")
WRITTEN_BEHIND_S = 2.0  # what a killed recorder may not have written yet


def test_an_hour_of_flight_does_not_grow_and_leaves_its_recording_readable(tmp_path):
    pytest.importorskip("mcap")
    recording = tmp_path / "flight.mcap"
    command = [sys.executable, str(FLIGHT), str(recording), str(HOUR_S)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as flight:
        assert flight.stdout is not None
        try:
            minutes = [json.loads(flight.stdout.readline()) for _ in range(HOUR_S // 60)]
        finally:
            flight.send_signal(signal.SIGKILL)

    assert [each["t_s"] for each in minutes] == list(range(60, HOUR_S + 1, 60))
    assert all(b["fixes"] - a["fixes"] > 100 for a, b in pairwise(minutes[1:]))  # it flies
    assert all(abs(each["down_error_m"]) < 5.0 * each["sigma_down_m"] for each in minutes), minutes
    resident_mb = [each["resident_mb"] for each in minutes]
    assert max(resident_mb[5:]) - resident_mb[4] < 15.0, minutes
    assert max(resident_mb[-20:]) - resident_mb[-21] < 1.0, minutes

    assert is_cut_off(recording)
    times_s = [each.t_s for each in read_recording(recording, frozenset({"/estimate"}))]
    assert times_s[-1] - times_s[0] > HOUR_S - WRITTEN_BEHIND_S - 1.0
    assert max(b - a for a, b in pairwise(times_s)) < 0.5
