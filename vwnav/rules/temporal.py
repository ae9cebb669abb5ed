"""The words that the rules are written in: always, never while, within, steady.

Each takes rows in order of time and gives the first breach, or None.
"""

import bisect
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise, zip_longest
from typing import Protocol, TypeVar

Span = tuple[float, float]  # from, to; seconds


class Stamped(Protocol):
    """A row of a log."""

    @property
    def t_s(self) -> float:
        """When."""
        ...


RowT = TypeVar("RowT", bound=Stamped)


@dataclass(frozen=True, slots=True)
class Breach:
    """A rule is broken: when, and by what."""

    t_s: float
    what: str


def always(
    rows: Iterable[RowT], good: Callable[[RowT], bool], what: Callable[[RowT], str]
) -> Breach | None:
    """Every row is good."""
    return next((Breach(row.t_s, what(row)) for row in rows if not good(row)), None)


def always_pairs(
    rows: Iterable[RowT], good: Callable[[RowT, RowT], bool], what: Callable[[RowT, RowT], str]
) -> Breach | None:
    """Every row fits the one before it."""
    return next((Breach(b.t_s, what(a, b)) for a, b in pairwise(rows) if not good(a, b)), None)


def never_while(
    spans: Sequence[Span], rows: Iterable[RowT], what: Callable[[RowT], str]
) -> Breach | None:
    """No row falls into a span."""
    return always(rows, lambda row: not inside(row.t_s, spans), what)


def within(
    seconds: float, triggers: Iterable[float], answers: Iterable[float], end_s: float, what: str
) -> Breach | None:
    """Every trigger is answered in time, unless the log ends before that."""
    times = sorted(answers)
    for t_s in triggers:
        due_s = t_s + seconds
        i = bisect.bisect_left(times, t_s)
        if due_s <= end_s and (i == len(times) or times[i] > due_s):
            return Breach(t_s, f"{what}: not within {seconds:g} s")
    return None


def steady(
    rows: Iterable[Stamped], most_s: float, spans: Sequence[Span], what: str
) -> Breach | None:
    """In no span there is a longer time without a row, its beginning and end included."""
    times = [row.t_s for row in rows]
    for lo, hi in spans:
        within_it = times[bisect.bisect_left(times, lo) : bisect.bisect_right(times, hi)]
        for a_s, b_s in pairwise([lo, *within_it, hi]):
            if b_s - a_s > most_s:
                return Breach(a_s, f"{what} for {b_s - a_s:.2f} s")
    return None


# ---- spans


def inside(t_s: float, spans: Sequence[Span]) -> bool:
    """Whether a moment lies in one of them, ends included."""
    return any(lo <= t_s <= hi for lo, hi in spans)


def spans_where(
    rows: Sequence[RowT], holds: Callable[[RowT], bool], hole_s: float = math.inf
) -> list[Span]:
    """From each row where it begins to hold until the first where it does not, or the last row.

    `hole_s` without a row end a span at the last row before: nobody knows what was so in it.
    """
    spans: list[Span] = []
    since_s: float | None = None
    for row, after_it in zip_longest(rows, rows[1:]):
        if holds(row) and since_s is None:
            since_s = row.t_s
        if since_s is None:
            continue
        if not holds(row) or after_it is None or after_it.t_s - row.t_s > hole_s:
            spans.append((since_s, row.t_s))
            since_s = None
    return spans


def after(seconds: float, spans: Iterable[Span]) -> list[Span]:
    """What is left of spans when so much of their beginning is cut off."""
    return [(lo + seconds, hi) for lo, hi in spans if hi > lo + seconds]


def without(spans: Iterable[Span], cut: Sequence[Span], margin_s: float = 0.0) -> list[Span]:
    """What is left of spans outside of others, and for a margin after those."""
    left = list(spans)
    for cut_lo, cut_hi in cut:
        left = [
            part
            for lo, hi in left
            for part in ((lo, min(hi, cut_lo)), (max(lo, cut_hi + margin_s), hi))
            if part[1] > part[0]
        ]
    return left
