"""PX4's own logs (ULog), read with pyulog of the `eval` extra."""

import contextlib
import io
import logging
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from vwnav.errors import SourceError
from vwnav.machine.extras import how_to_install
from vwnav.recording.telemetry_log import TelemetryLog
from vwnav.types import Height, ImuSample, Range

_log = logging.getLogger(__name__)
_DOWNWARD = 25  # MAV_SENSOR_ROTATION_PITCH_270, PX4's ROTATION_DOWNWARD_FACING
_ARMED = 2  # vehicle_status.arming_state
_MOST_ENDS = 100  # the last message, and each search for a place to go on from, meet one
_TOPICS = [
    "vehicle_attitude",
    "vehicle_air_data",
    "distance_sensor",
    "vehicle_status",
    "sensor_combined",
]


class _LogFile(io.BufferedReader):
    """A log that is not read beyond its end again and again.

    Where a damaged head tells of a message that is longer than what is left, pyulog goes back by
    that length: to before the message, and comes there again, without end.
    """

    _ends = 0

    def read(self, size: int | None = -1, /) -> bytes:
        """As any file's.

        Raises:
            EOFError: its end was met more often than reading it once takes.
        """
        data = super().read(size)
        if size is not None and len(data) < size:
            self._ends += 1
            if self._ends > _MOST_ENDS:
                raise EOFError("a message is longer than the file")
        return data


def read_ulog(path: Path) -> TelemetryLog:
    """Attitude, barometric height, downward range, IMU and arming of a ULog.

    Raises:
        SourceError: pyulog is not installed, or the file is damaged.
    """
    try:
        from pyulog import ULog
    except ImportError as error:
        raise SourceError(
            f"reading ULog needs pyulog: {how_to_install('eval')}, or give the telemetry as CSV"
        ) from error
    try:
        with (
            contextlib.redirect_stdout(io.StringIO()),  # pyulog prints what it stumbles over
            _LogFile(io.FileIO(path)) as file,
        ):
            found = ULog(file, _TOPICS)
    except Exception as error:  # pyulog raises whatever a damaged file leads it to
        raise SourceError(f"{path} is not a ULog, or it is damaged: {error}") from error
    if found.file_corruption:
        _log.warning("%s: a part of it is damaged, and skipped", path)
    try:
        return _told(found.data_list)
    except KeyError as error:
        raise SourceError(f"{path} is of another PX4 than is read: no {error} in it") from error


def _told(data_list: list[Any]) -> TelemetryLog:
    topics = {data.name: data.data for data in reversed(data_list)}
    log = TelemetryLog()
    if "vehicle_attitude" in topics:
        _add_attitudes(log, topics["vehicle_attitude"])
    if "vehicle_air_data" in topics:
        air = topics["vehicle_air_data"]
        heights = air["baro_alt_meter"] - np.median(air["baro_alt_meter"][:20])
        for t_s, height_m in _finite(air["timestamp"], heights):
            log.add(Height(t_s, height_m))
    _add_ranges(log, [data.data for data in data_list if data.name == "distance_sensor"])
    if "vehicle_status" in topics:
        status = topics["vehicle_status"]
        for t_s, state in _finite(status["timestamp"], status["arming_state"]):
            log.add_armed(t_s, state == _ARMED)
    if "sensor_combined" in topics:
        _add_imu(log, topics["sensor_combined"])
    if (oldest := log.oldest_attitude) is not None:
        attitudes = topics["vehicle_attitude"]
        stamps = attitudes.get("timestamp_sample", attitudes["timestamp"])
        first = int(np.argmin(np.abs(stamps / 1e6 - oldest.t_s)))
        log.start_s = float(attitudes["timestamp"][first]) / 1e6
    return log


def _add_attitudes(log: TelemetryLog, topic: Any) -> None:
    quats = np.stack([topic[f"q[{i}]"] for i in range(4)], axis=1).astype(np.float64)
    # The estimate belongs to the inertial sample it was made from.
    stamps = topic.get("timestamp_sample", topic["timestamp"])
    for t_us, quat in zip(stamps, quats, strict=True):
        norm = float(np.linalg.norm(quat))
        if np.isfinite(norm) and norm > 0.5:
            log.add_attitude(float(t_us) / 1e6, quat / norm)


def _add_imu(log: TelemetryLog, topic: Any) -> None:
    names = [f"{what}[{i}]" for what in ("accelerometer_m_s2", "gyro_rad") for i in range(3)]
    values = np.stack([topic[name] for name in names], axis=1).astype(np.float64)
    for t_us, row in zip(topic["timestamp"].tolist(), values, strict=True):
        if np.all(np.isfinite(row)):
            log.add(ImuSample(t_us / 1e6, row[:3], row[3:]))


def _add_ranges(log: TelemetryLog, sensors: list[Mapping[str, Any]]) -> None:
    """Of the first sensor that looks down: two do not agree."""
    for range_ in next(filter(None, map(_downward, sensors)), []):
        log.add(range_)


def _downward(sensor: Mapping[str, Any]) -> list[Range]:
    distances = sensor["current_distance"]
    valid = (distances >= sensor["min_distance"]) & (distances <= sensor["max_distance"])
    valid &= sensor["orientation"] == _DOWNWARD
    if "signal_quality" in sensor:  # PX4 before 1.9 does not tell
        valid &= sensor["signal_quality"] != 0
    return [Range(*each) for each in _finite(sensor["timestamp"][valid], distances[valid])]


def _finite(stamps_us: Any, values: Any) -> Iterator[tuple[float, float]]:
    """Times in seconds with their values."""
    for t_us, value in zip(stamps_us, values, strict=True):
        if np.isfinite(value):
            yield float(t_us) / 1e6, float(value)
