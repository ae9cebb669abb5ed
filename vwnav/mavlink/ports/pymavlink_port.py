"""MAVLink messages over any `mavlink.links.Link`, decoded by pymavlink in the caller's own thread.

Nothing happens between two calls of `poll`: what a simulated clock drives runs the same every time.
"""

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

from vwnav.mavlink.framing import Framer, Packet
from vwnav.mavlink.links import Link
from vwnav.mavlink.modes import AutopilotKind
from vwnav.mavlink.ports.port import Fields, Handler, Listener, Sender

_AUTOPILOT_COMPONENT = 1
_OWN_SYSTEM, _OWN_COMPONENT = 245, mavlink.MAV_COMP_ID_ONBOARD_COMPUTER
_ANY = (0, None)  # target of a broadcast, or of a message from before there were targets
_HEARTBEAT_S = 1.0
_KINDS = tuple(kind.value for kind in AutopilotKind)


class PymavlinkPort:
    """The link to the first autopilot that is heard: a `port.Port`.

    Args:
        link: where the bytes come from and go to.
        clock: monotonic clock that stamps what is received.
    """

    def __init__(self, link: Link, clock: Callable[[], float]) -> None:
        self._link = link
        self._clock = clock
        self._framer = Framer()
        self._mavlink = mavlink.MAVLink(None, srcSystem=_OWN_SYSTEM, srcComponent=_OWN_COMPONENT)
        self._handlers: dict[int, Handler] = {}
        self._listeners: dict[int, Listener] = {}
        self._system_id = 0
        self._autopilots: set[int] = set()
        self._beat_s = -math.inf
        self._closed = False

    @property
    def system_id(self) -> int:
        """Of the autopilot; 0 while none has been heard."""
        return self._system_id

    @property
    def strangers(self) -> tuple[int, ...]:
        """Systems of other autopilots on the link, where nobody has said which one is ours."""
        return tuple(sorted(self._autopilots - {self._system_id}))

    def subscribe(self, name: str, handler: Handler) -> None:
        """Hand every message `name` of the autopilot to `handler`, within `poll`."""
        self._handlers[_number(name)] = handler

    @property
    def own_id(self) -> Sender:
        """System and component that we are."""
        return _OWN_SYSTEM, _OWN_COMPONENT

    def listen(self, name: str, listener: Listener) -> None:
        """Hand every message `name` of whoever else is on the link to `listener`, in `poll`."""
        self._listeners[_number(name)] = listener

    def is_for_us(self, fields: Fields) -> bool:
        """Whether a message that has a target is ours; others speak with the autopilot too."""
        return (
            fields.get("target_system") in (*_ANY, _OWN_SYSTEM)
            and fields.get("target_component") in (*_ANY, _OWN_COMPONENT)
        )  # fmt: skip

    def poll(self) -> None:
        """Handle all that has arrived, and say once a second that a companion is here."""
        if self._closed:
            return
        while data := self._link.read():
            for packet in self._framer.split(data):
                self._handle(packet)
        if self._clock() - self._beat_s >= _HEARTBEAT_S:
            self._beat_s = self._clock()
            self.send("HEARTBEAT", _OWN_HEARTBEAT)

    def send(self, name: str, fields: Fields) -> None:
        """Send one message; a closed link loses it, as the air would.

        Raises:
            ValueError: there is no such message or field.
        """
        kind = mavlink.mavlink_map[_number(name)]
        unknown = fields.keys() - set(kind.fieldnames)
        if unknown:
            raise ValueError(f"{name} has no field {sorted(unknown)}")
        message = kind(*[_encoded(kind, field, fields) for field in kind.fieldnames])
        if not self._closed:
            self._link.write(bytes(message.pack(self._mavlink)))

    def close(self) -> None:
        """Give the link back."""
        self._closed = True
        self._link.close()

    def _handle(self, packet: Packet) -> None:
        by_autopilot = packet.component_id == _AUTOPILOT_COMPONENT
        wanted = self._handlers if by_autopilot else self._listeners
        if packet.message_id is None or packet.message_id not in wanted:
            return
        try:
            message = self._mavlink.decode(bytearray(packet.data))
        except mavlink.MAVError:
            return  # damaged on the way
        if by_autopilot and getattr(message, "autopilot", None) in _KINDS:
            self._autopilots.add(packet.system_id)
            self._system_id = self._system_id or packet.system_id
        fields = {field: _decoded(getattr(message, field)) for field in message.fieldnames}
        if not by_autopilot:
            self._listeners[packet.message_id](fields, (packet.system_id, packet.component_id))
        elif packet.system_id == self._system_id:
            self._handlers[packet.message_id](message.get_type(), fields, self._clock())


def _number(name: str) -> int:
    number = _NUMBERS.get(name)
    if number is None:
        raise ValueError(f"there is no message {name}")
    return number


_NUMBERS: dict[str, int] = {kind.msgname: number for number, kind in mavlink.mavlink_map.items()}
_OWN_HEARTBEAT = {
    "type": mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
    "autopilot": mavlink.MAV_AUTOPILOT_INVALID,
    "base_mode": 0,
    "custom_mode": 0,
    "system_status": mavlink.MAV_STATE_ACTIVE,
    "mavlink_version": 3,
}


def _decoded(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return [_decoded(each) for each in value] if isinstance(value, (list, tuple)) else value


def _encoded(kind: Any, field: str, fields: Fields) -> Any:
    """A field as pymavlink wants it; one that is left out is zero, as in MAVSDK's JSON."""
    index = kind.fieldnames.index(field)
    is_text, length = kind.fieldtypes[index] == "char", _array_length(kind, field)
    value = fields.get(field, "" if is_text else [0] * length if length else 0)
    if is_text:
        return str(value).encode()
    if value is None:
        return math.nan
    return [math.nan if each is None else each for each in value] if length else value


def _array_length(kind: Any, field: str) -> int:
    """0 for a single number."""
    ordered = kind.ordered_fieldnames.index(field)
    return int(kind.array_lengths[ordered])
