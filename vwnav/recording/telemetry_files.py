"""Measurements of a recorded flight: CSV, ULog, tlog or vwnav's own recording."""

import logging
import math
from pathlib import Path

from vwnav.errors import SourceError
from vwnav.files.tables import named_rows
from vwnav.geometry.rotations import quat_from_rotation, rotation_from_euler
from vwnav.recording.telemetry_log import TelemetryLog
from vwnav.types import Height

_log = logging.getLogger(__name__)
_CSV_COLUMNS = ("t_s", "roll_deg", "pitch_deg", "yaw_deg", "height_m", "agl_m")
_ANGLES = ("roll_deg", "pitch_deg", "yaw_deg")


def load_telemetry(path: Path, start_s: float = 0.0) -> TelemetryLog:
    """Read a recording by its suffix: `.csv`, `.ulg`, `.tlog`, `.tlog.gz`, or vwnav's `.mcap`.

    Times of ULog and tlog count from their first attitude, those of an MCAP from its first
    image; those of a CSV are taken as they are.

    Args:
        path: the file. A CSV has a column `t_s` and any of roll_deg, pitch_deg, yaw_deg,
            height_m, agl_m; an empty cell is unknown.
        start_s: time of the recording at which the first image was taken.

    Raises:
        SourceError: it is missing, damaged, of another kind, or says nothing of use.
    """
    if not path.is_file():
        raise SourceError(f"no telemetry file {path}")
    try:
        log = _read(path)
    except OSError as error:
        raise SourceError(f"cannot read {path}: {error.strerror or error}") from error
    if log.empty:
        raise SourceError(f"{path} holds neither attitude nor height")
    if left_out := log.left_out:
        _log.warning("%s: %d measurements left out, whose time is not of those about them",
                     path, left_out)  # fmt: skip
    log.start_s += start_s
    return log


def _read(path: Path) -> TelemetryLog:
    # The readers are imported here: they bring pyulog, pymavlink or mcap, which few need.
    name = path.name.lower()
    if name.endswith(".csv"):
        return _read_csv(path)
    if name.endswith(".ulg"):
        from vwnav.recording.ulog import read_ulog

        return read_ulog(path)
    if name.endswith((".tlog", ".tlog.gz")):
        from vwnav.recording.tlog import read_tlog

        return read_tlog(path)
    if name.endswith(".mcap"):
        from vwnav.recording.recorded_telemetry import read_recorded_telemetry

        return read_recorded_telemetry(path)
    raise SourceError(f"{path} is no telemetry that vwnav reads: .csv, .ulg, .tlog[.gz] or .mcap")


def _read_csv(path: Path) -> TelemetryLog:
    log = TelemetryLog()
    with path.open(newline="", encoding="utf-8-sig", errors="replace") as file:
        columns, rows = named_rows(file, path, SourceError)
        if "t_s" not in columns or not set(columns) & set(_CSV_COLUMNS[1:]):
            raise SourceError(
                f"{path} needs a column t_s and at least one of {', '.join(_CSV_COLUMNS[1:])}; "
                f"it has {', '.join(columns) or 'none'}"
            )
        angles = [name for name in _ANGLES if name in columns]
        for line, row in rows:
            _add_row(log, _numbers(path, line, row), angles)
    return log


def _numbers(path: Path, line: int, row: dict[str, str]) -> dict[str, float]:
    numbers = {}
    for name in _CSV_COLUMNS:
        text = row.get(name, "")
        if not text:
            continue
        try:
            numbers[name] = float(text)
        except ValueError:
            numbers[name] = math.nan
        if not math.isfinite(numbers[name]):
            raise SourceError(f"{path}, line {line}: {name} is {text!r}, not a number")
    if "t_s" not in numbers:
        raise SourceError(f"{path}, line {line}: no t_s")
    return numbers


def _add_row(log: TelemetryLog, row: dict[str, float], told: list[str]) -> None:
    """A file without a column for an angle says that it is zero; an empty cell says nothing."""
    t_s = row["t_s"]
    if told and all(name in row for name in told):
        roll, pitch, yaw = (math.radians(row.get(name, 0.0)) for name in _ANGLES)
        log.add_attitude(t_s, quat_from_rotation(rotation_from_euler(roll, pitch, yaw)))
    if "height_m" in row:
        log.add(Height(t_s, row["height_m"]))
    if "agl_m" in row:
        log.add_agl(t_s, row["agl_m"])
