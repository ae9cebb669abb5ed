"""The autopilot on a MAVLink link: PX4 and ArduCopter behind one face (`types.Autopilot`)."""

import logging
import math
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

from vwnav.drivers.autopilot_commands import CommandSender, ParameterReader
from vwnav.drivers.autopilot_upkeep import OriginAgreement, Upkeep
from vwnav.drivers.mavlink_port import MavlinkPort
from vwnav.drivers.preflight_parameters import Finding, check_parameters, parameter_names
from vwnav.drivers.telemetry_state import TelemetryState
from vwnav.drivers.vision_messages import vision_position, vision_speed
from vwnav.errors import LinkError
from vwnav.geometry.geodesy import LocalFrame
from vwnav.geometry.rotations import euler_from_rotation, rotation_from_quat, wrap_pi
from vwnav.safety.flight_modes import AutopilotKind, Command, mode_command
from vwnav.types import (
    Array,
    Attitude,
    Estimate,
    FlightMode,
    ImuSample,
    VehicleState,
    VelocitySetpoint,
)

_log = logging.getLogger(__name__)
_FIRST_HEARTBEAT_S = 5.0
_PARAMETER_WAIT_S = 1.2
_TEXT_WAIT_S = 0.1
_TEXT_AGE_S = 3.0
_GUIDED_WAIT_S = 1.5
_CMD_NAV_TAKEOFF, _CMD_ARM = 22, 400
_FRAME_LOCAL_NED = 1
_VELOCITY_AND_YAW = 0b100111000111  # POSITION_TARGET_TYPEMASK: ignore all the rest
_STREAM_START_S = 0.25
_STREAM_PERIOD_S = 0.05
_MAV_PARAM_TYPE_REAL32 = 9


class MavsdkAutopilot:
    """A `types.Autopilot` on a MAVSDK link. All methods may be called from any thread.

    Times are those of `clock`; use the same one for pictures. What is sent is sent once: a control
    loop that stops calling `send_velocity` lets the autopilot's own failsafe see it.

    Args:
        url: `udpin://0.0.0.0:14540`, `udpout://HOST:PORT`, `tcpout://HOST:PORT`,
            `serial:///dev/ttyAMA0:921600`, or the watchdog's `navigator_url`.
        timeout_s: how long an autopilot is waited for.
        as_ground_station: show ourselves as a ground station. PX4 then sends its texts on this
            link, but also believes that a ground station watches: its failsafe for losing the real
            one would never act. For the bench, not for flight.
        clock: monotonic clock, in seconds.

    Raises:
        LinkError: no PX4 or ArduPilot is on the link.
    """

    def __init__(
        self,
        url: str,
        timeout_s: float = 20.0,
        as_ground_station: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._telemetry = TelemetryState()
        self._heard = threading.Event()
        self._origin: OriginAgreement | None = None
        self._heading_bias_rad = 0.0
        self._held_yaw_rad: float | None = None
        self._setpoint = VelocitySetpoint(0.0, 0.0, 0.0)
        self._setpoint_t_s = -math.inf
        self._port = MavlinkPort(url, as_ground_station, timeout_s, clock)
        try:
            self._subscribe()
            self.kind = self._identify(url)
        except BaseException:
            self._port.close()
            raise
        self._commands = CommandSender(self._port.send, self._port.system_id)
        self._parameters = ParameterReader(self._port.send, self._port.system_id)
        self._port.subscribe("COMMAND_ACK", self._handle_ack)
        self._port.subscribe(
            "PARAM_VALUE", lambda _, fields, __: self._parameters.handle_value(fields)
        )
        self._upkeep = Upkeep(self._port.send, self._commands, self._telemetry, self._lock, clock)
        self._port.subscribe("TIMESYNC", self._upkeep.handle_timesync)

    # ---- what is known

    def state(self) -> VehicleState:
        """The newest snapshot."""
        with self._lock:
            return self._telemetry.state(self._clock())

    def attitude_at(self, t_s: float) -> Attitude | None:
        """Attitude at an exposure; None where telemetry does not reach."""
        with self._lock:
            return self._telemetry.attitude_at(t_s)

    def take_imu(self) -> tuple[ImuSample, ...]:
        """The IMU's samples since the last call, oldest first; none where it is not streamed."""
        with self._lock:
            return self._telemetry.take_imu()

    def aiding(self) -> bool | None:
        """Whether the autopilot's filter lives on our estimates: the early warning when not."""
        with self._lock:
            return self._telemetry.aiding(self._clock())

    def warnings(self, within_s: float = 10.0) -> list[str]:
        """The autopilot's warnings of the last while (PX4 sends them to ground stations only)."""
        with self._lock:
            return self._telemetry.texts.warnings_since(self._clock() - within_s)

    def preflight(self) -> list[Finding]:
        """Parameters that are not as flight on vision wants them, worst first; takes seconds.

        Raises:
            LinkError: the autopilot answers no question for a parameter.
        """
        names = parameter_names(self.kind)
        found = self._parameters.read(names, _PARAMETER_WAIT_S)
        if not found:
            raise LinkError("the autopilot answers no parameter request: is the link two-way?")
        values: dict[str, float] = {}
        for name, (value, kind) in found.items():
            exact = value
            if self.kind is AutopilotKind.PX4 and kind != _MAV_PARAM_TYPE_REAL32:
                exact = self._port.read_int_parameter(name)  # PX4 sends the bits, not the value
            if exact is not None:
                values[name] = exact
        return check_parameters(self.kind, values)

    # ---- what is sent steadily

    def set_origin(self, lat_deg: float, lon_deg: float, alt_amsl_m: float) -> None:
        """Agree upon an origin with the autopilot; estimates are held back until then.

        PX4 1.18 must have the origin before the first vision message, or its position jumps by
        thousands of kilometres. An autopilot that has an origin gets estimates about that one.
        """
        if self._origin is not None:
            self._origin.close()
        frame = LocalFrame(lat_deg, lon_deg, alt_amsl_m)
        self._origin = OriginAgreement(
            self._port.send,
            self._port.system_id,
            self._commands,
            self._telemetry,
            self._lock,
            frame,
        )

    def send_estimate(self, estimate: Estimate) -> None:
        """Send the filter's output; call it at 20 to 50 Hz without gaps of 0.2 s.

        Raises:
            ValueError: `set_origin` was never called.
        """
        if self._origin is None:
            raise ValueError("set_origin has to be called before the first estimate is sent")
        offset_ned_m = self._origin.offset_ned_m
        if offset_ned_m is None:
            return
        attitude = self.attitude_at(estimate.t_s)
        if attitude is not None:
            bias_rad = _yaw(attitude.quat_wxyz) - _yaw(estimate.quat_wxyz)
            self._heading_bias_rad = wrap_pi(bias_rad)
        self._port.send("VISION_POSITION_ESTIMATE", vision_position(estimate, offset_ned_m))
        if self.kind is AutopilotKind.ARDUPILOT:  # PX4 does not handle it
            self._port.send("VISION_SPEED_ESTIMATE", vision_speed(estimate))

    def send_velocity(self, setpoint: VelocitySetpoint) -> None:
        """Ask for a velocity, in Offboard or GUIDED; call it at 10 Hz or more."""
        self._setpoint, self._setpoint_t_s = setpoint, self._clock()
        self._port.send(
            "SET_POSITION_TARGET_LOCAL_NED",
            {
                "time_boot_ms": int(self._setpoint_t_s * 1e3) & 0xFFFFFFFF,
                "target_system": self._port.system_id,
                "target_component": 1,
                "coordinate_frame": _FRAME_LOCAL_NED,
                "type_mask": _VELOCITY_AND_YAW,
                **dict.fromkeys(("x", "y", "z", "afx", "afy", "afz", "yaw_rate"), 0.0),
                "vx": setpoint.north_m_s,
                "vy": setpoint.east_m_s,
                "vz": setpoint.down_m_s,
                "yaw": self._autopilot_yaw(setpoint.yaw_rad),
            },
        )

    # ---- what is commanded: None when accepted, else the reason

    def arm(self) -> str | None:
        """Arm; on ArduCopter in GUIDED."""
        state = self.state()
        if not state.connected:
            return "the autopilot is not heard"
        if not state.armable:
            return self._in_words("not ready to arm")
        if self.kind is AutopilotKind.ARDUPILOT:
            refused = self._set_mode(FlightMode.OFFBOARD)
            if refused:
                return refused
            self._wait_for_mode(FlightMode.OFFBOARD)
        return self._command(Command(_CMD_ARM, (1.0,)))

    def takeoff(self, height_m: float) -> str | None:
        """Climb to `height_m` above the ground and hold there; the autopilot flies it."""
        if self.kind is AutopilotKind.ARDUPILOT:
            return self._command(Command(_CMD_NAV_TAKEOFF, (0.0,) * 6 + (height_m,)))
        if not self._parameters.write_float("MIS_TAKEOFF_ALT", height_m):
            return "the take-off height (MIS_TAKEOFF_ALT) could not be set"
        # NaN altitude: the one of MIS_TAKEOFF_ALT. A number would be above mean sea level.
        refused = self._command(Command(_CMD_NAV_TAKEOFF, (None,) * 7))
        if refused is None:
            self._expect(FlightMode.TAKEOFF)
        return refused

    def start_offboard(self) -> str | None:
        """Take control: velocity setpoints are followed from now on."""
        self._held_yaw_rad = None
        self._stream_setpoint()
        refused = self._set_mode(FlightMode.OFFBOARD)
        if refused:  # PX4 counts the stream's age at 10 Hz or slower: once more
            self._stream_setpoint()
            refused = self._set_mode(FlightMode.OFFBOARD)
        return refused

    def hold(self) -> str | None:
        """Stop and stay: PX4 Hold, ArduCopter Brake."""
        return self._set_mode(FlightMode.HOLD)

    def land(self) -> str | None:
        """Land here."""
        return self._set_mode(FlightMode.LAND)

    def return_home(self) -> str | None:
        """The autopilot's own return; it needs a position and home."""
        return self._set_mode(FlightMode.RETURN)

    def disarm(self) -> str | None:
        """Stop the motors; refused in the air."""
        return self._command(Command(_CMD_ARM, (0.0,)))

    def close(self) -> None:
        """Give the link back; takes less than two seconds."""
        self._upkeep.close()
        if self._origin is not None:
            self._origin.close()
        self._port.close()

    # ---- inside

    def _subscribe(self) -> None:
        for name in self._telemetry.messages:
            self._port.subscribe(name, self._receive)

    def _identify(self, url: str) -> AutopilotKind:
        if not self._heard.wait(_FIRST_HEARTBEAT_S) or self._telemetry.kind is None:
            raise LinkError(f"the autopilot on {url} is neither PX4 nor ArduPilot")
        return self._telemetry.kind

    def _handle_ack(self, _: str, fields: Mapping[str, Any], __: float) -> None:
        if self._port.is_for_us(fields):
            self._commands.handle_ack(fields)

    def _receive(self, name: str, fields: Mapping[str, Any], received_s: float) -> None:
        with self._lock:
            self._telemetry.handle(name, fields, received_s)
        if name == "HEARTBEAT":
            self._heard.set()
        elif name == "STATUSTEXT":
            _log.info("autopilot: %s", fields["text"])

    def _autopilot_yaw(self, yaw_rad: float | None) -> float:
        """A true heading in terms of the autopilot's compass; None holds the last one asked for."""
        if yaw_rad is not None:
            self._held_yaw_rad = wrap_pi(yaw_rad + self._heading_bias_rad)
        elif self._held_yaw_rad is None:
            with self._lock:
                attitude = self._telemetry.newest_attitude
            self._held_yaw_rad = 0.0 if attitude is None else _yaw(attitude.quat_wxyz)
        return self._held_yaw_rad

    def _stream_setpoint(self) -> None:
        """PX4 enters Offboard only on a stream that already runs."""
        setpoint = self._setpoint
        if self._clock() - self._setpoint_t_s > _STREAM_START_S:
            setpoint = VelocitySetpoint(0.0, 0.0, 0.0)
        until_s = self._clock() + _STREAM_START_S
        while self._clock() < until_s:
            self.send_velocity(setpoint)
            time.sleep(_STREAM_PERIOD_S)

    def _set_mode(self, mode: FlightMode) -> str | None:
        refused = self._command(mode_command(self.kind, mode))
        if refused is None:
            self._expect(mode)
        return refused

    def _expect(self, mode: FlightMode) -> None:
        with self._lock:
            self._telemetry.expect_mode(mode, self._clock())

    def _wait_for_mode(self, mode: FlightMode) -> None:
        until_s = self._clock() + _GUIDED_WAIT_S
        while self.state().mode is not mode and self._clock() < until_s:
            time.sleep(0.02)

    def _command(self, command: Command) -> str | None:
        refused = self._commands.command(command)
        if refused is None:
            return None
        time.sleep(_TEXT_WAIT_S)  # the reason comes as a text, after the answer
        return self._in_words(refused)

    def _in_words(self, reason: str) -> str:
        texts = self.warnings(_TEXT_AGE_S)
        return f"{reason} ({'; '.join(texts[-3:])})" if texts else reason


def _yaw(quat_wxyz: Array) -> float:
    return euler_from_rotation(rotation_from_quat(quat_wxyz))[2]
