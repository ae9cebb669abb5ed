"""What is handed on to the autopilot, by what its sender may do."""

import math
from enum import Enum
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from vwnav.mavlink.framing import Packet
from vwnav.mavlink.modes import AutopilotKind, flight_mode
from vwnav.vehicle import FlightMode
from vwnav.watchdog.relay_guard import RelayedPosition, RelayedVelocity

_COMMANDS = {mavlink.MAVLINK_MSG_ID_COMMAND_LONG, mavlink.MAVLINK_MSG_ID_COMMAND_INT}
ESTIMATES = {
    mavlink.MAVLINK_MSG_ID_VISION_POSITION_ESTIMATE,
    mavlink.MAVLINK_MSG_ID_VISION_SPEED_ESTIMATE,
    mavlink.MAVLINK_MSG_ID_ODOMETRY,
}
# Where the second variance stands: of a row-major upper triangle (6, 6), and of a whole (3, 3).
_SECOND_OF_SIX, _SECOND_OF_THREE = 6, 4
_NED_AND_NED = (mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_LOCAL_NED)
_GLOBAL_POSITION_SENSOR = 296  # newer than pymavlink's dialect
# Other ways to tell an autopilot where it is. vwnav uses none of them and nothing guards them.
_UNGUARDED_ESTIMATES = {
    mavlink.MAVLINK_MSG_ID_GLOBAL_VISION_POSITION_ESTIMATE,
    mavlink.MAVLINK_MSG_ID_VICON_POSITION_ESTIMATE,
    mavlink.MAVLINK_MSG_ID_ATT_POS_MOCAP,
    mavlink.MAVLINK_MSG_ID_GPS_INPUT,
    mavlink.MAVLINK_MSG_ID_HIL_GPS,
    _GLOBAL_POSITION_SENSOR,
}
_QUESTIONS = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT,
    mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ,
    mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_LIST,
    mavlink.MAVLINK_MSG_ID_REQUEST_DATA_STREAM,
}
# To the ground stations: an autopilot hands it on and does nothing else with it.
_WORDS = {mavlink.MAVLINK_MSG_ID_STATUSTEXT, mavlink.MAVLINK_MSG_ID_COMMAND_ACK}
_QUESTION_COMMANDS = {
    mavlink.MAV_CMD_REQUEST_MESSAGE,
    mavlink.MAV_CMD_SET_MESSAGE_INTERVAL,
    mavlink.MAV_CMD_GET_MESSAGE_INTERVAL,
    mavlink.MAV_CMD_REQUEST_PROTOCOL_VERSION,
    mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES,
}
_CLOCKS = {mavlink.MAVLINK_MSG_ID_TIMESYNC, mavlink.MAVLINK_MSG_ID_SYSTEM_TIME}
# What gives the aircraft up instead of claiming it.
_GIVING_UP_COMMANDS = {
    mavlink.MAV_CMD_NAV_LOITER_UNLIM,
    mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH,
    mavlink.MAV_CMD_NAV_LAND,
}
_GIVING_UP_MODES = {FlightMode.HOLD, FlightMode.LAND, FlightMode.RETURN, FlightMode.DESCEND}


class Rights(Enum):
    """What a sender may do, from all to little."""

    FLIES = "has the aircraft"
    GIVES_UP = "lost the aircraft: may ask for Hold, Land or Return"
    ESTIMATES = "tells where the aircraft is, and never flies it"
    LISTENS = "listens along"


def may_pass(packet: Packet, rights: Rights, kind: AutopilotKind | None) -> bool:
    """Whether a packet is handed on to the autopilot.

    Args:
        packet: whole; bytes that are none never pass.
        rights: of its sender.
        kind: of the autopilot that is heard; None before it was.
    """
    number = packet.message_id
    if number is None or number in _UNGUARDED_ESTIMATES:
        return False
    if rights is Rights.FLIES or number in _QUESTIONS:
        return True
    if number in ESTIMATES or number in _CLOCKS or number in _WORDS:
        return rights is not Rights.LISTENS
    gives_up = rights is Rights.GIVES_UP
    if number == mavlink.MAVLINK_MSG_ID_SET_MODE:
        return gives_up and _mode_of_set_mode(packet, kind) in _GIVING_UP_MODES
    if number not in _COMMANDS:
        return False
    command = decode(packet)
    if command is None:
        return False
    if command.command == mavlink.MAV_CMD_DO_SET_MODE:
        return gives_up and _mode_of_command(command, kind) in _GIVING_UP_MODES
    if command.command in _GIVING_UP_COMMANDS:
        return gives_up
    return command.command in _QUESTION_COMMANDS


def mode_asked(packet: Packet, kind: AutopilotKind | None) -> FlightMode | None:
    """The mode that a packet asks for, None of one that asks for none."""
    if packet.message_id not in _COMMANDS:
        return None
    command = decode(packet)
    if command is None or command.command != mavlink.MAV_CMD_DO_SET_MODE:
        return None
    return _mode_of_command(command, kind)


def decode(packet: Packet) -> Any | None:
    """The message of a packet, None of one that was damaged on the way."""
    try:
        return mavlink.MAVLink(None).decode(bytearray(packet.data))
    except mavlink.MAVError:
        return None


def told_by(message: Any) -> tuple[RelayedPosition | None, RelayedVelocity | None]:
    """What one of `ESTIMATES` says; nothing of an ODOMETRY in frames that are not judged here."""
    place = (message.x, message.y, message.z)
    counter = message.reset_counter
    match message.get_type():
        case "VISION_POSITION_ESTIMATE":
            sigma_m = _sigma(message.covariance, _SECOND_OF_SIX)
            return RelayedPosition(message.usec / 1e6, place, sigma_m, counter), None
        case "VISION_SPEED_ESTIMATE":
            sigma_m_s = _sigma(message.covariance, _SECOND_OF_THREE)
            return None, RelayedVelocity(message.usec / 1e6, place, sigma_m_s)
        case "ODOMETRY" if (message.frame_id, message.child_frame_id) == _NED_AND_NED:
            t_s, sigma_m = message.time_usec / 1e6, _sigma(message.pose_covariance, _SECOND_OF_SIX)
            sigma_m_s = _sigma(message.velocity_covariance, _SECOND_OF_SIX)
            speeds = (message.vx, message.vy, message.vz)
            return (
                RelayedPosition(t_s, place, sigma_m, counter),
                RelayedVelocity(t_s, speeds, sigma_m_s),
            )
    return None, None


def _sigma(covariance: list[float], second: int) -> float:
    """Larger sigma of north and east; NaN, which no bound admits, where the covariance is none."""
    variance = max(covariance[0], covariance[second])
    return math.sqrt(variance) if variance >= 0.0 else math.nan


def _mode_of_set_mode(packet: Packet, kind: AutopilotKind | None) -> FlightMode | None:
    message = decode(packet)
    if message is None or kind is None:
        return None
    if not message.base_mode & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
        return None
    return flight_mode(kind, message.custom_mode)


def _mode_of_command(command: Any, kind: AutopilotKind | None) -> FlightMode | None:
    """The mode that MAV_CMD_DO_SET_MODE asks for on this kind of autopilot.

    The same numbers mean other modes on another kind: (6, 0) is Offboard on PX4 and RTL on
    ArduCopter.
    """
    try:
        base, main, sub = (int(p) for p in (command.param1, command.param2, command.param3))
    except (ValueError, OverflowError):  # NaN, infinity
        return None
    if kind is None or not base & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
        return None
    if kind is AutopilotKind.PX4:
        return flight_mode(kind, (main & 0xFF) << 16 | (sub & 0xFF) << 24)
    return flight_mode(kind, main)
