"""Records a flight as MCAP, which Foxglove opens; never makes the flight wait.

Everything is queued and written by a thread of its own. Every 0.7 s a chunk is finished and synced
(`disk.thread`): a process that is killed, or a board whose power is cut, leaves a file that lacks
its last second and its index, and is read to there by `reader.read_recording`.

In memory only the index grows that ends the file: 0.57 kB with each chunk, 2.4 MB an hour.
"""

import dataclasses
import json
import logging
import math
import os
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from enum import Enum
from pathlib import Path
from typing import Any

import cv2
import foxglove
import numpy as np
from foxglove.channels import CompressedImageChannel
from foxglove.mcap import MCAPCompression, MCAPWriteOptions
from foxglove.messages import CompressedImage, Timestamp

from vwnav.errors import VwnavError
from vwnav.recording.disk.budget import DiskBudget
from vwnav.recording.disk.thread import DiskThread, make_folder, sync_names
from vwnav.recording.reader import CAMERA_TOPIC, VEHICLE_TOPIC
from vwnav.types import Estimate, Frame, MapFix, Rejected
from vwnav.vehicle import VehicleState, VelocitySetpoint

_log = logging.getLogger(__name__)
_QUEUE_ITEMS = 10_000  # half a minute of all that is kept, in which the disk may stall
_QUEUED_SEQUENCE = 20_000  # a sequence's own limit, after all else is left out; some 20 MB
_QUEUED_IMAGES = 4
_CHUNK_BYTES = 1 << 18
_JPEG_QUALITY = 80
_CLOSE_TIMEOUT_S = 5.0
_LATEST_S = 9e9  # what fits into nanoseconds of 64 bits


class Recorder:
    """An MCAP file in the making.

    Topics: /camera (JPEG), /vehicle, /fix, /estimate, /setpoint, /event; JSON with the field names
    of `vwnav.types`, angles in radians, NaN as null. `log_time` is `t_s`, in nanoseconds.
    `InputLog` adds what the filter was told.

    Args:
        path: must not exist; its folder is made where it is missing.
        config: the resolved configuration, kept as JSON in the metadata record "config".
        image_rate_hz: at most so many images a second are kept.
        budget: of the disk; recording stops where it cannot be kept.
        at_once: the file is there, or an error raised. Else it is made by the thread that writes:
            whoever must not wait for a disk does not, and a file that cannot be made is said.

    Attributes:
        dropped: messages that the disk was too slow for.

    Raises:
        VwnavError: the file cannot be made.
    """

    def __init__(
        self,
        path: Path,
        config: Mapping[str, Any],
        image_rate_hz: float = 2.0,
        budget: DiskBudget | None = None,
        at_once: bool = True,
    ) -> None:
        self.dropped = 0
        self._path = path
        self._config = config
        self._budget = budget
        self._image_period_s = 1.0 / image_rate_hz
        self._next_image_s = 0.0
        self._images_put = self._images_taken = 0  # by the flight, by the thread that writes
        self._stopped = False
        self._torn = False
        self._context = foxglove.Context()
        self._started = {"wall_clock_s": repr(time.time()), "monotonic_s": repr(time.monotonic())}
        self._channels: dict[str, foxglove.Channel] = {}
        self._camera = CompressedImageChannel(CAMERA_TOPIC, context=self._context)
        if at_once:
            self._open()
        first = None if at_once else self._open
        self._disk = DiskThread("recorder", self._sync, self._stop, first)

    def _open(self) -> None:
        # Without seeking a chunk is written when it is whole: a killed recorder leaves no half.
        options = MCAPWriteOptions(
            chunk_size=_CHUNK_BYTES, compression=MCAPCompression.Lz4, disable_seeking=True
        )
        path = self._path
        try:
            make_folder(path.parent)
            self._writer = foxglove.open_mcap(path, context=self._context, writer_options=options)
            self._file = path.open("rb")  # to be synced: the writer's own is not to be had
            self._writer.write_metadata("config", {"json": json.dumps(plain(self._config))})
            self._writer.write_metadata("started", self._started)
        except OSError as error:
            raise VwnavError(f"cannot record to {path}: {error.strerror or error}") from error
        except Exception as error:  # the SDK's own errors have no common base, and name no cause
            raise VwnavError(f"cannot record to {path}; is there room? ({error})") from error
        sync_names(path.parent)

    def frame(self, frame: Frame) -> None:
        """Keep an image, if one is due; it must not be changed afterwards."""
        queued = self._images_put - self._images_taken
        if frame.t_s < self._next_image_s or queued >= _QUEUED_IMAGES:
            return
        due_s = max(self._next_image_s, frame.t_s - 0.5 * self._image_period_s)
        self._next_image_s = due_s + self._image_period_s
        self._images_put += self._put(lambda: self._write_image(frame), at_once=True)

    def vehicle(self, vehicle: VehicleState) -> None:
        """Keep a snapshot of the autopilot."""
        self.message(VEHICLE_TOPIC, vehicle.t_s, vehicle)

    def outcome(self, outcome: MapFix | Rejected) -> None:
        """Keep a fix or a rejection; `kind` tells which."""
        kind = "fix" if isinstance(outcome, MapFix) else "rejected"
        self._put(lambda: self._write_json("/fix", outcome.t_s, {"kind": kind} | plain(outcome)))

    def describe(self, name: str, content: Mapping[str, Any]) -> None:
        """Keep what holds for the whole recording, as JSON in a metadata record."""
        text = json.dumps(plain(content))
        self._put(lambda: self._writer.write_metadata(name, {"json": text}))

    def estimate(self, estimate: Estimate) -> None:
        """Keep an output of the filter."""
        self.message("/estimate", estimate.t_s, estimate)

    def setpoint(self, t_s: float, setpoint: VelocitySetpoint) -> None:
        """Keep what was asked of the autopilot."""
        self.message("/setpoint", t_s, setpoint)

    def event(self, t_s: float, text: str) -> None:
        """Keep a change of phase, a decision, a warning."""
        self.message("/event", t_s, {"text": text})

    def message(self, topic: str, t_s: float, content: Any) -> None:
        """Keep a dataclass or mapping on a topic of its own."""
        self._put(lambda: self._write_json(topic, t_s, {"t_s": t_s} | plain(content)))

    def sequence(self, topic: str, t_s: float, content: Callable[[], dict[str, Any]]) -> None:
        """Keep a message of a sequence that is worth nothing after a gap.

        Costs a microsecond: `content` is called by the thread that writes. When the disk falls
        a minute behind, the sequence ends there.
        """
        if self._stopped or self._torn:
            return
        if self._disk.waiting >= _QUEUED_SEQUENCE:
            self._torn = True
            _log.warning("the disk is too slow: from here on the flight cannot be replayed")
            return
        self._disk.put(lambda: self._write_json(topic, t_s, content()))

    def close(self) -> None:
        """Write what is queued and finish the file."""
        if not self._disk.close(self._finish, _CLOSE_TIMEOUT_S):
            _log.warning("the disk is too slow: the recording lacks its end")
        if self.dropped:
            _log.warning("%d messages were not recorded: the disk was too slow", self.dropped)

    def _put(self, write: Callable[[], None], at_once: bool = False) -> bool:
        if self._stopped:
            return False
        if self._disk.waiting >= _QUEUE_ITEMS:
            self.dropped += 1
            return False
        self._disk.put(write, at_once)
        return True

    def _sync(self) -> None:
        if self._budget is not None:
            self._budget.keep(time.monotonic())
        self._writer.flush()
        os.fsync(self._file.fileno())

    def _finish(self) -> None:
        self._writer.close()
        os.fsync(self._file.fileno())
        self._file.close()

    def _stop(self, error: Exception) -> None:
        self._stopped = True
        _log.warning("recording has stopped, the flight goes on: %s", error)
        with suppress(Exception):  # not even open
            self._writer.close()
        with suppress(Exception):
            self._file.close()

    def _write_image(self, frame: Frame) -> None:
        self._images_taken += 1
        good, jpeg = cv2.imencode(".jpg", frame.image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
        if not good:
            return
        nanoseconds = _nanoseconds(frame.t_s)
        stamp = Timestamp(sec=nanoseconds // 10**9, nsec=nanoseconds % 10**9)
        image = CompressedImage(
            timestamp=stamp, frame_id=str(frame.index), data=jpeg.tobytes(), format="jpeg"
        )
        self._camera.log(image, log_time=nanoseconds)

    def _write_json(self, topic: str, t_s: float, content: dict[str, Any]) -> None:
        channel = self._channels.get(topic)
        if channel is None:
            schema = {"type": "object", "title": topic.strip("/")}
            channel = foxglove.Channel(topic, schema=schema, context=self._context)
            self._channels[topic] = channel
        channel.log(content, log_time=_nanoseconds(t_s))


def plain(value: Any) -> Any:
    """Dataclasses, arrays and enums as what JSON has; NaN and infinities become None."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(entry) for entry in value]
    if isinstance(value, Enum):
        return value.name.lower()
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, (bool, int, str)) or value is None:
        return value
    return value.item() if isinstance(value, np.generic) else str(value)


def _nanoseconds(t_s: float) -> int:
    """Whatever the time: a stamp that makes no sense must not end the recording."""
    return round(min(max(t_s, 0.0), _LATEST_S) * 1e9) if math.isfinite(t_s) else 0
