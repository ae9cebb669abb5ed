"""The folder a run leaves: `trajectory.csv` and `run.json`, beside what others put there."""

import csv
import errno
import fcntl
import json
import math
import os
from collections.abc import Iterator
from contextlib import suppress
from datetime import datetime
from itertools import chain, count
from pathlib import Path
from typing import Any

from vwnav.errors import VwnavError
from vwnav.files.whole import named, write_whole
from vwnav.geometry.geodesy import LocalFrame
from vwnav.geometry.rotations import euler_from_rotation, rotation_from_quat
from vwnav.recording.disk.thread import DiskThread, make_folder, replace_for_good, sync_names
from vwnav.seams import StepResult
from vwnav.types import MapFix, Rejected, RejectReason

_OURS: dict[Path, int] = {}  # run folders of this process, with what locks them
_CLOSE_TIMEOUT_S = 20.0
_MOST_WAITING = 20_000  # rows: ten minutes in which the disk may stall, some 20 MB
COLUMNS = [
    "t_s",
    "lat_deg",
    "lon_deg",
    "north_m",
    "east_m",
    "down_m",
    "vn_m_s",
    "ve_m_s",
    "vd_m_s",
    "roll_deg",
    "pitch_deg",
    "yaw_deg",
    "sigma_n_m",
    "sigma_e_m",
    "sigma_d_m",
    "fix_status",
    "inliers",
    "features",
    "fix_lat_deg",
    "fix_lon_deg",
    "measured_yaw_deg",
    "commanded_yaw_deg",
]


def make_run_folder(wanted: Path | None, kind: str) -> Path:
    """Create `wanted`, or `runs/<kind>-<time>`; it is this process' own until that ends.

    Raises:
        VwnavError: the folder cannot be made, or holds another run, one that goes on too.
    """
    folder = wanted
    try:
        if folder is None:
            folder = _make_new(Path("runs") / f"{kind}-{datetime.now():%Y%m%d-%H%M%S}")
        make_folder(folder)
    except OSError as error:
        where = folder or Path("runs")
        raise VwnavError(f"cannot make the run folder {where}: {error.strerror}") from error
    if not _is_ours(folder):
        raise VwnavError(f"another run writes to {folder}; give another folder with -o")
    _check_empty(folder)
    return folder


def check_run_folder(wanted: Path | None) -> None:
    """Refuse before minutes of work what `make_run_folder` would refuse after them.

    Raises:
        VwnavError: the folder cannot be made, or holds another run.
    """
    folder = wanted or Path("runs")
    made_in = next(each for each in (folder, *folder.absolute().parents) if each.exists())
    if not made_in.is_dir() or not os.access(made_in, os.W_OK | os.X_OK):
        raise VwnavError(
            f"cannot make the run folder {folder}: {made_in} is no folder that may be written"
        )
    _check_empty(folder)


def _check_empty(folder: Path) -> None:
    if any((folder / name).exists() for name in ("trajectory.csv", "flight.mcap")):
        raise VwnavError(f"{folder} already holds a run; give another folder with -o")


def unused(folder: Path) -> Path:
    """That one or, where it exists, the next number of it.

    A flight that broke off is followed by another one of the same command.
    """
    return next(each for each in _numbered(folder) if not each.exists())


def _numbered(folder: Path) -> Iterator[Path]:
    others = (folder.with_name(f"{folder.name}-{number}") for number in count(2))
    return chain([folder], others)


def _make_new(folder: Path) -> Path:
    """That one or, where somebody has it, the next number of it: two may start at one time.

    As does a board without a battery for its clock.
    """
    make_folder(folder.parent)
    for each in _numbered(folder):
        with suppress(FileExistsError):
            each.mkdir()
            sync_names(each.parent)
            return each
    raise AssertionError  # numbers do not end


def _is_ours(folder: Path) -> bool:
    """Whether no other process has it; it is ours from then on. Where nobody can know, it is."""
    if folder.resolve() in _OURS:
        return True
    try:
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except OSError:
        return True
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        return False
    except OSError:  # a file system without locks
        os.close(handle)
        return True
    _OURS[folder.resolve()] = handle  # until the process ends, however it does
    return True


class TrajectoryWriter:
    """Writes one row of `trajectory.csv` per image, as it happens; never makes the flight wait.

    Until `close` the file is called `trajectory.csv.part`: a killed run keeps its rows, and nobody
    takes them for a whole run. After a power cut the rows older than a second are there.

    Args:
        path: of the CSV; its folder is made where it is missing.
        local_frame: NED origin of the run.
        t0_s: time of the first image; `t_s` in the file counts from it.
        at_once: the file is there, or an error raised. Else it is made by the thread that writes,
            and it is `write` that raises.

    Raises:
        OSError: the file cannot be made.
    """

    def __init__(
        self, path: Path, local_frame: LocalFrame, t0_s: float, at_once: bool = True
    ) -> None:
        self._path = path
        self._local_frame = local_frame
        self._t0_s = t0_s
        self._partial = path.with_suffix(".csv.part")
        self._named = False
        self._failure: Exception | None = None
        if at_once:
            self._open()
        first = None if at_once else self._open
        self._disk = DiskThread("trajectory", self._sync, self._fail, first)

    def _open(self) -> None:
        make_folder(self._path.parent)
        self._file = self._partial.open("w", newline="", buffering=1)
        self._rows = csv.DictWriter(self._file, COLUMNS, restval="")
        try:
            self._rows.writeheader()
        except OSError as error:
            raise named(error, self._partial) from error

    def write(self, step: StepResult, commanded_yaw_rad: float | None = None) -> None:
        """Append the row of one image.

        Raises:
            OSError: the disk failed at an earlier one, or has not answered for minutes.
        """
        if self._disk.waiting >= _MOST_WAITING:
            self._failure = self._silence()
        if self._failure is not None:
            raise self._failure
        row: dict[str, object] = {"t_s": f"{step.t_s - self._t0_s:.4f}"}
        if step.estimate is not None:
            row |= self._estimate_cells(step)
        row |= _outcome_cells(step.outcome)
        if commanded_yaw_rad is not None:
            row["commanded_yaw_deg"] = f"{math.degrees(commanded_yaw_rad):.2f}"
        self._disk.put(lambda: self._rows.writerow(row))

    def _estimate_cells(self, step: StepResult) -> dict[str, str]:
        estimate = step.estimate
        assert estimate is not None
        lat_deg, lon_deg, _ = self._local_frame.to_geodetic(estimate.position_ned_m)
        north_m, east_m, down_m = estimate.position_ned_m
        vn_m_s, ve_m_s, vd_m_s = estimate.velocity_ned_m_s
        angles = euler_from_rotation(rotation_from_quat(estimate.quat_wxyz))
        roll_deg, pitch_deg, yaw_deg = (math.degrees(a) for a in angles)
        sigmas = [math.sqrt(max(estimate.covariance[i, i], 0.0)) for i in range(3)]
        cells = {"lat_deg": f"{float(lat_deg):.8f}", "lon_deg": f"{float(lon_deg):.8f}"}
        metric = (north_m, east_m, down_m, vn_m_s, ve_m_s, vd_m_s, roll_deg, pitch_deg, yaw_deg)
        cells |= {n: f"{v:.3f}" for n, v in zip(COLUMNS[3:15], (*metric, *sigmas), strict=True)}
        return cells

    def close(self) -> None:
        """Finish the file.

        Raises:
            OSError: the disk failed; what is there keeps its name `trajectory.csv.part`.
        """
        if not self._disk.close(self._finish, _CLOSE_TIMEOUT_S):
            raise self._silence()
        if self._failure is not None:
            raise self._failure

    def _sync(self) -> None:
        os.fsync(self._file.fileno())
        if not self._named:
            sync_names(self._path.parent)
            self._named = True

    def _finish(self) -> None:
        self._file.close()
        if self._failure is None:
            replace_for_good(self._partial, self._path)

    def _fail(self, error: Exception) -> None:
        self._failure = named(error, self._partial) if isinstance(error, OSError) else error

    def _silence(self) -> OSError:
        return OSError(errno.ETIMEDOUT, "the disk does not answer", str(self._partial))


def _outcome_cells(outcome: MapFix | Rejected) -> dict[str, object]:
    if isinstance(outcome, Rejected):
        tried = outcome.reason is not RejectReason.NOT_TRIED
        cells: dict[str, object] = {"fix_status": outcome.reason.name.lower() if tried else ""}
        return cells | (
            {"inliers": outcome.stats.inliers, "features": outcome.features} if tried else {}
        )
    yaw_rad = outcome.yaw_rad
    return {
        "fix_status": "fix",
        "inliers": outcome.stats.inliers,
        "features": outcome.features,
        "fix_lat_deg": f"{outcome.lat_deg:.8f}",
        "fix_lon_deg": f"{outcome.lon_deg:.8f}",
        "measured_yaw_deg": "" if yaw_rad is None else f"{math.degrees(yaw_rad):.2f}",
    }


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write whole or not at all.

    Raises:
        OSError: it cannot be written.
    """
    write_whole(path, json.dumps(content, indent=2, allow_nan=False) + "\n")
    sync_names(path.parent)
