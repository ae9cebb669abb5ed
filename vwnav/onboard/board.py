"""Is the board fit to fly: voltage, throttling, temperature, clock, disk? One line each.

A Raspberry Pi's firmware says what its supply and its cooling did since it started; on a machine
without such files a line says that it was not measured.
"""

import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from vwnav.safety.check import Check, CheckVerdict

NOT_MEASURED = "not measured here"
HOT_C, THROTTLES_C = 70.0, 80.0  # a Raspberry Pi slows itself down from the latter
FREE_DISK_GB = 2.0  # above `[recording] keep_free_gb`
WRITES_MB_S = 5.0  # twenty times what a recording takes
SYNCS_S = 0.3  # what `recording.disk.thread.SYNC_S` leaves of a second
CLOCK_NOT_SET_S = 1_700_000_000.0  # 2023: a board without a clock battery starts earlier
_THROTTLED = "sys/devices/platform/soc*/soc*:firmware/get_throttled"
_TIMESYNC = "run/systemd/timesync"
_TRIAL_MB, _TRIAL_SYNCS = 16, 20
_SERVICE = Path("/var/lib/vwnav")  # the working directory of deploy/vwnav.service
# Bits of get_throttled; 16 higher stands what has been since the board started.
_UNDER_VOLTAGE, _CAPPED, _THROTTLING, _SOFT_LIMIT = 1 << 0, 1 << 1, 1 << 2, 1 << 3


def recordings_folder(here: Path, service: Path = _SERVICE) -> Path:
    """Where `fly` would put recordings: here, or where the service does whose user we are.

    That one may have no right here (`sudo -u vwnav`), and never flies from here.
    """
    runs = here / "runs"
    own = runs if os.path.isdir(runs) else here  # `Path.is_dir` raises where nothing may be read
    return service if _takes_files(service) and not _takes_files(own) else own


def _takes_files(folder: Path) -> bool:
    return os.access(folder, os.W_OK | os.X_OK)


def check_board(folder: Path, root: Path = Path("/")) -> Iterator[Check]:
    """The board's state.

    Args:
        folder: where recordings go.
        root: above `sys` and `run`.
    """
    yield from check_power_and_heat(root)
    yield _clock(root)
    yield _free_disk(folder)
    yield _disk_speed(folder)


def check_power_and_heat(root: Path = Path("/")) -> Iterator[Check]:
    """What makes it slower than it is: supply, cooling."""
    flags = _throttled_flags(root)
    yield _voltage(flags)
    yield _throttling(flags)
    yield _temperature(root)


def _throttled_flags(root: Path) -> int | None:
    """What the firmware says, from its file or by `vcgencmd get_throttled`; None: nobody knows."""
    for path in root.glob(_THROTTLED):
        with suppress(OSError, ValueError):
            return int(path.read_text(), 16)
    if root != Path("/") or shutil.which("vcgencmd") is None:
        return None
    with suppress(OSError, ValueError, subprocess.TimeoutExpired):
        command = ["vcgencmd", "get_throttled"]
        said = subprocess.run(command, capture_output=True, text=True, timeout=5.0).stdout
        return int(said.rpartition("=")[2], 16)
    return None


def _voltage(flags: int | None) -> Check:
    if flags is None:
        return Check("voltage", "PASS", NOT_MEASURED)
    advice = "give the board its own 5 V regulator (3 A, a Pi 5 5 A) on short, thick wires"
    if flags & _UNDER_VOLTAGE:
        return Check("voltage", "FAIL", f"under voltage now: {advice}")
    if flags & _UNDER_VOLTAGE << 16:
        return Check("voltage", "WARN", f"was under voltage since the board started: {advice}")
    return Check("voltage", "PASS", "enough since the board started")


def _throttling(flags: int | None) -> Check:
    if flags is None:
        return Check("throttling", "PASS", NOT_MEASURED)
    slow = _CAPPED | _THROTTLING | _SOFT_LIMIT
    advice = "mend the voltage if that is short, else cool it (heat sink in the propellers' air)"
    if flags & slow:
        return Check("throttling", "WARN", f"the processor is slowed down now: {advice}")
    if flags & slow << 16:
        return Check("throttling", "WARN", f"it was slowed down since the board started: {advice}")
    return Check("throttling", "PASS", "none since the board started")


def _temperature(root: Path) -> Check:
    found = []
    for path in root.glob("sys/class/thermal/thermal_zone*/temp"):
        with suppress(OSError, ValueError):
            found.append(int(path.read_text()) / 1000.0)
    if not found:
        return Check("temperature", "PASS", NOT_MEASURED)
    hottest = max(found)
    detail = f"{hottest:.0f} degrees C"
    if hottest >= THROTTLES_C:
        return Check("temperature", "WARN", f"{detail}: it slows itself down; cool it")
    if hottest >= HOT_C:
        return Check("temperature", "WARN", f"{detail}: near the {THROTTLES_C:.0f} of slowing down")
    return Check("temperature", "PASS", detail)


def _clock(root: Path) -> Check:
    now_s = time.time()
    date = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(now_s))
    if now_s < CLOCK_NOT_SET_S:
        return Check("clock", "WARN", f"{date}: not set; recordings are named by it: set the date")
    if not (root / _TIMESYNC).is_dir():
        return Check("clock", "PASS", f"{date}; whether it is synchronised was {NOT_MEASURED}")
    if not (root / _TIMESYNC / "synchronized").exists():
        advice = "connect to a network before the flight, or set the date (a flight needs none)"
        return Check("clock", "WARN", f"{date}: not synchronised since the start; {advice}")
    return Check("clock", "PASS", f"{date}, synchronised")


def _free_disk(folder: Path) -> Check:
    try:
        free_gb = shutil.disk_usage(folder).free / 1e9
    except OSError as error:
        return Check("disk", "WARN", f"cannot look at {folder}: {error.strerror}")
    verdict: CheckVerdict = "PASS" if free_gb >= FREE_DISK_GB else "WARN"
    advice = "" if verdict == "PASS" else "; remove something, recording stops at 1 GB"
    return Check(
        "disk", verdict, f"{free_gb:.1f} GB free in {folder}, a flight takes 1 GB an hour{advice}"
    )


def _disk_speed(folder: Path) -> Check:
    try:
        with tempfile.TemporaryFile(dir=folder, prefix=".vwnav-doctor-") as file:
            start_s = time.perf_counter()
            _write_and_sync(file.fileno(), _TRIAL_MB * 1_000_000)
            mb_s = _TRIAL_MB / (time.perf_counter() - start_s)
            longest_s = max(_write_and_sync(file.fileno(), 30_000) for _ in range(_TRIAL_SYNCS))
    except OSError as error:
        return Check("disk speed", "WARN", f"cannot write in {folder}: {error.strerror}")
    detail = f"{mb_s:.0f} MB/s, the longest of {_TRIAL_SYNCS} syncs {1e3 * longest_s:.0f} ms"
    if mb_s < WRITES_MB_S:
        return Check(
            "disk speed", "WARN", f"{detail}: too slow to record; take an A1 card or a disk"
        )
    if longest_s > SYNCS_S:
        lost = f"a power cut loses more than a second (over {1e3 * SYNCS_S:.0f} ms)"
        return Check("disk speed", "WARN", f"{detail}: {lost}; take an A1 card or a disk")
    return Check("disk speed", "PASS", detail)


def _write_and_sync(handle: int, size: int) -> float:
    """Seconds until `size` bytes that do not compress are on the disk."""
    block = os.urandom(min(size, 1_000_000))
    start_s = time.perf_counter()
    for _ in range(max(1, size // len(block))):
        os.write(handle, block)
    os.fsync(handle)
    return time.perf_counter() - start_s
