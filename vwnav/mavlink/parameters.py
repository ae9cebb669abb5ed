"""The autopilot's parameters: read by name in the background, judged, written and put back."""

import math
import struct
from collections.abc import Callable, Generator
from typing import Any

from vwnav.mavlink.modes import AutopilotKind
from vwnav.mavlink.ports.port import Fields, Send
from vwnav.mavlink.preflight_parameters import check_parameters, parameter_names
from vwnav.vehicle import Finding

_TRIES = 3
_READ_AGAIN_S = 5.0
_REAL32 = 9  # MAV_PARAM_TYPE


class ParameterTable:
    """Values by name, as the autopilot last told them to anybody: of those once asked for here.

    Args:
        system_id: of the autopilot.
        px4: whether it is one: PX4 sends the bits of an integer in the field of a float.
        clock: monotonic clock, in seconds.
        patience_s: how long an answer may take on this link before it is asked for again.
    """

    def __init__(
        self,
        send: Send,
        system_id: Callable[[], int],
        px4: Callable[[], bool],
        clock: Callable[[], float],
        patience_s: Callable[[], float],
    ) -> None:
        self._send = send
        self._system_id = system_id
        self._px4 = px4
        self._clock = clock
        self._patience_s = patience_s
        self._asked: set[str] = set()
        self.values: dict[str, float] = {}

    def handle_value(self, fields: Fields) -> None:
        """Take a PARAM_VALUE in."""
        value, kind = fields["param_value"], fields["param_type"]
        if self._px4() and kind != _REAL32:
            value = integer_of_bits(value)
        name = fields["param_id"].rstrip("\0")
        if value is not None and name in self._asked:
            self.values[name] = float(value)

    def read(self, names: tuple[str, ...]) -> Generator[None, None, None]:
        """Ask for those that are not known; returns when all are, or nothing more comes."""
        self._asked.update(names)
        for _ in range(_TRIES):
            for name in names:
                if name not in self.values:
                    self._send("PARAM_REQUEST_READ", self._address(name) | {"param_index": -1})
                    yield  # one in a step: a serial link's buffer is small
            yield from self._until(lambda: all(name in self.values for name in names))

    def write(self, name: str, value: float) -> Generator[None, None, bool]:
        """Set a parameter of type float; True when the autopilot has confirmed it."""
        self._asked.add(name)
        for _ in range(_TRIES):
            self.values.pop(name, None)
            self.tell(name, value)
            yield from self._until(lambda: name in self.values)
            if name in self.values:
                return abs(self.values[name] - value) < 1e-3 * max(1.0, abs(value))
        return False

    def tell(self, name: str, value: float) -> None:
        """Set a parameter of type float, once, without a look at the answer."""
        fields = {"param_value": value, "param_type": _REAL32}
        self._send("PARAM_SET", self._address(name) | fields)

    def _until(self, arrived: Callable[[], bool]) -> Generator[None, None, None]:
        since_s = self._clock()
        while not arrived() and self._clock() - since_s < self._patience_s():
            yield

    def _address(self, name: str) -> dict[str, Any]:
        return {"target_system": self._system_id(), "target_component": 1, "param_id": name}


class ParameterReview:
    """What a flight on vision wants otherwise: read, and read again while something is missing.

    An autopilot that starts anew meanwhile answers some of the questions and not the others. What
    is set later is heard, because an autopilot tells it to everybody.

    Attributes:
        findings: worst first; None until some parameter was told.
    """

    def __init__(self, table: ParameterTable) -> None:
        self._table = table
        self._reading: Generator[None, None, None] | None = None
        self._read_s = -math.inf
        self.findings: tuple[Finding, ...] | None = None

    def step(self, kind: AutopilotKind, t_s: float) -> None:
        """Carry it on, on the ground; one question at most."""
        if self._reading is not None:
            if next(self._reading, True):
                self._reading = None
                self._judge(kind)
        elif self._misses_some and t_s - self._read_s > _READ_AGAIN_S:
            self._read_s = t_s
            self._reading = self._table.read(parameter_names(kind))

    def handle_value(self, kind: AutopilotKind | None, fields: Fields) -> None:
        """Take a PARAM_VALUE in."""
        self._table.handle_value(fields)
        if self.findings is not None and kind is not None:
            self._judge(kind)

    @property
    def _misses_some(self) -> bool:
        return self.findings is None or any(each.present is None for each in self.findings)

    def _judge(self, kind: AutopilotKind) -> None:
        if self._table.values:
            self.findings = tuple(check_parameters(kind, self._table.values))


def integer_of_bits(value: float | None) -> int:
    """The integer whose 32 bits a PX4 sends as those of a float.

    The bits of a negative integer are a NaN, which has no number to be told by: it is read as -1,
    the only negative one that the parameters looked at know.
    """
    if value is None:
        return -1
    return int(struct.unpack("<i", struct.pack("<f", value))[0])
