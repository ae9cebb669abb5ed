"""The watchdog's own ear and voice: the few MAVLink messages that it understands and speaks."""

import contextlib
import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from vwnav.mavlink.framing import Framer, Packet, packet_at
from vwnav.mavlink.modes import AutopilotKind, flight_mode, mode_command
from vwnav.mavlink.telemetry.mode_track import ModeTrack
from vwnav.vehicle import FlightMode
from vwnav.watchdog.dead_man import DeadManAction, VehicleView

_AUTOPILOT_COMPONENT = mavlink.MAV_COMP_ID_AUTOPILOT1
_OWN_COMPONENT = mavlink.MAV_COMP_ID_ONBOARD_COMPUTER2
_CURRENT_MODE, _CURRENT_MODE_CRC_EXTRA = 436, 193  # which this dialect does not hold
_HEARD = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS,
    mavlink.MAVLINK_MSG_ID_COMMAND_ACK,
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS,
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE,
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN,
}
_LANDED = {
    mavlink.MAV_LANDED_STATE_ON_GROUND: True,
    mavlink.MAV_LANDED_STATE_IN_AIR: False,
    mavlink.MAV_LANDED_STATE_TAKEOFF: False,
    mavlink.MAV_LANDED_STATE_LANDING: False,
}
_STAYS_UP = frozenset({FlightMode.HOLD, FlightMode.MANUAL})
_ASKED_BY_US = frozenset({FlightMode.OFFBOARD, FlightMode.TAKEOFF, FlightMode.LAND})
_LANDED_MAX_AGE_S = 3.0  # of the last word of standing on the ground or not
_POSITION_FLAGS = mavlink.ESTIMATOR_POS_HORIZ_REL | mavlink.ESTIMATOR_POS_HORIZ_ABS
# Ignore position, acceleration, yaw and yaw rate: velocity alone.
_VELOCITY_ONLY = 0b110111000111
_SILENT_HEARTBEAT_AGE_S = 1e6
CUT_S = 1.2  # silence of the autopilot after which nothing simply goes on
_DECODER = mavlink.MAVLink(None)
_SINKS_IN_S = 0.5  # until the navigator has seen that another mode is flown than before a cut


@dataclass(frozen=True, slots=True)
class Origin:
    """Where the autopilot's local coordinates begin."""

    lat_deg: float
    lon_deg: float
    alt_amsl_m: float


class AutopilotEar:
    """Follows the autopilot's heartbeat, estimator and answers among all that passes.

    One is followed: another aircraft's words on the same link, a disarmed one's above all, are no
    reason to leave ours.

    Args:
        system_id: of the one that is followed; 0 for the first that is heard.
    """

    def __init__(self, system_id: int = 0) -> None:
        self.kind: AutopilotKind | None = None
        self.system_id = system_id
        self.mavlink1 = False
        self.heard_t_s = -math.inf
        self.heartbeat_t_s = -math.inf
        self.origin: Origin | None = None
        self._vehicle = VehicleView()
        self._modes = ModeTrack()
        self._has_radio = True  # until it is told that it has none
        self._landed_t_s = -math.inf
        self._mode_awaited, self._mode_since_s = False, -math.inf
        self._is_anothers = False  # who heard the mode, and what else was told then, is gone
        self._framer = Framer()

    def vehicle(self, t_s: float) -> VehicleView:
        """What is known of the autopilot."""
        if t_s - self._landed_t_s > _LANDED_MAX_AGE_S:
            self._vehicle = replace(self._vehicle, landed=None)
        seen = replace(self._with_choice(t_s), lands_blind=self._modes.lands_blind(t_s))
        if self.heard_t_s > -math.inf and not self._knows_mode(t_s):
            return replace(seen, mode_is_of_now=False)
        return seen

    def _with_choice(self, t_s: float) -> VehicleView:
        """Whether somebody chose the mode; sticks that are heard may be a person's at any time."""
        mode = self._vehicle.mode
        has_sticks = mode is FlightMode.MANUAL and self._has_radio
        if mode not in _STAYS_UP or has_sticks or self._modes.mode is not mode:
            return self._vehicle
        intended = self._modes.intended(t_s)
        fell_back, untold = intended in _ASKED_BY_US, intended is FlightMode.UNKNOWN
        return replace(self._vehicle, fell_back=fell_back, is_choice_untold=untold)

    def _knows_mode(self, t_s: float) -> bool:
        is_silent = t_s - self.heard_t_s > CUT_S
        return not is_silent and not self._mode_awaited and t_s >= self._mode_since_s

    def pass_on(self) -> None:
        """Another watchdog listens from here on, which has missed what was told meanwhile."""
        self._is_anothers = True

    def heartbeat_age_s(self, t_s: float) -> float:
        """Time since the autopilot's last heartbeat."""
        return min(t_s - self.heartbeat_t_s, _SILENT_HEARTBEAT_AGE_S)

    def listen(self, data: bytes, t_s: float) -> list[bool]:
        """Take bytes of the link in; returns the answers to the watchdog's own mode commands."""
        answers: list[bool] = []
        for packet in self._framer.split(data):
            if not self._is_the_autopilots(packet):
                continue
            was_cut = CUT_S < t_s - self.heard_t_s < math.inf
            self._mode_awaited = self._mode_awaited or was_cut
            self.heard_t_s = t_s
            if packet.message_id == _CURRENT_MODE:
                self._handle_current_mode(packet, t_s)
            message = self._decode(packet)
            if message is None:
                continue
            match packet.message_id:
                case mavlink.MAVLINK_MSG_ID_HEARTBEAT:
                    self._handle_heartbeat(message, packet, t_s)
                case mavlink.MAVLINK_MSG_ID_SYS_STATUS:
                    self._handle_status(message)
                case mavlink.MAVLINK_MSG_ID_COMMAND_ACK:
                    answers += self._own_answer(message)
                case mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE:
                    self._handle_landed_state(message, t_s)
                case mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN:
                    self._handle_origin(message)
                case _:
                    self._handle_estimator(message, t_s)
        return answers

    def _is_the_autopilots(self, packet: Packet) -> bool:
        if packet.component_id != _AUTOPILOT_COMPONENT or packet.message_id is None:
            return False
        if self.system_id == 0 and packet.message_id != mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            return False
        return self.system_id in (0, packet.system_id)

    def _decode(self, packet: Packet) -> Any | None:
        if packet.message_id not in _HEARD:
            return None
        try:
            return _DECODER.decode(bytearray(packet.data))
        except mavlink.MAVError:
            return None  # damaged on the way: the autopilot says it again soon

    def _handle_heartbeat(self, message: Any, packet: Packet, t_s: float) -> None:
        try:
            self.kind = AutopilotKind(message.autopilot)
        except ValueError:
            return  # a gimbal or camera that uses the autopilot's component id
        self.system_id = packet.system_id
        self.mavlink1 = packet.data[0] == mavlink.PROTOCOL_MARKER_V1
        self.heartbeat_t_s = t_s
        armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        mode = flight_mode(self.kind, message.custom_mode)
        self._modes.handle_heartbeat(self.kind, message.to_dict(), t_s)
        if self._mode_awaited:
            self._mode_awaited = False
            is_another = mode is not self._vehicle.mode or self._is_anothers
            self._mode_since_s = t_s + (_SINKS_IN_S if is_another else 0.0)
        self._is_anothers = False
        self._vehicle = replace(self._vehicle, mode=mode, armed=armed)

    def _handle_current_mode(self, packet: Packet, t_s: float) -> None:
        fields = _current_mode(packet)
        if fields is not None and self.kind is not None:
            self._modes.handle_current_mode(self.kind, fields, t_s)
            if not self._mode_awaited:  # a heartbeat's word from before would be another choice
                self._vehicle = replace(self._vehicle, mode=self._modes.mode)

    def _handle_status(self, message: Any) -> None:
        heard = message.onboard_control_sensors_present & message.onboard_control_sensors_health
        self._has_radio = bool(heard & mavlink.MAV_SYS_STATUS_SENSOR_RC_RECEIVER)

    def _handle_estimator(self, message: Any, t_s: float) -> None:
        # ESTIMATOR_STATUS (PX4) and EKF_STATUS_REPORT (ArduPilot) share these bits.
        position_ok = bool(message.flags & _POSITION_FLAGS)
        self._vehicle = replace(self._vehicle, position_ok=position_ok)
        self._modes.handle_position(position_ok, t_s)

    def _handle_landed_state(self, message: Any, t_s: float) -> None:
        landed = _LANDED.get(message.landed_state)
        self._vehicle, self._landed_t_s = replace(self._vehicle, landed=landed), t_s

    def handle_origin_sent(self, packet: Packet) -> None:
        """An origin on its way to the autopilot: the next best where it never tells its own."""
        if self.origin is None:
            with contextlib.suppress(mavlink.MAVError):
                self._handle_origin(_DECODER.decode(bytearray(packet.data)))

    def _handle_origin(self, message: Any) -> None:
        lat_deg, lon_deg = message.latitude / 1e7, message.longitude / 1e7
        if abs(lat_deg) > 90.0 or abs(lon_deg) > 180.0:
            return
        self.origin = Origin(lat_deg, lon_deg, message.altitude / 1e3)

    @staticmethod
    def _own_answer(message: Any) -> Iterator[bool]:
        if message.command != mavlink.MAV_CMD_DO_SET_MODE:
            return
        if getattr(message, "target_component", _OWN_COMPONENT) in (0, _OWN_COMPONENT):
            yield message.result in (mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_IN_PROGRESS)


def _current_mode(packet: Packet) -> dict[str, int] | None:
    """CURRENT_MODE's fields, by their layout; None where they were damaged on the way."""
    end = 10 + packet.data[1]
    crc = mavlink.x25crc(packet.data[1:end])
    crc.accumulate(bytes([_CURRENT_MODE_CRC_EXTRA]))
    if crc.crc != int.from_bytes(packet.data[end : end + 2], "little"):
        return None
    mode, intended = struct.unpack_from("<II", packet.data[10:end].ljust(8, b"\0"))
    return {"custom_mode": mode, "intended_custom_mode": intended}


class Voice:
    """Makes the watchdog's messages, as component ONBOARD_COMPUTER2 of the aircraft."""

    def __init__(self) -> None:
        self._encoder = mavlink.MAVLink(None, srcSystem=1, srcComponent=_OWN_COMPONENT)

    def heartbeat(self) -> Packet:
        """A companion computer is here."""
        message = mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
            mavlink.MAV_AUTOPILOT_INVALID,
            0,
            0,
            mavlink.MAV_STATE_ACTIVE,
            3,
        )
        return _packet(message.pack(self._encoder))

    def text(self, text: str, ear: AutopilotEar) -> Packet:
        """For the ground stations, up to 50 characters: what an operator must know."""
        self._encoder.srcSystem = ear.system_id or 1
        severity = mavlink.MAV_SEVERITY_CRITICAL
        message = mavlink.MAVLink_statustext_message(severity, text.encode("ascii"))
        return _packet(message.pack(self._encoder, force_mavlink1=ear.mavlink1))

    def ask_for_origin(self, ear: AutopilotEar) -> Packet:
        """An autopilot tells it once, when it is set, and then to who asks."""
        self._encoder.srcSystem = ear.system_id or 1
        message = mavlink.MAVLink_command_long_message(
            ear.system_id, _AUTOPILOT_COMPONENT, mavlink.MAV_CMD_REQUEST_MESSAGE, 0,
            mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN, *[0.0] * 6,
        )  # fmt: skip
        return _packet(message.pack(self._encoder, force_mavlink1=ear.mavlink1))

    def say(self, action: DeadManAction, ear: AutopilotEar, t_s: float) -> Packet:
        """The message that does `action` on the autopilot that `ear` hears."""
        self._encoder.srcSystem = ear.system_id or 1
        match action:
            case DeadManAction.ZERO_VELOCITY:
                message = self._zero_velocity(ear.system_id, t_s)
            case DeadManAction.HOLD:
                message = self._mode(ear, FlightMode.HOLD)
            case DeadManAction.LAND:
                message = self._mode(ear, FlightMode.LAND)
        return _packet(message.pack(self._encoder, force_mavlink1=ear.mavlink1))

    @staticmethod
    def _zero_velocity(system_id: int, t_s: float) -> Any:
        return mavlink.MAVLink_set_position_target_local_ned_message(
            int(t_s * 1000.0) & 0xFFFFFFFF,
            system_id,
            _AUTOPILOT_COMPONENT,
            mavlink.MAV_FRAME_LOCAL_NED,
            _VELOCITY_ONLY,
            *[0.0] * 11,
        )

    @staticmethod
    def _mode(ear: AutopilotEar, mode: FlightMode) -> Any:
        assert ear.kind is not None  # nothing is asked of an autopilot that was never heard
        command = mode_command(ear.kind, mode)
        params = [p if p is not None else math.nan for p in command.params]
        params += [0.0] * (7 - len(params))
        return mavlink.MAVLink_command_long_message(
            ear.system_id, _AUTOPILOT_COMPONENT, command.number, 0, *params
        )


def _packet(data: bytes) -> Packet:
    packet = packet_at(bytes(data), 0)
    assert packet is not None
    return packet
