"""`vwnav doctor` on a board: its lines, from files that look like a Raspberry Pi's."""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from vwnav.onboard import board
from vwnav.onboard.board import NOT_MEASURED, check_board, recordings_folder

NOBODY = 65534

FIRMWARE = {
    "Pi 4": "sys/devices/platform/soc/soc:firmware/get_throttled",
    "Pi 5": "sys/devices/platform/soc@107c000000/soc@107c000000:firmware/get_throttled",
}


@pytest.fixture(params=FIRMWARE)
def root(tmp_path, request):
    def put(path: str, text: str) -> None:
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text(text)

    put(FIRMWARE[request.param], "0\n")
    put("sys/class/thermal/thermal_zone0/temp", "48312\n")
    put("run/systemd/timesync/synchronized", "")
    return tmp_path


@pytest.fixture
def lines(tmp_path):
    def look(root):
        return {check.name: check for check in check_board(tmp_path, root)}

    return look


def test_a_board_in_order_passes(root, lines):
    found = lines(root)
    assert [check.verdict for name, check in found.items() if not name.startswith("disk")] == (
        ["PASS"] * 4
    )
    assert found["temperature"].detail == "48 degrees C"
    assert found["clock"].detail.endswith("synchronised")
    assert not any(NOT_MEASURED in check.detail for check in found.values())


@pytest.mark.parametrize(
    ("flags", "voltage", "throttling", "says"),
    [
        ("1", "FAIL", "PASS", "under voltage now"),
        ("10000", "WARN", "PASS", "was under voltage"),
        ("2", "PASS", "WARN", "slowed down now"),
        ("4", "PASS", "WARN", "slowed down now"),
        ("8", "PASS", "WARN", "slowed down now"),
        ("e0000", "PASS", "WARN", "was slowed down"),
        ("50005", "FAIL", "WARN", "under voltage now"),
    ],
)
def test_what_the_firmware_saw_is_said_with_what_to_do(
    root, lines, flags, voltage, throttling, says
):
    for path in FIRMWARE.values():
        if (root / path).exists():
            (root / path).write_text(flags + "\n")
    found = lines(root)
    assert (found["voltage"].verdict, found["throttling"].verdict) == (voltage, throttling)
    assert says in found["voltage"].detail + found["throttling"].detail


@pytest.mark.parametrize(
    ("celsius", "verdict", "says"),
    [(69, "PASS", "69 degrees C"), (70, "WARN", "near the 80"), (80, "WARN", "slows itself down")],
)
def test_heat_is_judged_by_the_hottest_place(root, lines, celsius, verdict, says):
    hot = root / "sys/class/thermal/thermal_zone1/temp"
    hot.parent.mkdir()
    hot.write_text(f"{celsius * 1000}\n")
    found = lines(root)["temperature"]
    assert (found.verdict, says in found.detail) == (verdict, True)


def test_a_clock_that_nobody_set_is_told_from_one_that_is_not_synchronised(
    root, lines, monkeypatch
):
    (root / "run/systemd/timesync/synchronized").unlink()
    assert "not synchronised" in lines(root)["clock"].detail
    monkeypatch.setattr(time, "time", lambda: 1000.0)
    assert "not set" in lines(root)["clock"].detail


def test_elsewhere_each_line_says_that_it_was_not_measured(tmp_path, lines):
    found = lines(tmp_path)
    for name in ("voltage", "throttling", "temperature", "clock"):
        assert found[name].detail.endswith(NOT_MEASURED)
        assert found[name].verdict == "PASS"


def test_a_disk_that_syncs_slowly_or_not_at_all_is_said(tmp_path, lines, monkeypatch):
    now_s = [0.0]
    monkeypatch.setattr(board.time, "perf_counter", lambda: now_s[0])

    def sync(seconds):
        return lambda handle: now_s.__setitem__(0, now_s[0] + seconds)

    monkeypatch.setattr(os, "fsync", sync(0.1))
    assert lines(tmp_path)["disk speed"].detail == "160 MB/s, the longest of 20 syncs 100 ms"
    monkeypatch.setattr(os, "fsync", sync(0.4))
    slow = lines(tmp_path)["disk speed"]
    assert (slow.verdict, "loses more than a second" in slow.detail) == ("WARN", True)
    monkeypatch.setattr(os, "fsync", sync(4.0))
    assert "too slow to record" in lines(tmp_path)["disk speed"].detail
    assert list(tmp_path.iterdir()) == []

    def refuse(handle):
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(os, "fsync", refuse)
    said = lines(tmp_path)["disk speed"].detail
    assert said == f"cannot write in {tmp_path}: Input/output error"


def test_recordings_go_to_runs_where_it_is_there(tmp_path):
    assert recordings_folder(tmp_path) == tmp_path
    (tmp_path / "runs").mkdir()
    assert recordings_folder(tmp_path) == tmp_path / "runs"


LOOKS = """
import sys
from pathlib import Path
from vwnav.onboard import board
folder = board.recordings_folder(Path.cwd(), Path(sys.argv[1]))
print(folder, *(f"{each.name}: {each.detail}" for each in board.check_board(folder)), sep="\\n")
"""


@pytest.fixture
def open_folder():
    """One that every user may enter, which pytest's own are not."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o755)
        yield Path(folder)


@pytest.mark.skipif(os.geteuid() != 0, reason="becomes another user")
@pytest.mark.parametrize("is_services", [True, False])
def test_in_a_folder_that_its_user_cannot_read_the_services_own_is_looked_at(
    open_folder, is_services
):
    closed, state = open_folder / "closed" / "inner", open_folder / "state"
    closed.parent.mkdir(mode=0o700)
    closed.mkdir()
    state.mkdir()
    if is_services:
        os.chown(state, NOBODY, NOBODY)
    script = f"import os; os.setgid({NOBODY}); os.setuid({NOBODY})\n{LOOKS}"
    script = f"import vwnav.onboard.board\n{script}"  # read as root: the code may be a user's own
    done = subprocess.run(
        [sys.executable, "-c", script, state], cwd=closed, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    folder, *said = done.stdout.splitlines()
    assert folder == str(state if is_services else closed)
    disk = next(line for line in said if line.startswith("disk:"))
    assert (f"GB free in {state}" if is_services else f"cannot look at {closed}") in disk
