"""MAVLink recordings (tlog): eight bytes of time and a packet, again and again; gzip or not."""

import gzip
import math
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

_STAMP_BYTES = 8
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

    Raises:
        SourceError: it is no tlog, or holds nothing of an autopilot.
    """
    try:
        data = path.read_bytes()
        if data[:2] == b"\x1f\x8b":
            data = gzip.decompress(data)
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise SourceError(f"{path} is damaged: its gzip data end too early or are wrong") from error
    collector = _Collector()
    count = 0
    for packet in _packets(data):
        count += 1
        collector.handle(packet)
    if count == 0:
        raise SourceError(f"{path} is not a tlog: no MAVLink packet where the first should be")
    return collector.finish()


def _packets(data: bytes) -> Iterator[Packet]:
    """Packets of the autopilot; ends where the file no longer has the layout of a tlog."""
    at = 0
    while at + _STAMP_BYTES < len(data):
        at += _STAMP_BYTES
        packet = packet_at(data, at) if data[at] in MARKERS else None
        if packet is None:
            return
        yield packet
        at += len(packet.data)


class _Collector:
    """Turns messages into series."""

    def __init__(self) -> None:
        self._log = TelemetryLog()
        self._decoder = mavlink.MAVLink(None)
        self._barometer = BarometricHeight()
        self._pressure_from: int | None = None
        self._now_s = 0.0

    def handle(self, packet: Packet) -> None:
        """Take one packet in."""
        if packet.message_id not in _WANTED or packet.component_id != 1:
            return
        try:
            message = self._decoder.decode(bytearray(packet.data))
        except mavlink.MAVError:
            return  # a damaged packet among good ones
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
        self._now_s = message.time_boot_ms / 1e3
        R_ned_body = rotation_from_euler(message.roll, message.pitch, message.yaw)
        self._log.add_attitude(self._now_s, quat_from_rotation(R_ned_body))

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
