"""Rules of the estimates that are sent: what the autopilot may be told."""

import math
from collections.abc import Callable
from itertools import pairwise

from vwnav.rules.flight_log import FlightLog, Sent
from vwnav.rules.moments import armed, sent_armed
from vwnav.rules.rule import Rule
from vwnav.rules.temporal import Breach, always, always_pairs, inside, steady, without

_CLOCK_S = 0.1
_OLDEST_S = 0.35  # the watchdog's limit of 0.3 s, and the link
_JUMP_M = 4.0  # beyond flight, as the watchdog has it
_SAME_S = 2.0  # after a longer pause it comes back as a new one only
_PAUSE_S = 0.2  # autopilots stop fusing after that
_RATE_S = 0.1
_RECOVERY_S = 3.0  # after something was broken
_STEADY_S = 1.0  # between two changes of the reset counter
_UNSEEN_JUMP_M = 0.05
_FOUND_SHARE = 0.5  # of the sigma of before: a place that is found, be it where it was believed
_COUNTERS = 256  # reset_counter is a byte
_BEAT_S = 1.5  # 1 Hz and what a busy loop adds
_GROUND_STATION = 6
_HANDED_ON_S = 0.6  # the watchdog has seen the new ones for a while
_LOST = "the estimate is not sent any more"


def _pairs(
    log: FlightLog, good: Callable[[Sent, Sent], bool], what: Callable[[Sent, Sent], str]
) -> Breach | None:
    """Of an armed aircraft: standing disarmed, an estimate may jump."""
    return always_pairs(sent_armed(log), good, what)


def _is_finite(sent: Sent) -> bool:
    values = (*sent.position_ned_m, *sent.covariance_ne_m2, *(sent.velocity_ned_m_s or ()))
    return math.isfinite(sent.t_s) and all(map(math.isfinite, values))


def _is_covariance(sent: Sent) -> bool:
    a, b, c = sent.covariance_ne_m2
    return a > 0.0 and c > 0.0 and a * c - b * b > 0.0


def _moved_m(a: Sent, b: Sent) -> float:
    return math.dist(a.position_ned_m[:2], b.position_ned_m[:2])


def _speed_m_s(sent: Sent) -> float:
    """By its own velocity; 0 where that was not noted."""
    return math.hypot(*(sent.velocity_ned_m_s or ())[:2])


def _too_fast(log: FlightLog) -> Breach | None:
    """By its own velocity, and by the way of each second between two with one counter."""
    limit = log.bounds.estimate.max_speed_m_s
    fast = always(
        log.estimates,
        lambda each: _speed_m_s(each) < limit,
        lambda each: f"it moves at {_speed_m_s(each):.0f} m/s",
    )
    rows = sent_armed(log)
    first = 0
    for row in rows:
        while row.stamp_s - rows[first].stamp_s > 1.0:
            first += 1
        past = rows[first]
        way_m = _moved_m(past, row) - limit * (row.stamp_s - past.stamp_s)
        if past.reset_counter == row.reset_counter and way_m > _JUMP_M:
            return Breach(row.t_s, f"{way_m:.0f} m further than flight explains")
    return fast


def _jumps(log: FlightLog) -> Breach | None:
    limit = log.bounds.estimate.max_speed_m_s

    def smooth(a: Sent, b: Sent) -> bool:
        span_s = max(b.stamp_s - a.stamp_s, 0.0)
        same = a.reset_counter == b.reset_counter
        return not same or _moved_m(a, b) <= _JUMP_M + limit * span_s

    return _pairs(log, smooth, lambda a, b: f"it jumps by {_moved_m(a, b):.1f} m")


def _counts_down(log: FlightLog) -> Breach | None:
    def up(a: Sent, b: Sent) -> bool:
        return (b.reset_counter - a.reset_counter) % _COUNTERS < _COUNTERS // 2

    return _pairs(log, up, lambda a, b: f"from {a.reset_counter} to {b.reset_counter}")


def _renewed(log: FlightLog) -> list[tuple[Sent, Sent]]:
    return [(a, b) for a, b in pairwise(sent_armed(log)) if a.reset_counter != b.reset_counter]


def _counts_for_nothing(log: FlightLog) -> Breach | None:
    """Another counter is another position, one that is first known, or the end of a pause."""
    for a, b in _renewed(log):
        if b.t_s - a.t_s > _PAUSE_S or b.sigma_m < _FOUND_SHARE * a.sigma_m:
            continue
        if _moved_m(a, b) < _UNSEEN_JUMP_M:
            return Breach(b.t_s, f"counter {b.reset_counter} for a step of {_moved_m(a, b):.2f} m")
    return None


def _counts_again(log: FlightLog) -> Breach | None:
    changes = [b for _, b in _renewed(log)]
    return always_pairs(
        changes,
        lambda a, b: b.t_s - a.t_s >= _STEADY_S - _PAUSE_S,
        lambda a, b: f"renewed again after {b.t_s - a.t_s:.2f} s",
    )


def _same_after_pause(log: FlightLog) -> Breach | None:
    """What a cut link holds up is no silence of ours."""

    def renewed(a: Sent, b: Sent) -> bool:
        if b.t_s - a.t_s <= _SAME_S or a.reset_counter != b.reset_counter:
            return True
        ours = without([(a.t_s, b.t_s)], log.broken)
        return sum(hi - lo for lo, hi in ours) <= _SAME_S

    return _pairs(log, renewed, lambda a, b: f"the same after {b.t_s - a.t_s:.1f} s of silence")


def _rare(log: FlightLog) -> Breach | None:
    """Outside of what was broken, and of what the program itself calls lost."""
    lost = [(e.t_s - _RECOVERY_S, e.t_s) for e in log.events if e.text.startswith(_LOST)]
    again = [e.t_s for e in log.events if e.text == "estimates again"]
    told = [(lo, next((t + _HANDED_ON_S for t in again if t >= hi), math.inf)) for lo, hi in lost]
    spans = without(without(armed(log), log.broken, _RECOVERY_S), told)
    return steady(log.estimates, _RATE_S, spans, "no estimate")


def _heartbeats(log: FlightLog) -> Breach | None:
    spans = without(armed(log), log.broken, _RECOVERY_S)
    return steady(log.beats, _BEAT_S, spans, "no heartbeat of ours")


ESTIMATES = (
    Rule(
        "estimate finite",
        "Every estimate sent is finite.",
        ("estimates",),
        lambda log: always(log.estimates, _is_finite, lambda e: f"{e.position_ned_m}"),
    ),
    Rule(
        "estimate covariance",
        "Every estimate sent has a covariance that is one.",
        ("estimates",),
        lambda log: always(log.estimates, _is_covariance, lambda e: f"{e.covariance_ne_m2}"),
    ),
    Rule(
        "estimate age",
        "No estimate arrives more than 0.35 s after its moment.",
        ("estimates",),
        lambda log: always(
            log.estimates,
            lambda e: e.t_s - e.stamp_s <= _OLDEST_S,
            lambda e: f"{e.t_s - e.stamp_s:.2f} s old",
        ),
        whole=True,
    ),
    Rule(
        "estimate of the future",
        "No estimate arrives before its moment, by more than clocks may differ.",
        ("estimates",),
        # Telemetry that is late one way shifts the clocks by half of that: TIMESYNC cannot tell.
        lambda log: always(
            [e for e in log.estimates if not inside(e.t_s, log.broken)],
            lambda e: e.t_s - e.stamp_s >= -_CLOCK_S,
            lambda e: f"{e.stamp_s - e.t_s:.2f} s early",
        ),
        whole=True,
    ),
    Rule(
        "estimate order",
        "Moments of estimates never go back.",
        ("vehicle", "estimates"),
        lambda log: _pairs(
            log, lambda a, b: b.stamp_s >= a.stamp_s, lambda a, b: f"{a.stamp_s - b.stamp_s:.3f} s"
        ),
    ),
    Rule(
        "estimate speed",
        "No estimate moves faster than the envelope.",
        ("vehicle", "estimates"),
        _too_fast,
    ),
    Rule(
        "estimate jump",
        "No estimate jumps without another reset counter.",
        ("vehicle", "estimates"),
        _jumps,
    ),
    Rule(
        "reset counter up",
        "The reset counter never goes down.",
        ("vehicle", "estimates"),
        _counts_down,
    ),
    Rule(
        "reset counter's cause",
        "Another reset counter comes with another position, a first known one, or after a pause.",
        ("vehicle", "estimates"),
        _counts_for_nothing,
        whole=True,
    ),
    Rule(
        "reset counter steady",
        "No estimate is renewed again within a second.",
        ("vehicle", "estimates"),
        _counts_again,
        whole=True,
    ),
    Rule(
        "lost comes back new",
        "After 2 s of silence an estimate comes back only with another reset counter.",
        ("vehicle", "estimates"),
        _same_after_pause,
    ),
    Rule(
        "estimate rate",
        "Armed, and not lost, estimates come at 10 Hz or more.",
        ("vehicle", "estimates", "events"),
        _rare,
        whole=True,
    ),
    Rule(
        "heartbeat",
        "Our heartbeat comes at least every 1.5 s.",
        ("vehicle", "beats"),
        _heartbeats,
    ),
    Rule(
        "no ground station",
        "We never show ourselves as a ground station.",
        ("beats",),
        lambda log: always(
            log.beats,
            lambda beat: beat.kind != _GROUND_STATION,
            lambda beat: f"of component {beat.component}",
        ),
    ),
)
