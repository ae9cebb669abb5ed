"""MAVLink commands with their acknowledgement, and why one was refused, in words."""

import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

from vwnav.safety.flight_modes import Command

# MAV_RESULT: https://mavlink.io/en/messages/common.html#MAV_RESULT
_ACCEPTED, _IN_PROGRESS = 0, 5
_RESULTS = {
    1: "not now",
    2: "denied",
    3: "not supported",
    4: "failed",
    6: "cancelled",
}
_TRIES = 3
_TRY_S = 0.15
_PROGRESS_S = 2.0

Send = Callable[[str, Mapping[str, Any]], None]


class CommandSender:
    """Sends one command at a time and waits for its COMMAND_ACK: half a second at the longest.

    Half a second, because the watchdog takes a control loop that waits longer for dead.
    """

    def __init__(self, send: Send, system_id: int) -> None:
        self._send = send
        self._system_id = system_id
        self._one_at_a_time = threading.Lock()
        self._acknowledged = threading.Condition()
        self._waiting_for: int | None = None
        self._result: int | None = None

    def handle_ack(self, fields: Mapping[str, Any]) -> None:
        """Take a COMMAND_ACK in; to be called from another thread than `command`."""
        with self._acknowledged:
            if fields["command"] == self._waiting_for:
                self._result = fields["result"]
                self._acknowledged.notify_all()

    def command(self, command: Command) -> str | None:
        """Send until it is answered; None when accepted, else the answer in words."""
        with self._one_at_a_time, self._acknowledged:
            self._waiting_for, self._result = command.number, None
            for attempt in range(_TRIES):
                self._send("COMMAND_LONG", self._fields(command, attempt))
                if self._acknowledged.wait_for(self._has_result, _TRY_S):
                    break
            if self._result == _IN_PROGRESS:
                self._acknowledged.wait_for(self._has_final_result, _PROGRESS_S)
            result, self._waiting_for = self._result, None
        if result in (_ACCEPTED, _IN_PROGRESS):
            return None
        if result is None:
            return f"no answer within {_TRIES * _TRY_S:.2f} s"
        return _RESULTS.get(result, f"refused with code {result}")

    def _has_result(self) -> bool:
        return self._result is not None

    def _has_final_result(self) -> bool:
        return self._result != _IN_PROGRESS

    def _fields(self, command: Command, attempt: int) -> dict[str, Any]:
        params = [*command.params, *[0.0] * (7 - len(command.params))]
        numbered = {f"param{i}": value for i, value in enumerate(params, start=1)}
        return {
            "target_system": self._system_id,
            "target_component": 1,
            "command": command.number,
            "confirmation": attempt,
        } | numbered


class ParameterReader:
    """Asks for parameters by name, all at once, and notices which do not exist."""

    def __init__(self, send: Send, system_id: int) -> None:
        self._send = send
        self._system_id = system_id
        self._arrived = threading.Condition()
        self._values: dict[str, tuple[float | None, int]] = {}

    def handle_value(self, fields: Mapping[str, Any]) -> None:
        """Take a PARAM_VALUE in."""
        with self._arrived:
            name = fields["param_id"].rstrip("\0")
            self._values[name] = (fields["param_value"], fields["param_type"])
            self._arrived.notify_all()

    def read(self, names: tuple[str, ...], wait_s: float) -> dict[str, tuple[float | None, int]]:
        """(value as a float, MAV_PARAM_TYPE) of those `names` that exist, within `wait_s`."""
        with self._arrived:
            self._values.clear()
        for _ in range(2):
            missing = [name for name in names if name not in self._values]
            for name in missing:
                self._send("PARAM_REQUEST_READ", self._address(name) | {"param_index": -1})
                time.sleep(0.002)  # a serial link's buffer is small
            with self._arrived:
                if self._arrived.wait_for(
                    lambda: all(n in self._values for n in names), wait_s / 2
                ):
                    break
        with self._arrived:
            return {name: self._values[name] for name in names if name in self._values}

    def write_float(self, name: str, value: float, wait_s: float = 0.5) -> bool:
        """Set a parameter of type float; True when the autopilot has confirmed it."""
        fields = {"param_value": value, "param_type": 9}  # MAV_PARAM_TYPE_REAL32
        for _ in range(2):
            with self._arrived:
                self._values.pop(name, None)
            self._send("PARAM_SET", self._address(name) | fields)
            with self._arrived:
                if self._arrived.wait_for(lambda: name in self._values, wait_s / 2):
                    answer = self._values[name][0]
                    return answer is not None and abs(answer - value) < 1e-3 * max(1.0, abs(value))
        return False

    def _address(self, name: str) -> dict[str, Any]:
        return {"target_system": self._system_id, "target_component": 1, "param_id": name}
