"""What ground stations ask of the navigator itself: only of those that are named, on our own id."""

import math
from collections import deque
from collections.abc import Callable

from pymavlink.dialects.v20 import common as mavlink

from vwnav.mavlink.ports.port import Fields, Port, Sender
from vwnav.vehicle import Order

_HEARD_S = 5.0  # heartbeats come once a second
_MOST_WAITING = 100  # of a flood the newest count
# Answers would go before estimates and setpoints on a narrow link: a flood is not answered whole.
_MOST_REFUSALS, _REFUSALS_S = 5, 1.0
_ORDERS = {
    mavlink.MAV_CMD_NAV_LAND: Order.LAND,
    mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: Order.RETURN,
    mavlink.MAV_CMD_MISSION_START: Order.START,
}
_PAUSES = {0.0: Order.PAUSE, 1.0: Order.GO_ON}


class GroundCommands:
    """Listens to ground stations.

    Commands arrive on the port's thread, and are answered and handed out on that of `take`.

    Args:
        system_ids: of the stations that may command.
        clock: monotonic clock, in seconds.
    """

    def __init__(self, port: Port, system_ids: tuple[int, ...], clock: Callable[[], float]) -> None:
        self._port = port
        self._system_ids = system_ids
        self._clock = clock
        self._heard_s = -math.inf
        self._arrived: deque[tuple[Fields, Sender]] = deque(maxlen=_MOST_WAITING)
        self._foreign: deque[tuple[Fields, Sender]] = deque(maxlen=_MOST_REFUSALS)
        self._strangers: set[int] = set()
        self._refused_s: deque[float] = deque(maxlen=_MOST_REFUSALS)
        port.listen("HEARTBEAT", self._heartbeat)
        port.listen("COMMAND_LONG", self._command)
        port.listen("COMMAND_INT", self._command)

    @property
    def is_heard(self) -> bool:
        """Whether one of the stations has been heard within some seconds."""
        return self._clock() - self._heard_s < _HEARD_S

    def take(self) -> tuple[tuple[Order, ...], tuple[str, ...]]:
        """Orders since the last call, and who was refused, in words and once each."""
        orders: list[Order] = []
        refused: list[str] = []
        while self._foreign:
            fields, sender = self._foreign.popleft()
            refused += self._refusal(fields, sender[0])
            self._refuse(fields, sender, mavlink.MAV_RESULT_DENIED)
        while self._arrived:
            fields, sender = self._arrived.popleft()
            order = _order_of(fields)
            if order is None:
                self._refuse(fields, sender, mavlink.MAV_RESULT_UNSUPPORTED)
            else:
                self._answer(fields, sender, mavlink.MAV_RESULT_ACCEPTED)
                orders.append(order)
        return tuple(orders), tuple(refused)

    def _refuse(self, fields: Fields, sender: Sender, result: int) -> None:
        now_s = self._clock()
        if len(self._refused_s) == _MOST_REFUSALS and now_s - self._refused_s[0] < _REFUSALS_S:
            return
        self._refused_s.append(now_s)
        self._answer(fields, sender, result)

    def _answer(self, fields: Fields, sender: Sender, result: int) -> None:
        self._port.send("COMMAND_ACK", {
            "command": fields["command"], "result": result,
            "target_system": sender[0], "target_component": sender[1],
        })  # fmt: skip

    def _refusal(self, fields: Fields, system: int) -> list[str]:
        if system in self._strangers:
            return []
        self._strangers.add(system)
        return [
            f"commands of system {system} are refused (the first is {fields['command']}): it is no "
            "ground station of ours (flight.ground_station_ids)"
        ]

    def _heartbeat(self, fields: Fields, sender: Sender) -> None:
        if sender[0] in self._system_ids and fields["type"] == mavlink.MAV_TYPE_GCS:
            self._heard_s = self._clock()

    def _command(self, fields: Fields, sender: Sender) -> None:
        """Commands for everybody are the autopilot's, not ours."""
        if (fields["target_system"], fields["target_component"]) == self._port.own_id:
            is_ours = sender[0] in self._system_ids
            (self._arrived if is_ours else self._foreign).append((fields, sender))


def _order_of(fields: Fields) -> Order | None:
    if fields["command"] == mavlink.MAV_CMD_DO_PAUSE_CONTINUE:
        return _PAUSES.get(fields["param1"])
    return _ORDERS.get(fields["command"])
