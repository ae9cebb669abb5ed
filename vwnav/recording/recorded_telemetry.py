"""Telemetry of vwnav's own recordings, for replaying a flight from one file."""

from pathlib import Path
from typing import Any

import numpy as np

from vwnav.errors import SourceError
from vwnav.recording.reader import CAMERA_TOPIC, VEHICLE_TOPIC, read_recording
from vwnav.recording.telemetry_log import TelemetryLog
from vwnav.types import Height, Range

_TOPICS = frozenset({CAMERA_TOPIC, VEHICLE_TOPIC})


def read_recorded_telemetry(path: Path) -> TelemetryLog:
    """Attitude, height, range and arming; time starts at the recording's first image.

    Raises:
        SourceError: it is no recording, or of a version whose telemetry has other names.
    """
    log = TelemetryLog()
    first_image_s: float | None = None
    for record in read_recording(path, _TOPICS):
        if record.topic == VEHICLE_TOPIC:
            try:
                _add(log, record.t_s, record.content)
            except KeyError as error:
                raise SourceError(
                    f"{path} is of another version of vwnav: its telemetry has no {error}"
                ) from error
        elif first_image_s is None:
            first_image_s = record.t_s
    log.start_s = first_image_s or 0.0
    return log


def _add(log: TelemetryLog, t_s: float, vehicle: dict[str, Any]) -> None:
    attitude = vehicle["attitude"]
    if attitude is not None:
        log.add_attitude(attitude["t_s"], np.array(attitude["quat_wxyz"]))
    if vehicle["height_m"] is not None:
        log.add(Height(vehicle["height_t_s"], vehicle["height_m"]))
    if vehicle["rangefinder_m"] is not None:
        log.add(Range(t_s, vehicle["rangefinder_m"]))
    log.add_armed(t_s, vehicle["armed"])
