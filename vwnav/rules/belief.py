"""Rules of what is believed: how right estimates and fixes are, and how well they know it."""

import math
from collections.abc import Sequence
from itertools import dropwhile, pairwise

from vwnav.rules.flight_log import At, FlightLog, Sent
from vwnav.rules.moments import flying, sent_armed, touch_down_s
from vwnav.rules.rule import Rule
from vwnav.rules.temporal import Breach, after, always, inside, spans_where, without

_SHRINKS = 0.8  # a sigma may fall by what velocity tells of position
_NO_FIX_S = 2.0
_FIX_LATE_S = 1.0  # from exposure to filter
_RECOVERY_S = 3.0  # after something was broken
_NEVER_SIGMAS, _SELDOM_SIGMAS, _SELDOM_S = 5.0, 3.0, 1.0
_WRONG_FIX_M = 20.0
_LANDS_S = 2.0  # from the last half metre until it is told to have landed


def estimate_sigmas(log: FlightLog) -> list[tuple[float, float]]:
    """(arrival, how many of its sigmas it is wrong) of each estimate whose truth is known.

    An error of the map itself, a shift of all of it, is none of the estimate's.
    """
    rows = []
    for sent in log.estimates:
        truth = log.true_place_ne_m(sent.stamp_s)
        if truth is None:
            continue
        north, east = sent.position_ned_m[0] - truth[0], sent.position_ned_m[1] - truth[1]
        own_share = max(0.0, 1.0 - log.map_off_m / max(math.hypot(north, east), 1e-9))
        north, east = own_share * north, own_share * east
        a, b, c = sent.covariance_ne_m2
        a, c = a + log.map_sigma_m**2, c + log.map_sigma_m**2
        determinant = a * c - b * b
        if determinant > 0.0:
            square = (c * north**2 - 2.0 * b * north * east + a * east**2) / determinant
            rows.append((sent.t_s, math.sqrt(max(square, 0.0))))
    return rows


def _sigma_shrinks(log: FlightLog) -> Breach | None:
    """Over two seconds to which no fix belongs, flying."""
    fixes = [fix.t_s for fix in log.fixes]
    taken = [(t_s, t_s + _FIX_LATE_S) for t_s in fixes]
    pauses = [(a[1], b[0]) for a, b in pairwise(taken) if b[0] - a[1] > _NO_FIX_S]
    if taken:
        pauses.append((taken[-1][1], math.inf))
    # A way from before a gap of telemetry tells again where the gap has led.
    spans = without(flying(log), log.broken, _RECOVERY_S)
    for lo, hi in pauses:
        rows = [e for e in log.estimates if lo <= e.t_s <= hi and inside(e.t_s, spans)]
        broken = _shrinks(rows)
        if broken is not None:
            return broken
    return None


def _shrinks(rows: Sequence[Sent]) -> Breach | None:
    first = 0
    for row in rows:
        while row.t_s - rows[first].t_s > _NO_FIX_S:
            first += 1
        past = rows[first]
        same = past.reset_counter == row.reset_counter
        if same and row.sigma_m < _SHRINKS * past.sigma_m:
            return Breach(row.t_s, f"from {past.sigma_m:.2f} to {row.sigma_m:.2f} m without a fix")
    return None


def _uncertain(log: FlightLog) -> Breach | None:
    """From the first certain one on: a first search takes seconds."""
    limit_m = log.bounds.estimate.max_position_sigma_m
    first_s = min([fix.t_s for fix in log.fixes], default=math.inf)
    flown = [each for each in sent_armed(log) if each.t_s > first_s]
    return always(
        dropwhile(lambda each: not each.sigma_m <= limit_m, flown),
        lambda each: each.sigma_m <= limit_m,
        lambda each: f"sigma {each.sigma_m:.0f} m",
    )


def _never_so_wrong(log: FlightLog) -> Breach | None:
    wrong = [(t_s, n) for t_s, n in estimate_sigmas(log) if n > _NEVER_SIGMAS]
    return Breach(wrong[0][0], f"{wrong[0][1]:.1f} sigmas wrong") if wrong else None


def _seldom_wrong(log: FlightLog) -> Breach | None:
    rows = [At(t_s, (count, 0.0)) for t_s, count in estimate_sigmas(log)]
    long = after(_SELDOM_S, spans_where(rows, lambda row: row.ne[0] > _SELDOM_SIGMAS))
    return Breach(long[0][0] - _SELDOM_S, "over 3 sigmas wrong for over 1 s") if long else None


def _wrong_velocity(log: FlightLog) -> Breach | None:
    """Of those that are told in the air: an autopilot brakes by them.

    Half a metre up the filter may take it for standing; it is told to have landed a second later.
    """
    until_s = touch_down_s(log) - _LANDS_S

    def off_sigmas(sent: Sent) -> float:
        truth = log.true_velocity_ne_m_s(sent.stamp_s)
        if truth is None or sent.velocity_ned_m_s is None or sent.sigma_m_s is None:
            return 0.0
        return math.dist(sent.velocity_ned_m_s[:2], truth) / sent.sigma_m_s

    return always(
        [sent for sent in log.estimates if sent.t_s < until_s],
        lambda sent: off_sigmas(sent) <= _NEVER_SIGMAS,
        lambda sent: f"{off_sigmas(sent):.1f} sigmas wrong",
    )


def _wrong_fix(log: FlightLog) -> Breach | None:
    def off_m(fix: At) -> float:
        truth = log.true_place_ne_m(fix.t_s)
        return 0.0 if truth is None else math.dist(fix.ne, truth)

    return always(
        log.fixes, lambda fix: off_m(fix) <= _WRONG_FIX_M, lambda fix: f"{off_m(fix):.0f} m"
    )


BELIEF = (
    Rule(
        "sigma without fixes",
        "Without fixes sigma does not shrink.",
        ("vehicle", "estimates", "fixes"),
        _sigma_shrinks,
    ),
    Rule(
        "sigma bounded",
        "After the first fix no estimate is sent that is uncertain beyond its limit.",
        ("vehicle", "estimates", "fixes"),
        _uncertain,
    ),
    Rule(
        "never 5 sigmas wrong",
        "No estimate sent is more than 5 of its sigmas wrong.",
        ("estimates", "truth"),
        _never_so_wrong,
    ),
    Rule(
        "seldom 3 sigmas wrong",
        "Estimates are not more than 3 of their sigmas wrong for over 1 s.",
        ("estimates", "truth"),
        _seldom_wrong,
    ),
    Rule(
        "told velocity",
        "No velocity that the autopilot is told in the air is more than 5 of its sigmas wrong.",
        ("vehicle", "estimates", "truth"),
        _wrong_velocity,
    ),
    Rule(
        "fix right",
        "No fix that the filter takes is more than 20 m wrong.",
        ("fixes", "truth"),
        _wrong_fix,
    ),
    Rule(
        "belief speed",
        "The filter never believes in a speed beyond the envelope.",
        ("beliefs",),
        lambda log: always(
            log.beliefs,
            lambda row: math.hypot(*row.ne) < log.bounds.estimate.max_speed_m_s,
            lambda row: f"{math.hypot(*row.ne):.0f} m/s",
        ),
    ),
)
