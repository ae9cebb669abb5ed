"""What waits for a slow link: commands go first, and of what repeats itself only the newest.

A serial line of 57600 baud carries less than estimates at 50 Hz make. What does not fit has to be
dropped here, where it is known what it is; in a buffer of bytes it would stand before a Land.
"""

from collections import deque
from dataclasses import dataclass
from enum import IntEnum

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from vwnav.mavlink.framing import Packet
from vwnav.mavlink.links import Link

_MAX_AGE_S = 1.0  # who sent a command has asked again by then
_MAX_STREAM_AGE_S = 0.2  # an older estimate or setpoint is worth nothing
_MAX_LANE_BYTES = 4096
_COMMANDS = {
    mavlink.MAVLINK_MSG_ID_COMMAND_LONG,
    mavlink.MAVLINK_MSG_ID_COMMAND_INT,
    mavlink.MAVLINK_MSG_ID_SET_MODE,
}
# Said again and again: a newer one makes the older one worthless.
_STREAMS = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT,
    mavlink.MAVLINK_MSG_ID_TIMESYNC,
    mavlink.MAVLINK_MSG_ID_VISION_POSITION_ESTIMATE,
    mavlink.MAVLINK_MSG_ID_VISION_SPEED_ESTIMATE,
    mavlink.MAVLINK_MSG_ID_ODOMETRY,
    mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED,
    mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT,
    mavlink.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET,
}
_HEADER_BYTES = {mavlink.PROTOCOL_MARKER_V1: 6, mavlink.PROTOCOL_MARKER_V2: 10}


class Lane(IntEnum):
    """What goes first."""

    OWN = 0  # the watchdog's word
    COMMANDS = 1
    REST = 2  # parameters, questions: few and short, but streams alone can fill a link
    STREAMS = 3


@dataclass(frozen=True, slots=True)
class _Waiting:
    data: bytes
    put_t_s: float
    key: tuple[int, ...] | None


class Outbox:
    """Packets on their way to the autopilot; whole ones only."""

    def __init__(self) -> None:
        self._lanes: dict[Lane, deque[_Waiting]] = {lane: deque() for lane in Lane}

    def put_own(self, packet: Packet, t_s: float) -> None:
        """A packet of the watchdog's own; of its setpoints the newest only."""
        key = _stream_key(packet) if packet.message_id in _STREAMS else None
        self._put(Lane.OWN, _Waiting(packet.data, t_s, key))

    def put(self, packet: Packet, t_s: float) -> None:
        """A packet to be handed on; bytes that are none are dropped."""
        if packet.message_id is None:
            return
        if packet.message_id in _STREAMS:
            self._put(Lane.STREAMS, _Waiting(packet.data, t_s, _stream_key(packet)))
        else:
            lane = Lane.COMMANDS if packet.message_id in _COMMANDS else Lane.REST
            self._put(lane, _Waiting(packet.data, t_s, None))

    def drop_handed_on(self) -> None:
        """Forget all but the watchdog's own: whoever sent it has lost the aircraft."""
        for lane in (Lane.COMMANDS, Lane.REST, Lane.STREAMS):
            self._lanes[lane].clear()

    def flush(self, link: Link, t_s: float) -> None:
        """Write what has room, in order of urgency."""
        for lane, waiting in self._lanes.items():
            max_age_s = _MAX_STREAM_AGE_S if lane is Lane.STREAMS else _MAX_AGE_S
            while waiting:
                if t_s - waiting[0].put_t_s > max_age_s:
                    waiting.popleft()
                elif link.has_room():
                    link.write(waiting.popleft().data)
                else:
                    return

    def _put(self, lane: Lane, new: _Waiting) -> None:
        waiting = self._lanes[lane]
        if new.key is not None:
            for i, old in enumerate(waiting):
                if old.key == new.key:
                    waiting[i] = new  # keeps its turn
                    return
        waiting.append(new)
        while sum(len(w.data) for w in waiting) > _MAX_LANE_BYTES:
            waiting.popleft()


def _stream_key(packet: Packet) -> tuple[int, ...]:
    key = (packet.message_id or 0, packet.system_id, packet.component_id)
    if packet.message_id == mavlink.MAVLINK_MSG_ID_TIMESYNC:
        start = _HEADER_BYTES[packet.data[0]]
        is_answer = any(packet.data[start : start + 8])  # tc1, 0 in a question
        return (*key, int(is_answer))
    return key
