"""When each message of a link is due: defaults and SET_MESSAGE_INTERVAL."""

import math
from collections.abc import Callable, Mapping
from typing import Any


class Schedule:
    """Due times of one link's messages, in simulated seconds.

    Args:
        rates_hz: by default, by message number.
        builders: of the messages that there are, by number: each makes one of the vehicle's state.
        reachable: turns an interval asked for (s) into one that it can do.
    """

    def __init__(
        self,
        rates_hz: dict[int, float],
        builders: Mapping[int, Callable[[Any], Any]],
        reachable: Callable[[float], float],
    ) -> None:
        self._defaults = rates_hz
        self.builders = builders
        self._reachable = reachable
        self._interval_s = {message_id: 1.0 / rate for message_id, rate in rates_hz.items()}
        self._due_s = dict.fromkeys(rates_hz, 0.0)
        self._next_s = 0.0

    def interval_us(self, message_id: int) -> int:
        """For MESSAGE_INTERVAL: microseconds, -1 when it is not sent."""
        interval_s = self._interval_s.get(message_id)
        return -1 if interval_s is None else round(interval_s * 1e6)

    def set_interval(self, message_id: int, interval_us: float, t_s: float) -> bool:
        """SET_MESSAGE_INTERVAL: 0 is the default rate, -1 off; False for what is not known."""
        if message_id not in self.builders or math.isnan(interval_us):
            return False
        if interval_us == 0 and message_id in self._defaults:
            self._interval_s[message_id] = 1.0 / self._defaults[message_id]
        elif interval_us <= 0:
            self._interval_s.pop(message_id, None)
            self._due_s.pop(message_id, None)
            return True
        else:
            self._interval_s[message_id] = self._reachable(interval_us * 1e-6)
        self._due_s[message_id] = t_s
        self._next_s = t_s
        return True

    def due(self, t_s: float) -> list[int]:
        """The messages to send now."""
        if t_s < self._next_s:
            return []
        due = [message_id for message_id, due_s in self._due_s.items() if due_s <= t_s + 1e-6]
        for message_id in due:
            interval_s = self._interval_s[message_id]
            late = self._due_s[message_id] + interval_s
            self._due_s[message_id] = late if late > t_s else t_s + interval_s
        self._next_s = min(self._due_s.values(), default=math.inf)
        return due
