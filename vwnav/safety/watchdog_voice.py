"""The watchdog's own ear and voice: the few MAVLink messages that it understands and speaks."""

import math
from collections.abc import Iterable, Iterator
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from vwnav.safety.dead_man import Action, VehicleView
from vwnav.safety.flight_modes import AutopilotKind, flight_mode, mode_command
from vwnav.safety.mavlink_framing import Framer, Packet
from vwnav.types import FlightMode

_AUTOPILOT_COMPONENT = mavlink.MAV_COMP_ID_AUTOPILOT1
_OWN_COMPONENT = mavlink.MAV_COMP_ID_ONBOARD_COMPUTER2
_HEARD = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT,
    mavlink.MAVLINK_MSG_ID_COMMAND_ACK,
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS,
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT,
}
_SETPOINTS = {
    mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED,
    mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT,
    mavlink.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET,
    mavlink.MAVLINK_MSG_ID_SET_MODE,
}
_COMMANDS = {mavlink.MAVLINK_MSG_ID_COMMAND_LONG, mavlink.MAVLINK_MSG_ID_COMMAND_INT}
# What a navigator that lost the aircraft may not start. It may still ask for Hold, Land, Return.
_COMMANDS_OF_CONTROL = {
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM,
    mavlink.MAV_CMD_NAV_TAKEOFF,
    mavlink.MAV_CMD_MISSION_START,
    mavlink.MAV_CMD_NAV_GUIDED_ENABLE,
}
_POSITION_FLAGS = mavlink.ESTIMATOR_POS_HORIZ_REL | mavlink.ESTIMATOR_POS_HORIZ_ABS
# Ignore position, acceleration, yaw and yaw rate: velocity alone.
_VELOCITY_ONLY = 0b110111000111
_SILENT_HEARTBEAT_AGE_S = 1e6


class AutopilotEar:
    """Follows the autopilot's heartbeat, estimator and answers among all that passes."""

    def __init__(self) -> None:
        self.vehicle = VehicleView()
        self.kind = AutopilotKind.PX4
        self.system_id = 0
        self.mavlink1 = False
        self._heartbeat_t_s = -math.inf
        self._framer = Framer()
        self._decoder = mavlink.MAVLink(None)

    def heartbeat_age_s(self, t_s: float) -> float:
        """Time since the autopilot's last heartbeat."""
        return min(t_s - self._heartbeat_t_s, _SILENT_HEARTBEAT_AGE_S)

    def listen(self, data: bytes, t_s: float) -> list[bool]:
        """Take bytes of the link in; returns the answers to the watchdog's own mode commands."""
        answers: list[bool] = []
        for packet in self._framer.split(data):
            message = self._decode(packet)
            if message is None:
                continue
            if packet.message_id == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
                self._handle_heartbeat(message, packet, t_s)
            elif packet.message_id == mavlink.MAVLINK_MSG_ID_COMMAND_ACK:
                answers += self._own_answer(message)
            else:
                self._handle_estimator(message)
        return answers

    def _decode(self, packet: Packet) -> Any | None:
        if packet.message_id not in _HEARD or packet.component_id != _AUTOPILOT_COMPONENT:
            return None
        try:
            return self._decoder.decode(bytearray(packet.data))
        except mavlink.MAVError:
            return None  # damaged on the way: the autopilot says it again soon

    def _handle_heartbeat(self, message: Any, packet: Packet, t_s: float) -> None:
        try:
            self.kind = AutopilotKind(message.autopilot)
        except ValueError:
            return  # a gimbal or camera that uses the autopilot's component id
        self.system_id = packet.system_id
        self.mavlink1 = packet.data[0] == mavlink.PROTOCOL_MARKER_V1
        self._heartbeat_t_s = t_s
        armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        mode = flight_mode(self.kind, message.custom_mode)
        self.vehicle = VehicleView(mode, armed, self.vehicle.position_ok)

    def _handle_estimator(self, message: Any) -> None:
        # ESTIMATOR_STATUS (PX4) and EKF_STATUS_REPORT (ArduPilot) share these bits.
        position_ok = bool(message.flags & _POSITION_FLAGS)
        self.vehicle = VehicleView(self.vehicle.mode, self.vehicle.armed, position_ok)

    @staticmethod
    def _own_answer(message: Any) -> Iterator[bool]:
        if message.command != mavlink.MAV_CMD_DO_SET_MODE:
            return
        if getattr(message, "target_component", _OWN_COMPONENT) in (0, _OWN_COMPONENT):
            yield message.result in (mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_IN_PROGRESS)


class Voice:
    """Makes the watchdog's messages, as component ONBOARD_COMPUTER2 of the aircraft."""

    def __init__(self) -> None:
        self._encoder = mavlink.MAVLink(None, srcSystem=1, srcComponent=_OWN_COMPONENT)

    def heartbeat(self) -> bytes:
        """A companion computer is here."""
        message = mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
            mavlink.MAV_AUTOPILOT_INVALID,
            0,
            0,
            mavlink.MAV_STATE_ACTIVE,
            3,
        )
        return bytes(message.pack(self._encoder))

    def say(self, action: Action, ear: AutopilotEar, t_s: float) -> bytes:
        """The message that does `action` on the autopilot that `ear` hears."""
        self._encoder.srcSystem = ear.system_id or 1
        match action:
            case Action.ZERO_VELOCITY:
                message = self._zero_velocity(ear.system_id, t_s)
            case Action.HOLD:
                message = self._mode(ear, FlightMode.HOLD)
            case Action.LAND:
                message = self._mode(ear, FlightMode.LAND)
        return bytes(message.pack(self._encoder, force_mavlink1=ear.mavlink1))

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
        command = mode_command(ear.kind, mode)
        params = [p if p is not None else math.nan for p in command.params]
        params += [0.0] * (7 - len(params))
        return mavlink.MAVLink_command_long_message(
            ear.system_id, _AUTOPILOT_COMPONENT, command.number, 0, *params
        )


def without_control(packets: Iterable[Packet]) -> bytes:
    """What passes from a navigator that lost the aircraft: all but setpoints and claims to fly."""
    return b"".join(p.data for p in packets if p.message_id is not None and not _controls(p))


def _controls(packet: Packet) -> bool:
    if packet.message_id in _SETPOINTS:
        return True
    if packet.message_id not in _COMMANDS:
        return False
    try:
        message = mavlink.MAVLink(None).decode(bytearray(packet.data))
    except mavlink.MAVError:
        return True
    if message.command == mavlink.MAV_CMD_DO_SET_MODE:
        return any(_asks_for_offboard(kind, message) for kind in AutopilotKind)
    return message.command in _COMMANDS_OF_CONTROL


def _asks_for_offboard(kind: AutopilotKind, message: Any) -> bool:
    offboard = mode_command(kind, FlightMode.OFFBOARD).params
    return (message.param2, message.param3) == (*offboard, 0.0)[1:3]
