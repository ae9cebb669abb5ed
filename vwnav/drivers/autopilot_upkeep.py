"""What a link needs all the time: joined clocks, message rates, and one common origin."""

import logging
import threading
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from vwnav.drivers.autopilot_commands import CommandSender, Send
from vwnav.drivers.telemetry_state import TelemetryState
from vwnav.geometry.geodesy import LocalFrame
from vwnav.safety.flight_modes import AutopilotKind, Command
from vwnav.types import Array

_log = logging.getLogger(__name__)
_PERIOD_S = 0.2
_RATES_CHECK_S = 2.0
_STOP_WAIT_S = 1.0
# MAVLink message ids and the rates that are asked for, Hz: HEARTBEAT, SYS_STATUS,
# SCALED_PRESSURE, ATTITUDE, LOCAL_POSITION_NED, DISTANCE_SENSOR, EXTENDED_SYS_STATE.
_RATES_HZ = {0: 5.0, 1: 5.0, 29: 20.0, 30: 50.0, 32: 5.0, 132: 10.0, 245: 5.0}
_RATES_PX4_HZ = {230: 5.0, 436: 5.0}  # ESTIMATOR_STATUS, CURRENT_MODE
_RATES_ARDUPILOT_HZ = {193: 5.0}  # EKF_STATUS_REPORT
_HIGHRES_IMU, _RAW_IMU = 105, 27
_IMU_HZ = 50.0  # 3.7 kB/s; PX4 sends as much unasked
_SLOW_ATTITUDE_S = 0.3
_CMD_MESSAGE_INTERVAL, _CMD_REQUEST_MESSAGE = 511, 512
_GPS_GLOBAL_ORIGIN = 49
_ORIGIN_TRIES = 6
_UNCONFIRMED_TRIES = 30  # an autopilot that is still starting has no filter to take the origin
_ORIGIN_TOO_FAR_M = 20e3  # numbers of single precision are coarse there
_ORIGIN_PERIOD_S = 0.3
_ORIGIN_DIFFERS_M = 0.5


class Upkeep:
    """A thread that asks for clocks and rates until it is closed.

    Args:
        telemetry, lock: the state and what guards it.
    """

    def __init__(
        self,
        send: Send,
        commands: CommandSender,
        telemetry: TelemetryState,
        lock: threading.Lock,
        clock: Callable[[], float],
    ) -> None:
        self._send = send
        self._commands = commands
        self._telemetry = telemetry
        self._lock = lock
        self._clock = clock
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="autopilot link", daemon=True)
        self._thread.start()

    def handle_timesync(self, _: str, fields: Mapping[str, Any], received_s: float) -> None:
        """Answer the autopilot's question (it stamps our estimates by it), learn from answers."""
        if fields["tc1"] == 0:
            self._send("TIMESYNC", {"tc1": int(received_s * 1e9), "ts1": fields["ts1"]})
            return
        with self._lock:
            self._telemetry.clock.handle_round_trip(
                fields["ts1"] / 1e9, fields["tc1"] / 1e9, received_s
            )

    def close(self) -> None:
        """End the thread."""
        self._stop.set()
        self._thread.join(_STOP_WAIT_S)

    def _run(self) -> None:
        self._ask_for_rates()
        checked_s = self._clock()
        while not self._stop.wait(_PERIOD_S):
            now_s = self._clock()
            self._send("TIMESYNC", {"tc1": 0, "ts1": int(now_s * 1e9)})
            if now_s - checked_s > _RATES_CHECK_S:
                checked_s = now_s
                if self._starves(now_s):  # an autopilot that restarts forgets
                    self._ask_for_rates()

    def _starves(self, now_s: float) -> bool:
        with self._lock:
            attitude = self._telemetry.newest_attitude
            has_height = self._telemetry.has_height(now_s)
        return not has_height or attitude is None or now_s - attitude.t_s > _SLOW_ATTITUDE_S

    def _ask_for_rates(self) -> None:
        px4 = self._telemetry.kind is AutopilotKind.PX4
        rates = _RATES_HZ | (_RATES_PX4_HZ if px4 else _RATES_ARDUPILOT_HZ)
        for number, rate_hz in rates.items():
            self._ask_for(number, rate_hz)
        known = self._ask_for(_HIGHRES_IMU, _IMU_HZ)
        if not known and not px4:
            self._ask_for(_RAW_IMU, _IMU_HZ)

    def _ask_for(self, number: int, rate_hz: float) -> bool:
        """Whether the autopilot agrees to send a message so often."""
        refused = self._commands.command(
            Command(_CMD_MESSAGE_INTERVAL, (float(number), 1e6 / rate_hz))
        )
        if refused:
            _log.info("message %d at %.0f Hz: %s", number, rate_hz, refused)
        return refused is None


class OriginAgreement:
    """Reads the autopilot's origin, or sets it, and finds where ours lies about it.

    PX4 1.18 must have the origin before the first vision message, or its position jumps by
    thousands of kilometres: until there is agreement, `offset_ned_m` is None. An origin that is
    there already, of an earlier flight or of GPS, is kept for the same reason.

    Attributes:
        offset_ned_m: (3,) our origin in the frame about the autopilot's.
    """

    def __init__(
        self,
        send: Send,
        system_id: int,
        commands: CommandSender,
        telemetry: TelemetryState,
        lock: threading.Lock,
        frame: LocalFrame,
    ) -> None:
        self._send = send
        self._system_id = system_id
        self._commands = commands
        self._telemetry = telemetry
        self._lock = lock
        self._frame = frame
        self._stop = threading.Event()
        self.offset_ned_m: Array | None = None
        with lock:
            telemetry.origin = None
        self._thread = threading.Thread(target=self._run, name="origin", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread."""
        self._stop.set()
        self._thread.join(_STOP_WAIT_S)

    def _run(self) -> None:
        offset_ned_m = self._ask()
        tries = 0
        while _is_far(offset_ned_m) and not self._stop.is_set():
            tries += 1
            if tries > (_UNCONFIRMED_TRIES if offset_ned_m is None else _ORIGIN_TRIES):
                break
            self._send("SET_GPS_GLOBAL_ORIGIN", self._fields())
            offset_ned_m = self._ask()
        if self._stop.is_set():
            return
        if offset_ned_m is None:
            _log.warning("the autopilot does not confirm its origin; estimates are sent anyway")
            offset_ned_m = np.zeros(3)
        elif np.linalg.norm(offset_ned_m) >= _ORIGIN_DIFFERS_M:
            distance_m = np.linalg.norm(offset_ned_m)
            _log.warning("the autopilot keeps its own origin, %.1f m from ours", distance_m)
        self.offset_ned_m = offset_ned_m

    def _ask(self) -> Array | None:
        self._commands.command(Command(_CMD_REQUEST_MESSAGE, (float(_GPS_GLOBAL_ORIGIN),)))
        self._stop.wait(_ORIGIN_PERIOD_S)
        return self._offset()

    def _offset(self) -> Array | None:
        """Our origin about the one that the autopilot last told."""
        with self._lock:
            origin = self._telemetry.origin
        if origin is None:
            return None
        frame = self._frame
        return LocalFrame(*origin).to_ned(frame.lat_deg, frame.lon_deg, frame.alt_amsl_m)

    def _fields(self) -> dict[str, int]:
        return {
            "target_system": self._system_id,
            "latitude": round(self._frame.lat_deg * 1e7),
            "longitude": round(self._frame.lon_deg * 1e7),
            "altitude": round(self._frame.alt_amsl_m * 1e3),
            "time_usec": 0,
        }


def _is_far(offset_ned_m: Array | None) -> bool:
    return offset_ned_m is None or float(np.hypot(*offset_ned_m[:2])) > _ORIGIN_TOO_FAR_M
