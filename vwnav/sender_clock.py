"""Joins a sender's clock (an autopilot's, a camera's) to this computer's monotonic clock."""

import math
from collections import deque
from collections.abc import Iterable, Sequence

_WINDOW_S = 8.0
_BUCKET_S = 0.25
_RECENT_TRIPS = 5
_TRUSTED_FROM_S, _TRUSTED_S = 0.5, 2.0  # a rate seen for less, and for so long or longer
_MOST_DRIFT = 0.5  # a simulator on a machine that is much too slow
_REBOOT_S = 2.0
_AHEAD_S = 0.5  # a stamp from the future by so much is none of this clock
_NEW_CLOCK = 3  # stamps in a row that agree with each other alone
_LATE_S = 0.03  # a stamp is waited for or held back, or the clock has slipped
_SLIPPED_FOR_S = 3.0  # nothing but late stamps for so long: it is the clock itself
_WANDER = 20e-6  # by which two crystals may part from the line, a second
_SAME_RATE = 3e-4  # another rate of late stamps is that of a queue that fills or drains
_VERDICTS = 10  # on answers: a liar is right now and then
_CONTRADICTION_S = 0.001
_FRESH_S = 0.3  # stamps and an answer that came together speak of the same clock
_FRESH_STAMPS = 15
_WAITED_S = 0.05  # of a question, beyond twice the least of the last few
_SLOWER_STAMPS_S = 0.02  # by so much stamps may be slower than answers, at their best
_TURN_S = 2**32 / 1e3  # MAVLink counts milliseconds in 32 bits, microseconds in 64

Point = tuple[float, float]  # time on the sender's clock, how much later it is on ours


class SenderClock:
    """Estimates offset and rate of `monotonic - stamp` from latencies that are never negative.

    What is stamped by the sender cannot have arrived before it was sent: ours is never later
    than all of the stamps say. With the rate found as the slope of their lower hull (Moon, Skelly,
    Towsley: Estimation and removal of clock skew from network delay measurements, INFOCOM 1999) the
    least late stamp of a while is an upper bound of the offset. An answer to TIMESYNC cannot have
    been given before it was asked for: a lower bound. The truth is taken to be in the middle: both
    ways are equally fast at their best.

    What is only late moves neither bound: while nothing else comes both are carried on, so that a
    way that becomes longer in flight leaves the clock where it was. One that has slipped (a
    simulator that falls behind for good) shows in bounds that contradict each other or, where
    nobody answers, in stamps that are all late for seconds: what came before is forgotten.

    Attributes:
        restarts: how often the sender has started anew.
    """

    def __init__(self) -> None:
        self.restarts = 0
        self._newest_stamp_s = -math.inf
        self._drift = 0.0  # seconds by which ours gains on the sender's, a second
        self._lower_s = self._upper_s = 0.0  # of how late the newest stamp is at least, and at most
        self._spent_s: deque[float] = deque(maxlen=_RECENT_TRIPS)
        self._strange: deque[Point] = deque(maxlen=_NEW_CLOCK)
        self._forget()

    @property
    def round_trip_s(self) -> float | None:
        """The longest of the last few questions with their answers; None before the first."""
        return max(self._spent_s, default=None)

    def near(self, stamp_s: float) -> float:
        """The same moment by the count that this clock goes by, where another one is turns off it.

        A count of milliseconds begins again after 49.7 days, one of microseconds goes on.
        """
        if not self._stamps:
            return stamp_s
        counted_s = stamp_s + round((self._newest_stamp_s - stamp_s) / _TURN_S) * _TURN_S
        return counted_s if abs(counted_s - self._newest_stamp_s) < _WINDOW_S else stamp_s

    def handle_stamp(self, stamp_s: float, received_s: float) -> bool:
        """Learn from a message stamped at `stamp_s`; False when that is no time of this clock."""
        if self._stamps and self._is_strange(stamp_s, received_s):
            self._strange.append((stamp_s, received_s - stamp_s))
            if not _agree(self._strange):
                return False
            self.restarts += stamp_s < self._newest_stamp_s
            self._forget()
        self._strange.clear()
        step_s = max(stamp_s - self._newest_stamp_s, 0.0) if self._stamps else 0.0
        self._newest_stamp_s = max(self._newest_stamp_s, stamp_s)
        self._add_stamp((stamp_s, received_s - stamp_s), step_s)
        return True

    def handle_round_trip(self, sent_s: float, stamp_s: float, received_s: float) -> None:
        """Learn from a TIMESYNC answer: asked and received here, answered there in between."""
        spent_s = received_s - sent_s
        if not 0.0 <= spent_s < _WINDOW_S:
            return
        least_s = min(self._spent_s, default=spent_s)
        self._spent_s.append(spent_s)
        if spent_s > 2.0 * least_s + _WAITED_S:
            return  # it waited: the middle of its way says little
        if not math.isfinite(stamp_s) or abs(stamp_s - self._newest_stamp_s) > _WINDOW_S:
            return
        point = (stamp_s, sent_s - stamp_s)
        since_s = received_s - _FRESH_S  # a clock that stood has slipped since older ones
        fresh = [stamp for stamp in self._fresh if sum(stamp) > since_s]
        if not fresh:
            return
        self._verdicts.append(self._agrees_with(fresh, point, spent_s))
        if self._verdicts[-1]:
            self._answers.append(point)
        self._fit()

    def date(self, stamp_s: float, received_s: float) -> float | None:
        """When what is stamped so was sent, on our clock and not after it was received.

        None for a stamp that is no time of this clock. Learns from it as `handle_stamp` does.
        """
        if not self.handle_stamp(stamp_s, received_s):
            return None
        sent_s = self.to_monotonic(stamp_s)
        return None if sent_s is None else min(sent_s, received_s)

    def to_monotonic(self, stamp_s: float) -> float | None:
        """The moment `stamp_s` of the sender on this computer's clock; None before any news."""
        if not self._stamps:
            return None
        offset_s = 0.5 * (self._lower_s + self._upper_s)
        return stamp_s + offset_s + self._drift * (stamp_s - self._newest_stamp_s)

    def _forget(self) -> None:
        self._stamps = _Buckets()
        self._late = _Buckets()  # those that came since the last one that was not
        self._verdicts: deque[bool] = deque(maxlen=_VERDICTS)
        self._fresh: deque[Point] = deque(maxlen=_FRESH_STAMPS)
        self._answers: deque[Point] = deque()
        self._newest_stamp_s, self._drift = -math.inf, 0.0

    def _is_strange(self, stamp_s: float, received_s: float) -> bool:
        expected_s = self.to_monotonic(stamp_s)
        assert expected_s is not None
        return stamp_s < self._newest_stamp_s - _REBOOT_S or expected_s > received_s + _AHEAD_S

    def _add_stamp(self, point: Point, step_s: float) -> None:
        """Take in a stamp; both bounds go on to one that is newer by `step_s`."""
        self._fresh.append(point)
        has_dropped = _drop_before(self._answers, point[0] - _WINDOW_S)
        self._lower_s += self._drift * step_s
        self._upper_s += self._drift * step_s
        wander_s = _WANDER * step_s
        if self._stamps and self._residual_s(point) > self._upper_s + wander_s + _LATE_S:
            self._lower_s -= wander_s  # what is old bounds less sharply
            self._upper_s += wander_s
            self._add_late(point)
        elif self._late:
            self._end_lateness()
            self._add_least(point)
        elif not self._add_least(point) and not has_dropped:
            return  # the bounds are those of the same stamps and answers
        self._fit()

    def _add_least(self, point: Point) -> bool:
        """Whether it is the least late one of its quarter of a second."""
        if self._stamps.add(point, self._drift):
            _drop_before(self._stamps, point[0] - _WINDOW_S)
            self._drift = self._stamps.trusted_slope()
        return self._stamps[-1] is point

    def _add_late(self, point: Point) -> None:
        if self._late.add(point, self._drift):
            _drop_before(self._late, point[0] - _WINDOW_S)
            slope = self._late.trusted_slope()
            if self._late.heard_for_s > _TRUSTED_S and abs(slope - self._drift) < _SAME_RATE:
                self._drift = slope
        if self._late.heard_for_s > _SLIPPED_FOR_S and not self._asked_since(self._late[0][0]):
            self._take_late_for_true()

    def _end_lateness(self) -> None:
        """What was carried on stands for what has grown too old meanwhile."""
        self._late = _Buckets()
        before_s = self._newest_stamp_s - _BUCKET_S
        _drop_before(self._stamps, self._newest_stamp_s - _WINDOW_S)
        if not self._stamps:
            self._stamps.add((before_s, self._upper_s - self._drift * _BUCKET_S), self._drift)
        if self._answers and self._honest:
            self._answers.append((before_s, self._lower_s - self._drift * _BUCKET_S))

    def _asked_since(self, stamp_s: float) -> bool:
        """Honest answers have come since: had the clock slipped, they would contradict the line."""
        return self._honest and bool(self._answers) and self._answers[-1][0] >= stamp_s

    def _take_late_for_true(self) -> None:
        self._stamps, self._late = self._late, _Buckets()
        _drop_before(self._answers, self._stamps[0][0])
        self._drift = self._stamps.trusted_slope()

    def _fit(self) -> None:
        """The line's height at the newest stamp, between the two bounds."""
        if self._late:
            lower_s, upper_s = self._bounds_s(self._late)
            self._lower_s, self._upper_s = max(lower_s, self._lower_s), min(upper_s, self._upper_s)
            if self._lower_s <= self._upper_s + _LATE_S:
                self._upper_s = max(self._lower_s, self._upper_s)
                return
            self._take_late_for_true()  # it has slipped, too
        lower_s, upper_s = self._bounds_s(self._stamps)
        if lower_s > upper_s + _CONTRADICTION_S:
            self._drift = self._stamps.slope()
            lower_s, upper_s = self._bounds_s(self._stamps)
        while lower_s > upper_s + _CONTRADICTION_S and len(self._stamps) > 1:
            second_s = self._stamps[1][0]  # it has slipped since the oldest
            _drop_before(self._stamps, second_s)
            _drop_before(self._answers, second_s)
            self._drift = self._stamps.slope()
            lower_s, upper_s = self._bounds_s(self._stamps)
        self._lower_s, self._upper_s = lower_s if math.isfinite(lower_s) else upper_s, upper_s

    def _bounds_s(self, stamps: Iterable[Point]) -> tuple[float, float]:
        """How late the newest stamp is at least, by answers if there are any, and at most."""
        upper_s = min(map(self._residual_s, stamps))
        answers = self._answers if self._honest else ()
        return max(map(self._residual_s, answers), default=-math.inf), upper_s

    @property
    def _honest(self) -> bool:
        """Most of the last answers were not denied by stamps of their moment."""
        return 2 * sum(self._verdicts) >= len(self._verdicts)

    def _residual_s(self, point: Point) -> float:
        """How late a point says that the newest stamp is."""
        stamp_s, late_s = point
        return late_s + self._drift * (self._newest_stamp_s - stamp_s)

    def _agrees_with(self, fresh: Sequence[Point], answer: Point, round_trip_s: float) -> bool:
        """Stamps of the same moment slip with the clock: an answer that they deny is a lie.

        Between a stamp and it the clock may have slipped, as fast as clocks do.
        """
        late_s = self._residual_s(answer)
        least_s = min(map(self._residual_s, fresh))
        slipped_s = min(
            self._residual_s(stamp) + _MOST_DRIFT * abs(answer[0] - stamp[0]) for stamp in fresh
        )
        is_slow = least_s > late_s + round_trip_s + _SLOWER_STAMPS_S
        return late_s <= slipped_s + _CONTRADICTION_S and not is_slow


def _drop_before(points: deque[Point], stamp_s: float) -> bool:
    """Whether there were any."""
    count = len(points)
    while points and points[0][0] < stamp_s:
        points.popleft()
    return len(points) < count


def _agree(points: deque[Point]) -> bool:
    """Whether they may be stamps of one clock that goes."""
    if len(points) < _NEW_CLOCK:
        return False
    lates_s = [late_s for _, late_s in points]
    return max(lates_s) - min(lates_s) < _AHEAD_S and points[-1][0] > points[0][0]


class _Buckets(deque[Point]):
    """The least late stamp of every quarter of a second."""

    _begun_s = -math.inf

    @property
    def heard_for_s(self) -> float:
        """From the arrival of the first to that of the newest."""
        (first_s, first_late_s), (newest_s, newest_late_s) = self[0], self[-1]
        return newest_s + newest_late_s - first_s - first_late_s

    def add(self, point: Point, drift: float) -> bool:
        """Take a stamp in; True when it began a new bucket."""
        stamp_s, late_s = point
        if stamp_s < self._begun_s:
            return False  # overtaken on its way: a hull wants points in order
        if not self or stamp_s - self._begun_s >= _BUCKET_S:
            self._begun_s = stamp_s
            self.append(point)
            return True
        least_stamp_s, least_s = self[-1]
        if late_s < least_s + drift * (stamp_s - least_stamp_s):
            self[-1] = point
        return False

    def trusted_slope(self) -> float:
        """The slope, of which little is believed over a second: latencies alone make one."""
        span_s = self[-1][0] - self[0][0]
        share = (span_s - _TRUSTED_FROM_S) / (_TRUSTED_S - _TRUSTED_FROM_S)
        return self.slope() * min(max(share, 0.0), 1.0)

    def slope(self) -> float:
        """Of the line under all that is nearest to them: the hull's edge below their middle."""
        if len(self) < 2:
            return 0.0
        hull = _lower_hull(self)
        middle_s = sum(stamp_s for stamp_s, _ in self) / len(self)
        right = max(next(i for i, (stamp_s, _) in enumerate(hull) if stamp_s >= middle_s), 1)
        (left_s, left_late_s), (right_s, right_late_s) = hull[right - 1], hull[right]
        slope = (right_late_s - left_late_s) / (right_s - left_s)
        return min(max(slope, -_MOST_DRIFT), _MOST_DRIFT)


def _lower_hull(points: Iterable[Point]) -> list[Point]:
    """Of points in order of time (Andrew's monotone chain)."""
    hull: list[Point] = []
    for point in points:
        while len(hull) > 1 and _turns_down(hull[-2], hull[-1], point):
            hull.pop()
        hull.append(point)
    return hull


def _turns_down(a: Point, b: Point, c: Point) -> bool:
    """Whether b lies above the line from a to c."""
    return (b[1] - a[1]) * (c[0] - a[0]) >= (c[1] - a[1]) * (b[0] - a[0])
