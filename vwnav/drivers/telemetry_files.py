"""Attitude, height and IMU of a recorded flight: CSV, ULog, tlog or vwnav's own recording."""

import csv
import math
from bisect import bisect_right
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from vwnav.drivers.attitude_track import AttitudeTrack
from vwnav.errors import SourceError
from vwnav.geometry.rotations import quat_from_rotation, rotation_from_euler, rotation_from_quat
from vwnav.pipeline import Sensors
from vwnav.types import Attitude, ImuSample

_MAX_GAP_S = 2.0
_CSV_COLUMNS = ("t_s", "roll_deg", "pitch_deg", "yaw_deg", "height_m", "agl_m")
_ANGLES = ("roll_deg", "pitch_deg", "yaw_deg")


@dataclass
class Series:
    """A quantity over rising time."""

    times_s: list[float] = field(default_factory=list)
    values: list[float] = field(default_factory=list)

    def add(self, t_s: float, value: float) -> None:
        """Append; a sample that is not newer than the newest is dropped."""
        if not self.times_s or t_s > self.times_s[-1]:
            self.times_s.append(t_s)
            self.values.append(value)

    def at(self, t_s: float) -> float | None:
        """Interpolated, None outside and in gaps."""
        after = bisect_right(self.times_s, t_s)
        if after and self.times_s[after - 1] == t_s:
            return self.values[after - 1]
        if after in (0, len(self.times_s)):
            return None
        pair = slice(after - 1, after + 1)
        t0_s, t1_s = self.times_s[pair]
        if t1_s - t0_s > _MAX_GAP_S:
            return None
        return float(np.interp(t_s, (t0_s, t1_s), self.values[pair]))

    def last_before(self, t_s: float) -> float | None:
        """The newest value at or before `t_s`."""
        at = bisect_right(self.times_s, t_s)
        return self.values[at - 1] if at else None


@dataclass
class ImuSeries:
    """An IMU's samples over rising time: (fx, fy, fz, p, q, r) each, m/s^2 and rad/s."""

    times_s: list[float] = field(default_factory=list)
    values: list[tuple[float, ...]] = field(default_factory=list)

    def add(self, t_s: float, values: tuple[float, ...]) -> None:
        """Append; a sample that is not finite or not newer than the newest is dropped."""
        if math.isfinite(sum(values)) and (not self.times_s or t_s > self.times_s[-1]):
            self.times_s.append(t_s)
            self.values.append(values)

    def between(self, after_s: float, until_s: float, start_s: float) -> tuple[ImuSample, ...]:
        """The samples of (`after_s`, `until_s`], their times counted from `start_s`."""
        which = range(bisect_right(self.times_s, after_s), bisect_right(self.times_s, until_s))
        return tuple(
            ImuSample(
                self.times_s[i] - start_s,
                np.array(self.values[i][:3]),
                np.array(self.values[i][3:]),
            )
            for i in which
        )


@dataclass
class Telemetry:
    """What a flight's recording says, over its own time.

    Attributes:
        attitudes: of R_ned_body.
        height_m: above the start, up positive, by barometer.
        agl_m: above the ground below; `range_m` the same along the body's down axis.
        armed: 1 or 0.
        imu: accelerometer and gyro.
        start_s: time of the recording at which the first picture was taken.
    """

    attitudes: AttitudeTrack = field(default_factory=lambda: AttitudeTrack(_MAX_GAP_S))
    height_m: Series = field(default_factory=Series)
    agl_m: Series = field(default_factory=Series)
    range_m: Series = field(default_factory=Series)
    armed: Series = field(default_factory=Series)
    imu: ImuSeries = field(default_factory=ImuSeries)
    start_s: float = 0.0

    def at(self, t_s: float, since_s: float = math.inf) -> Sensors:
        """What was known `t_s` after the first picture; of the IMU, what came after `since_s`."""
        t_log_s = t_s + self.start_s
        attitude = self.attitudes.at(t_log_s)
        height_m = self.height_m.at(t_log_s)
        return Sensors(
            attitude=None if attitude is None else Attitude(t_s, attitude.quat_wxyz),
            height_m=height_m,
            height_t_s=None if height_m is None else t_s,
            rangefinder_m=self._range_at(t_log_s, attitude),
            on_ground=self.armed.last_before(t_log_s) == 0.0,
            imu=self.imu.between(since_s + self.start_s, t_log_s, self.start_s),
        )

    def _range_at(self, t_log_s: float, attitude: Attitude | None) -> float | None:
        range_m = self.range_m.at(t_log_s)
        agl_m = self.agl_m.at(t_log_s)
        if range_m is not None or agl_m is None:
            return range_m
        down = 1.0 if attitude is None else rotation_from_quat(attitude.quat_wxyz)[2, 2]
        return agl_m / down if down > 0.5 else None


def load_telemetry(path: Path, start_s: float = 0.0) -> Telemetry:
    """Read a recording by its suffix: `.csv`, `.ulg`, `.tlog`, `.tlog.gz`, or vwnav's `.mcap`.

    Times of ULog and tlog count from their first attitude, those of an MCAP from its first
    picture; those of a CSV are taken as they are.

    Args:
        path: the file. A CSV has a column `t_s` and any of roll_deg, pitch_deg, yaw_deg,
            height_m, agl_m; an empty cell is unknown.
        start_s: time of the recording at which the first picture was taken.

    Raises:
        SourceError: it is missing, damaged, of another kind, or says nothing of use.
    """
    if not path.is_file():
        raise SourceError(f"no telemetry file {path}")
    try:
        telemetry = _read(path)
    except OSError as error:
        raise SourceError(f"cannot read {path}: {error.strerror or error}") from error
    if not (len(telemetry.attitudes) or telemetry.height_m.times_s or telemetry.agl_m.times_s):
        raise SourceError(f"{path} holds neither attitude nor height")
    telemetry.start_s += start_s
    return telemetry


def _read(path: Path) -> Telemetry:
    # The readers are imported here: they bring pyulog, pymavlink or mcap, which few need.
    name = path.name.lower()
    if name.endswith(".csv"):
        return _read_csv(path)
    if name.endswith(".ulg"):
        from vwnav.drivers.ulog import read_ulog

        return read_ulog(path)
    if name.endswith((".tlog", ".tlog.gz")):
        from vwnav.drivers.tlog import read_tlog

        return read_tlog(path)
    if name.endswith(".mcap"):
        from vwnav.drivers.recorded_telemetry import read_recorded_telemetry

        return read_recorded_telemetry(path)
    raise SourceError(f"{path} is no telemetry that vwnav reads: .csv, .ulg, .tlog[.gz] or .mcap")


def _read_csv(path: Path) -> Telemetry:
    telemetry = Telemetry()
    with path.open(newline="", encoding="utf-8-sig", errors="replace") as file:
        rows = csv.DictReader(file)
        columns = [name.strip() for name in rows.fieldnames or ()]
        rows.fieldnames = columns
        if "t_s" not in columns or not set(columns) & set(_CSV_COLUMNS[1:]):
            raise SourceError(
                f"{path} needs a column t_s and at least one of {', '.join(_CSV_COLUMNS[1:])}; "
                f"it has {', '.join(columns) or 'none'}"
            )
        for row in rows:
            _add_row(telemetry, _numbers(path, rows.line_num, row))
    return telemetry


def _numbers(path: Path, line: int, row: dict[str, str | None]) -> dict[str, float]:
    numbers = {}
    for name in _CSV_COLUMNS:
        text = (row.get(name) or "").strip()
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


def _add_row(telemetry: Telemetry, row: dict[str, float]) -> None:
    t_s = row["t_s"]
    if any(name in row for name in _ANGLES):
        roll, pitch, yaw = (math.radians(row.get(name, 0.0)) for name in _ANGLES)
        telemetry.attitudes.add(t_s, quat_from_rotation(rotation_from_euler(roll, pitch, yaw)))
    if "height_m" in row:
        telemetry.height_m.add(t_s, row["height_m"])
    if "agl_m" in row:
        telemetry.agl_m.add(t_s, row["agl_m"])
