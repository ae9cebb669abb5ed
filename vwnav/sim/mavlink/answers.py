"""Messages that leave a moment later, as an autopilot takes a while to answer."""

import heapq
from typing import Any


class Answers:
    """Kept in the order in which they are due, equals in the order in which they came."""

    def __init__(self) -> None:
        self._waiting: list[tuple[float, int, Any]] = []
        self._count = 0

    def __bool__(self) -> bool:
        """Whether any waits."""
        return bool(self._waiting)

    def put(self, message: Any, due_s: float) -> None:
        """Keep one until it is due."""
        self._count += 1
        heapq.heappush(self._waiting, (due_s, self._count, message))

    def due(self, t_s: float) -> list[Any]:
        """Those to send now."""
        found = []
        while self._waiting and self._waiting[0][0] <= t_s:
            found.append(heapq.heappop(self._waiting)[2])
        return found
