"""Joins the autopilot's clock (time since its boot) to this computer's monotonic clock."""

from collections import deque

_WINDOW_S = 20.0
_BUCKET_S = 1.0
_MAX_ROUND_TRIP_S = 0.05
_RECENT_TRIPS = 5
_REBOOT_S = 2.0
_SLIPPED_S = 0.03
_SLIPPED_BUCKETS = 3  # in a row that long: no latency, the clock itself


class BootClock:
    """Estimates `monotonic - boot` from latencies that are never negative.

    Two witnesses: every stamped message shows an offset that is too large by its latency, so the
    least one of a while is near the truth; a TIMESYNC round trip shows the middle, right to half
    the round trip. The smaller of the two is taken: the first bounds the truth from above.

    A simulator that gets too little processor time falls behind for good: when all that arrived
    lately is late by the same, what came before is forgotten.
    """

    def __init__(self) -> None:
        self._one_way: deque[tuple[float, float]] = deque()  # (bucket start, least offset in it)
        self._round_trips: deque[tuple[float, float, float]] = deque()  # (t, round trip, offset)
        self._last_boot_s = 0.0
        self._spent_s: deque[float] = deque(maxlen=_RECENT_TRIPS)

    @property
    def round_trip_s(self) -> float | None:
        """The longest of the last few question and answers; None before the first."""
        return max(self._spent_s, default=None)

    def handle_stamp(self, boot_s: float, received_s: float) -> bool:
        """Learn from a message stamped at `boot_s`; True when the autopilot has started anew."""
        rebooted = boot_s < self._last_boot_s - _REBOOT_S
        if rebooted:
            self._one_way.clear()
            self._round_trips.clear()
        self._last_boot_s = boot_s
        offset_s = received_s - boot_s
        if self._one_way and received_s - self._one_way[-1][0] < _BUCKET_S:
            start_s, least_s = self._one_way[-1]
            self._one_way[-1] = (start_s, min(least_s, offset_s))
        else:
            self._forget_slipped()
            self._one_way.append((received_s, offset_s))
        while received_s - self._one_way[0][0] > _WINDOW_S:
            self._one_way.popleft()
        return rebooted

    def _forget_slipped(self) -> None:
        if len(self._one_way) <= _SLIPPED_BUCKETS:
            return
        buckets = list(self._one_way)
        old, lately = buckets[:-_SLIPPED_BUCKETS], buckets[-_SLIPPED_BUCKETS:]
        slipped_s = min(least_s for _, least_s in lately) - min(least_s for _, least_s in old)
        if slipped_s < _SLIPPED_S:
            return
        self._one_way = deque(lately)
        while self._round_trips and self._round_trips[0][0] < lately[0][0]:
            self._round_trips.popleft()

    def handle_round_trip(self, sent_s: float, autopilot_s: float, received_s: float) -> None:
        """Learn from a TIMESYNC answer: asked and received here, answered there in between."""
        round_trip_s = received_s - sent_s
        self._spent_s.append(max(round_trip_s, 0.0))
        if not 0.0 <= round_trip_s <= _MAX_ROUND_TRIP_S:
            return
        offset_s = 0.5 * (sent_s + received_s) - autopilot_s
        self._round_trips.append((received_s, round_trip_s, offset_s))
        while received_s - self._round_trips[0][0] > _WINDOW_S:
            self._round_trips.popleft()

    def to_monotonic(self, boot_s: float) -> float | None:
        """The moment `boot_s` of the autopilot on this computer's clock; None before any news."""
        offsets_s = [least_s for _, least_s in self._one_way]
        if self._round_trips:
            offsets_s.append(min(self._round_trips, key=lambda trip: trip[1])[2])
        return boot_s + min(offsets_s) if offsets_s else None
