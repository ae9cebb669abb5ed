"""MAVLink recordings (tlog): eight bytes of time and a packet, again and again; gzip or not."""

import gzip
import logging
import math
import re
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from vwnav.errors import SourceError
from vwnav.geometry.rotations import quat_from_rotation, rotation_from_euler
from vwnav.mavlink.framing import MARKERS, Packet, packet_at
from vwnav.mavlink.telemetry.barometer import BarometricHeight, hectopascal
from vwnav.recording.telemetry_log import TelemetryLog
from vwnav.types import Height, ImuSample, Range

_log = logging.getLogger(__name__)
_STAMP_BYTES = 8
_MARKER = re.compile(b"[" + bytes(MARKERS) + b"]")
# By so much a clock goes back when it starts again, or on after a gap; links reorder less.
_ELSEWHERE_S = 2.0
_STAYS_S = 1.0  # so long, then it is another time; else stamps that are wrong
_WANTED = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT,
    mavlink.MAVLINK_MSG_ID_ATTITUDE,
    mavlink.MAVLINK_MSG_ID_HIGHRES_IMU,
    mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE,
    mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR,
}
_AUTOPILOTS = (mavlink.MAV_AUTOPILOT_PX4, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA)


def read_tlog(path: Path) -> TelemetryLog:
    """Attitude, height, downward range, IMU and arming of a tlog, on the autopilot's clock.

    Damaged bytes are skipped. Of several starts, or several autopilots, the one that is heard for
    the longest time is taken. Both are said.

    Raises:
        SourceError: it is no tlog, or holds nothing of an autopilot.
    """
    data = _unpacked(path)
    boots = _Boots()
    found, taken_bytes = False, 0
    for packet in _packets(data):
        found = True
        if boots.handle(packet):
            taken_bytes += _STAMP_BYTES + len(packet.data)
    if not found:
        raise SourceError(f"{path} is not a tlog: no MAVLink packet in it")
    if skipped_bytes := len(data) - taken_bytes:
        _log.warning("%s: %d of %d bytes are damaged, and skipped", path, skipped_bytes, len(data))
    return boots.longest(path)


def _unpacked(path: Path) -> bytes:
    data = path.read_bytes()
    try:
        return gzip.decompress(data) if data[:2] == b"\x1f\x8b" else data
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise SourceError(f"{path} is damaged: its gzip data end too early or are wrong") from error


def _packets(data: bytes) -> Iterator[Packet]:
    """All packets; where the layout of a tlog is broken, on from the next with a right checksum."""
    found, end = _next_packet(data, 0)
    while found is not None:
        yield found
        found, end = _next_packet(data, end)


def _next_packet(data: bytes, at: int) -> tuple[Packet | None, int]:
    """The packet of the entry at `at`, or the next whole one; with where it ends."""
    start = at + _STAMP_BYTES
    in_place = packet_at(data, start) if _is_marked(data, start) else None
    if in_place is not None:
        end = start + len(in_place.data)
        if end + _STAMP_BYTES >= len(data) or _is_marked(data, end + _STAMP_BYTES):
            return in_place, end
    for marker in _MARKER.finditer(data, start):
        packet = packet_at(data, marker.start())
        if packet is not None and _decoded(packet) is not None:
            return packet, marker.start() + len(packet.data)
    return None, len(data)


def _is_marked(data: bytes, at: int) -> bool:
    return at < len(data) and data[at] in MARKERS


def _decoded(packet: Packet) -> Any | None:
    """Its message; None where it is damaged, or of no kind that is known."""
    try:
        message = mavlink.MAVLink(None).decode(bytearray(packet.data))
    except mavlink.MAVError:
        return None
    return None if isinstance(message, mavlink.MAVLink_unknown) else message


class _Boots:
    """From each start of an autopilot to the next, of each system by itself."""

    def __init__(self) -> None:
        self._all: list[_Boot] = []
        self._latest: dict[int, _Boot] = {}
        self._elsewhere: dict[int, list[Any]] = {}  # messages of what may be another time

    def handle(self, packet: Packet) -> bool:
        """Take one packet in; False where it is damaged."""
        if packet.message_id not in _WANTED or packet.component_id != 1:
            return True
        message = _decoded(packet)
        if message is None:
            return False
        self._take(packet.system_id, message)
        return True

    def _take(self, system: int, message: Any) -> None:
        """A clock that went elsewhere is believed once it has stayed there.

        Then one that went back has started anew, and one that went on was not heard for a while.
        What did not stay is left out: a stamp that is wrong, a second link that is late.
        """
        boot, t_s = self._latest.get(system) or self._begin(system), _boot_s(message)
        if t_s is None or not boot.is_far_from(t_s):
            if t_s is not None:
                self._elsewhere.pop(system, None)
            boot.handle(message)
            return
        there = self._elsewhere.setdefault(system, [])
        if there and abs(t_s - (_boot_s(there[-1]) or 0.0)) > _ELSEWHERE_S:
            there.clear()
        there.append(message)
        first_s = _boot_s(there[0]) or 0.0
        if t_s - first_s > _STAYS_S:
            boot = boot if boot.is_before(first_s) else self._begin(system)
            for each in self._elsewhere.pop(system):
                boot.handle(each)

    def _begin(self, system: int) -> "_Boot":
        boot = self._latest[system] = _Boot(system)
        self._all.append(boot)
        return boot

    def longest(self, path: Path) -> TelemetryLog:
        """All of the longest."""
        boots = [boot for boot in self._all if boot.span_s > 0.0] or self._all
        if not boots:
            return TelemetryLog()
        longest = max(boots, key=lambda boot: boot.span_s)
        if len(boots) > 1:
            _log.warning(
                "%s holds %d starts of autopilots (of one or several): taking the longest, "
                "number %d, of system %d, %.0f s; for another one cut the file",
                path, len(boots), boots.index(longest) + 1, longest.system_id, longest.span_s
            )  # fmt: skip
        return longest.finish()


class _Boot:
    """Turns an autopilot's messages into series."""

    def __init__(self, system_id: int) -> None:
        self.system_id = system_id
        self._log = TelemetryLog()
        self._barometer = BarometricHeight()
        self._pressure_from: int | None = None
        self._began_s: float | None = None
        self._now_s = 0.0

    @property
    def span_s(self) -> float:
        """Time from the first message that told one to the newest."""
        return 0.0 if self._began_s is None else self._now_s - self._began_s

    def is_far_from(self, t_s: float) -> bool:
        """Whether a time is not that of the newest messages."""
        return self._began_s is not None and abs(t_s - self._now_s) > _ELSEWHERE_S

    def is_before(self, t_s: float) -> bool:
        """Whether a time is later than all that was heard, and that was more than a moment."""
        return t_s > self._now_s and self.span_s > 0.0

    def handle(self, message: Any) -> None:
        """Take one message in."""
        t_s = _boot_s(message)
        if t_s is not None:
            self._began_s = t_s if self._began_s is None else self._began_s
            self._now_s = max(self._now_s, t_s)
        match kind := message.get_msgId():
            case mavlink.MAVLINK_MSG_ID_HEARTBEAT:
                self._heartbeat(message)
            case mavlink.MAVLINK_MSG_ID_ATTITUDE:
                self._attitude(message)
            case mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR:
                self._range(message)
            case mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE:
                self._pressure(kind, message.time_boot_ms / 1e3, message.press_abs)
            case mavlink.MAVLINK_MSG_ID_HIGHRES_IMU:
                self._pressure(kind, message.time_usec / 1e6, hectopascal(message.abs_pressure))
                self._imu(message)

    def finish(self) -> TelemetryLog:
        """All that came."""
        first = self._log.oldest_attitude
        if first is not None:
            self._log.start_s = first.t_s
        return self._log

    def _heartbeat(self, message: Any) -> None:
        if message.autopilot in _AUTOPILOTS:
            armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
            self._log.add_armed(self._now_s, armed)

    def _attitude(self, message: Any) -> None:
        R_ned_body = rotation_from_euler(message.roll, message.pitch, message.yaw)
        self._log.add_attitude(message.time_boot_ms / 1e3, quat_from_rotation(R_ned_body))

    def _imu(self, message: Any) -> None:
        if message.id == 0:
            force = np.array([message.xacc, message.yacc, message.zacc])
            rates = np.array([message.xgyro, message.ygyro, message.zgyro])
            if np.all(np.isfinite([force, rates])):
                self._log.add(ImuSample(message.time_usec / 1e6, force, rates))

    def _range(self, message: Any) -> None:
        in_range = message.min_distance <= message.current_distance <= message.max_distance
        if message.orientation == mavlink.MAV_SENSOR_ROTATION_PITCH_270 and in_range:
            t_s = message.time_boot_ms / 1e3
            self._log.add(Range(t_s, message.current_distance / 100.0))

    def _pressure(self, source: int, t_s: float, pressure_hpa: float) -> None:
        """One source only: two barometers do not agree."""
        if not (math.isfinite(pressure_hpa) and pressure_hpa > 0.0):
            return
        self._pressure_from = self._pressure_from or source
        if source == self._pressure_from:
            height_m = self._barometer.height_m(pressure_hpa)
            if height_m is not None:
                self._log.add(Height(t_s, height_m))


def _boot_s(message: Any) -> float | None:
    """Seconds since the autopilot started, where the message tells them."""
    t_ms = getattr(message, "time_boot_ms", None)
    return None if t_ms is None else t_ms / 1e3
