"""What ground stations ask of the navigator itself: only of those that are named, on our own id."""

import logging
import math
from collections.abc import Callable

from pymavlink.dialects.v20 import common as mavlink

from vwnav.drivers.port import Fields, Port, Sender
from vwnav.types import Order

_log = logging.getLogger(__name__)
_HEARD_S = 5.0  # heartbeats come once a second
_ORDERS = {
    mavlink.MAV_CMD_NAV_LAND: Order.LAND,
    mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: Order.RETURN,
    mavlink.MAV_CMD_MISSION_START: Order.START,
}


class GroundCommands:
    """Listens to ground stations.

    Args:
        system_ids: of the stations that may command.
        clock: monotonic clock, in seconds.
    """

    def __init__(self, port: Port, system_ids: tuple[int, ...], clock: Callable[[], float]) -> None:
        self._port = port
        self._system_ids = system_ids
        self._clock = clock
        self._heard_s = -math.inf
        self._orders: list[Order] = []
        self._refused: list[str] = []
        port.listen("HEARTBEAT", self._heartbeat)
        port.listen("COMMAND_LONG", self._command)
        port.listen("COMMAND_INT", self._command)

    @property
    def is_heard(self) -> bool:
        """Whether one of the stations has been heard within some seconds."""
        return self._clock() - self._heard_s < _HEARD_S

    def take(self) -> tuple[tuple[Order, ...], tuple[str, ...]]:
        """Orders since the last call, and what was refused, in words."""
        orders, refused = tuple(self._orders), tuple(self._refused)
        self._orders.clear()
        self._refused.clear()
        return orders, refused

    def _heartbeat(self, fields: Fields, sender: Sender) -> None:
        if sender[0] in self._system_ids and fields.get("type") == mavlink.MAV_TYPE_GCS:
            self._heard_s = self._clock()

    def _command(self, fields: Fields, sender: Sender) -> None:
        """Commands for everybody are the autopilot's, not ours."""
        if (fields.get("target_system"), fields.get("target_component")) != self._port.own_id:
            return
        number = int(fields.get("command") or 0)
        if sender[0] not in self._system_ids:
            self._refused.append(
                f"a command ({number}) of system {sender[0]} is refused: it is no ground station "
                "of ours (flight.ground_station_ids)"
            )
            self._answer(number, mavlink.MAV_RESULT_DENIED, sender)
            return
        order = _order_of(number, fields.get("param1"))
        if order is not None:
            self._orders.append(order)
        known = mavlink.MAV_RESULT_UNSUPPORTED if order is None else mavlink.MAV_RESULT_ACCEPTED
        self._answer(number, known, sender)

    def _answer(self, number: int, result: int, sender: Sender) -> None:
        self._port.send(
            "COMMAND_ACK",
            {
                "command": number, "result": result, "progress": 0, "result_param2": 0,
                "target_system": sender[0], "target_component": sender[1],
            },
        )  # fmt: skip


def _order_of(number: int, parameter: float | None) -> Order | None:
    if number == mavlink.MAV_CMD_DO_PAUSE_CONTINUE:
        return {0.0: Order.PAUSE, 1.0: Order.GO_ON}.get(
            parameter if parameter is not None else -1.0
        )
    return _ORDERS.get(number)
