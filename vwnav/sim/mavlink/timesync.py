"""TIMESYNC: which of the companion's clock readings is which of the vehicle's."""

_MAX_ROUND_TRIP_NS = 10_000_000
_SETTLED_AFTER = 20
_GAIN = 0.05
_JUMP_NS = 100_000_000


class TimesyncFilter:
    """Offset of the other clock, from answered TIMESYNC requests (PX4's filter, simplified).

    Attributes:
        offset_ns: own clock minus the other one.
    """

    def __init__(self) -> None:
        self.offset_ns = 0.0
        self._count = 0

    @property
    def settled(self) -> bool:
        """Enough answers came to trust it."""
        return self._count >= _SETTLED_AFTER

    def handle_answer(self, sent_ns: int, other_ns: int, now_ns: int) -> None:
        """An answer to a request sent at `sent_ns` with the other side's time in it."""
        if not 0 <= now_ns - sent_ns < _MAX_ROUND_TRIP_NS:
            return
        offset_ns = (sent_ns + now_ns) / 2.0 - other_ns
        if self._count == 0 or abs(offset_ns - self.offset_ns) > _JUMP_NS:
            self.offset_ns, self._count = offset_ns, 0
        self.offset_ns += max(_GAIN, 1.0 / (self._count + 1)) * (offset_ns - self.offset_ns)
        self._count += 1

    def own_s(self, other_us: int, now_s: float) -> float:
        """Own time (s) of a stamp of the other clock; `now_s` where that cannot be known."""
        if not self.settled or other_us <= 0:
            return now_s
        stamp_s = (other_us * 1e3 + self.offset_ns) * 1e-9
        return min(stamp_s, now_s) if abs(stamp_s - now_s) < 10.0 else now_s
