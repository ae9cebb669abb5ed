"""What the autopilot's messages add up to: measurements one by one, and a `VehicleState`.

No I/O; times are arguments.
"""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vwnav.geometry.rotations import (
    quat_from_rotation,
    quat_from_vector,
    quat_multiply,
    rotation_from_euler,
)
from vwnav.mavlink.modes import AutopilotKind
from vwnav.mavlink.ports.port import Fields
from vwnav.mavlink.telemetry.barometer import BarometricHeight, hectopascal, is_pressure
from vwnav.mavlink.telemetry.imu_samples import CLOCK_ERROR_S, OLDEST_S, ImuSamples
from vwnav.mavlink.telemetry.mode_track import ModeTrack
from vwnav.mavlink.telemetry.status_text import StatusTexts
from vwnav.sender_clock import SenderClock
from vwnav.types import Array, Attitude, Height, Range, Stationary, Telemetry
from vwnav.vehicle import VehicleState

_ARMED_FLAG = 0x80  # MAV_MODE_FLAG_SAFETY_ARMED
_RC_RECEIVER, _PREARM = 0x10000, 0x10000000  # MAV_SYS_STATUS_SENSOR
_IN_AIR = (2, 3, 4)  # MAV_LANDED_STATE: in air, taking off, landing
_POSITION = 0x08 | 0x10  # ESTIMATOR_STATUS_FLAGS and EKF_STATUS_FLAGS: POS_HORIZ_REL, _ABS
_POSITION_ABSOLUTE, _CONSTANT_POSITION = 0x10, 0x80
_PREDICTED = 0x100 | 0x200
_DOWNWARD = 25  # MAV_SENSOR_ROTATION_PITCH_270
_LINK_LOST_S = 3.0
_STALE_S = 3.0
_RANGE_STALE_S = 0.5
_PRESSURE_STALE_S = 0.5
_INSANE_POSITION_M = 1e5  # PX4 with a late origin: millions of metres
_OWN_POSITION_STALE_S = 1.0
_CARRIED_S = 0.25  # an attitude is turned on by its rates for no longer
_COMPLAINTS_S = 35.0  # ArduPilot says every 30 s why it cannot be armed
_QUEUED = 4000  # measurements that nobody takes: twenty seconds of them


@dataclass(frozen=True, slots=True)
class _Reading:
    t_s: float
    value: float


@dataclass(frozen=True, slots=True, eq=False)
class _OwnPosition:
    """LOCAL_POSITION_NED, about the autopilot's own origin."""

    t_s: float
    ned_m: Array

    @property
    def insane(self) -> bool:
        return not math.hypot(*self.ned_m[:2].tolist()) <= _INSANE_POSITION_M


class TelemetryState:
    """Feed it decoded messages; not thread-safe."""

    def __init__(self) -> None:
        self.kind: AutopilotKind | None = None
        self.clock = SenderClock()
        self.texts = StatusTexts()
        self.origin: tuple[float, float, float] | None = None  # lat_deg, lon_deg, alt_amsl_m
        self.origin_offset_ned_m: Array | None = None  # (3,) the run's origin about the above one
        self.modes = ModeTrack()
        self._imu = ImuSamples()
        self._queue: deque[Telemetry] = deque(maxlen=_QUEUED)
        self._attitude: Attitude | None = None
        self._attitude_boot_s = -math.inf
        self._rates_rad_s = np.zeros(3)
        self._heartbeat_t_s = -math.inf
        self.heard_s = -math.inf
        self._armed = False
        self._landed_state = 0
        self._sensors: tuple[int, int] | None = None  # present, healthy
        self._battery_ratio: float | None = None
        self._estimator: tuple[float, int] | None = None  # time, flags
        self._own_position: _OwnPosition | None = None
        self._range: _Reading | None = None
        self._heights: dict[str, _Reading] = {}
        self._pressure_boot_s: dict[str, float] = {}
        self._barometers = {name: BarometricHeight() for name in ("SCALED_PRESSURE", "HIGHRES_IMU")}
        self._handlers: dict[str, Callable[[Fields, float], None]] = {
            "HEARTBEAT": self._handle_heartbeat,
            "CURRENT_MODE": self._handle_current_mode,
            "ATTITUDE": self._handle_attitude,
            "SYS_STATUS": self._handle_sys_status,
            "EXTENDED_SYS_STATE": self._handle_landed_state,
            "ESTIMATOR_STATUS": self._handle_estimator,
            "EKF_STATUS_REPORT": self._handle_estimator,
            "LOCAL_POSITION_NED": self._handle_local_position,
            "SCALED_PRESSURE": self._handle_scaled_pressure,
            "HIGHRES_IMU": self._handle_highres_imu,
            "RAW_IMU": self._handle_raw_imu,
            "DISTANCE_SENSOR": self._handle_distance,
            "GPS_GLOBAL_ORIGIN": self._handle_origin,
            "STATUSTEXT": self._handle_text,
        }

    @property
    def messages(self) -> tuple[str, ...]:
        """Names of the messages that are understood."""
        return tuple(self._handlers)

    @property
    def newest_attitude(self) -> Attitude | None:
        """The newest attitude."""
        return self._attitude

    @property
    def armed(self) -> bool:
        """As its last heartbeat said."""
        return self._armed

    def handle(self, name: str, fields: Fields, received_s: float) -> None:
        """Take one message in; unknown ones do nothing."""
        self.heard_s = received_s
        handler = self._handlers.get(name)
        if handler is not None:
            handler(fields, received_s)

    def take_measurements(self) -> tuple[Telemetry, ...]:
        """What was measured since the last call, in order of arrival."""
        taken = tuple(self._queue)
        self._queue.clear()
        return taken

    def attitude_near(self, t_s: float) -> Attitude | None:
        """The newest attitude, turned on by its body rates; None when it is of another time."""
        if self._attitude is None or abs(t_s - self._attitude.t_s) > _CARRIED_S:
            return None
        turn = quat_from_vector(self._rates_rad_s * (t_s - self._attitude.t_s))
        return Attitude(t_s, quat_multiply(self._attitude.quat_wxyz, turn))

    def aiding(self, t_s: float) -> bool | None:
        """The autopilot's filter predicts position from what we send; None when it never said.

        PX4 drops it within 1 s when vision fails, 4 s before it reacts with its mode.
        """
        if self._estimator is None or t_s - self._estimator[0] > _STALE_S:
            return None
        return bool(self._estimator[1] & _PREDICTED)

    def state(self, t_s: float) -> VehicleState:
        """The snapshot at `t_s`."""
        height = self._height(t_s)
        fresh_range = self._range is not None and t_s - self._range.t_s < _RANGE_STALE_S
        present, healthy = self._sensors or (0, 0)
        return VehicleState(
            t_s=t_s,
            connected=t_s - self.modes.told_s < _LINK_LOST_S,
            armed=self._armed,
            in_air=self._landed_state in _IN_AIR or (self._landed_state == 0 and self._armed),
            mode=self.modes.mode,
            attitude=self._attitude,
            height_m=None if height is None else height.value,
            height_t_s=None if height is None else height.t_s,
            rangefinder_m=self._range.value if self._range is not None and fresh_range else None,
            battery_ratio=self._battery_ratio,
            rc_available=bool(present & healthy & _RC_RECEIVER),
            local_position_ok=self._position_ok(t_s),
            armable=bool(healthy & _PREARM) and self._can_take_off(),
            silence_s=t_s - self.heard_s,
            intended_mode=self.modes.intended(t_s),
            tells_intent=self.kind is not AutopilotKind.PX4 or self.modes.tells_intent,
            failsafe=self.modes.is_failsafe(t_s),
            lands_blind=self.modes.lands_blind(t_s),
            aiding=self.aiding(t_s),
            own_position_ned_m=self._own_position_about_run(t_s),
            complaints=tuple(self.texts.warnings_since(t_s - _COMPLAINTS_S)),
        )

    def _own_position_about_run(self, t_s: float) -> Array | None:
        own, offset_ned_m = self._own_position, self.origin_offset_ned_m
        if own is None or offset_ned_m is None or t_s - own.t_s > _OWN_POSITION_STALE_S:
            return None
        return own.ned_m - offset_ned_m

    def _height(self, t_s: float) -> _Reading | None:
        """SCALED_PRESSURE, unless it comes too seldom and HIGHRES_IMU can stand in."""
        scaled, highres = (self._heights.get(source) for source in self._barometers)
        if scaled is not None and t_s - scaled.t_s < _PRESSURE_STALE_S:
            return scaled
        return highres or scaled

    def _position_ok(self, t_s: float) -> bool:
        if self._estimator is None or t_s - self._estimator[0] > _STALE_S:
            return False
        if self._own_position is not None and self._own_position.insane:
            return False
        return bool(self._estimator[1] & _POSITION) and self._can_take_off()

    def _can_take_off(self) -> bool:
        """ArduCopter says "ready to arm" before GUIDED has the position that it needs."""
        if self.kind is not AutopilotKind.ARDUPILOT:
            return True
        flags = self._estimator[1] if self._estimator is not None else 0
        return bool(flags & _POSITION_ABSOLUTE) and not flags & _CONSTANT_POSITION

    def _handle_heartbeat(self, fields: Fields, received_s: float) -> None:
        try:
            self.kind = AutopilotKind(fields["autopilot"])
        except ValueError:
            return  # a gimbal or camera that uses the autopilot's component id
        self._heartbeat_t_s = received_s
        self._armed = bool(fields["base_mode"] & _ARMED_FLAG)
        self.modes.handle_heartbeat(self.kind, fields, received_s)

    def _handle_current_mode(self, fields: Fields, received_s: float) -> None:
        if self.kind is not None:
            self.modes.handle_current_mode(self.kind, fields, received_s)

    def _handle_attitude(self, fields: Fields, received_s: float) -> None:
        boot_s = self.clock.near(fields["time_boot_ms"] / 1e3)
        restarts = self.clock.restarts
        if not self.clock.handle_stamp(boot_s, received_s):
            return
        if self.clock.restarts != restarts:
            self._attitude, self._attitude_boot_s = None, -math.inf
        t_s = self.clock.to_monotonic(boot_s)
        angles = (fields["roll"], fields["pitch"], fields["yaw"])
        rates = (fields["rollspeed"], fields["pitchspeed"], fields["yawspeed"])
        if t_s is None or boot_s <= self._attitude_boot_s or not _all_finite(*angles, *rates):
            return  # a duplicate, or overtaken on its way, or NaN: it has no attitude yet
        self._attitude_boot_s = boot_s
        quat_wxyz = quat_from_rotation(rotation_from_euler(*angles))
        self._attitude, self._rates_rad_s = Attitude(t_s, quat_wxyz), np.array(rates)
        self._queue.append(self._attitude)

    def _handle_sys_status(self, fields: Fields, received_s: float) -> None:
        self._sensors = (
            fields["onboard_control_sensors_present"],
            fields["onboard_control_sensors_health"],
        )
        remaining = fields["battery_remaining"]
        self._battery_ratio = remaining / 100.0 if remaining >= 0 else None

    def _handle_landed_state(self, fields: Fields, received_s: float) -> None:
        self._landed_state = fields["landed_state"]

    def _handle_estimator(self, fields: Fields, received_s: float) -> None:
        self._estimator = (received_s, fields["flags"])
        self.modes.handle_position(bool(fields["flags"] & _POSITION), received_s)

    def _handle_local_position(self, fields: Fields, received_s: float) -> None:
        ned_m = np.array([np.nan if fields[axis] is None else fields[axis] for axis in "xyz"])
        self._own_position = _OwnPosition(received_s, ned_m)

    def _handle_scaled_pressure(self, fields: Fields, received_s: float) -> None:
        boot_s = fields["time_boot_ms"] / 1e3
        self._handle_pressure("SCALED_PRESSURE", boot_s, fields["press_abs"], received_s)

    def _handle_highres_imu(self, fields: Fields, received_s: float) -> None:
        sample = self._imu.highres(fields, self.clock, received_s)
        if sample is not None:
            self._queue.append(sample)
        if fields["abs_pressure"] is not None:
            pressure_hpa = hectopascal(fields["abs_pressure"])
            boot_s = fields["time_usec"] / 1e6
            self._handle_pressure("HIGHRES_IMU", boot_s, pressure_hpa, received_s)

    def _handle_raw_imu(self, fields: Fields, received_s: float) -> None:
        if self.kind is not AutopilotKind.ARDUPILOT:
            return  # on others its units are the sensor's own
        sample = self._imu.raw(fields, self.clock, received_s)
        if sample is not None:
            self._queue.append(sample)

    def _handle_pressure(
        self, source: str, boot_s: float, pressure_hpa: float | None, received_s: float
    ) -> None:
        t_s = self._dated(boot_s, received_s)
        if t_s is None or pressure_hpa is None or not is_pressure(pressure_hpa):
            return
        overtaken_by_s = self._pressure_boot_s.get(source, -math.inf) - boot_s
        if 0.0 <= overtaken_by_s < OLDEST_S:
            return  # a duplicate, or a newer one was faster
        self._pressure_boot_s[source] = boot_s
        height_m = self._barometers[source].height_m(pressure_hpa)
        if height_m is None:
            return
        height = self._heights[source] = _Reading(t_s, height_m)
        if self._height(received_s) is height:
            self._queue.append(Height(t_s, height_m))
            if self._stands(received_s):
                self._queue.append(Stationary(t_s))

    def _dated(self, boot_s: float, received_s: float) -> float | None:
        """On our clock, by the autopilot's own; None where that cannot be."""
        t_s = self.clock.to_monotonic(self.clock.near(boot_s))
        if t_s is None or not received_s - OLDEST_S < t_s < received_s + CLOCK_ERROR_S:
            return None
        return t_s

    def _stands(self, t_s: float) -> bool:
        """Known to be disarmed, and not falling."""
        heard = t_s - self._heartbeat_t_s < _LINK_LOST_S
        return heard and not self._armed and self._landed_state not in _IN_AIR

    def _handle_distance(self, fields: Fields, received_s: float) -> None:
        distance_cm = fields["current_distance"]
        # Who says the most he can sees nothing so near.
        in_range = fields["min_distance"] <= distance_cm < fields["max_distance"]
        t_s = self._dated(fields["time_boot_ms"] / 1e3, received_s)
        if t_s is None or (self._range is not None and t_s <= self._range.t_s):
            return  # a duplicate, or a newer one was faster
        # signal_quality: 0 unknown, 1 invalid, though PX4's simulator says 1 for good ones too.
        if fields["orientation"] == _DOWNWARD and in_range and distance_cm > 0:
            self._range = _Reading(t_s, distance_cm / 100.0)
            self._queue.append(Range(t_s, distance_cm / 100.0))

    def _handle_origin(self, fields: Fields, received_s: float) -> None:
        lat_deg, lon_deg = fields["latitude"] / 1e7, fields["longitude"] / 1e7
        if abs(lat_deg) > 90.0 or abs(lon_deg) > 180.0:
            return
        self.origin = (lat_deg, lon_deg, fields["altitude"] / 1e3)

    def _handle_text(self, fields: Fields, received_s: float) -> None:
        self.texts.handle(fields, received_s)


def _all_finite(*values: float | None) -> bool:
    return all(value is not None and math.isfinite(value) for value in values)
