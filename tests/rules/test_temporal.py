"""The vocabulary of the rules."""

import math

from vwnav.rules.flight_log import Moment
from vwnav.rules.temporal import after, never_while, spans_where, steady, within, without

ROWS = [Moment(float(t)) for t in range(10)]


def test_spans_end_at_the_first_row_where_it_does_not_hold() -> None:
    assert spans_where(ROWS, lambda row: row.t_s in (2, 3, 8, 9)) == [(2.0, 4.0), (8.0, 9.0)]


def test_a_hole_ends_a_span() -> None:
    rows = [Moment(0.0), Moment(1.0), Moment(5.0), Moment(6.0)]
    assert spans_where(rows, lambda _: True, hole_s=2.0) == [(0.0, 1.0), (5.0, 6.0)]


def test_within_asks_nothing_of_the_time_after_the_log() -> None:
    assert within(2.0, [9.0], [], 10.0, "an answer") is None
    assert within(2.0, [5.0], [7.5], 10.0, "an answer") is not None
    assert within(2.0, [5.0], [6.5], 10.0, "an answer") is None


def test_never_while_tells_the_first_row_inside() -> None:
    breach = never_while([(3.5, 4.5), (7.0, math.inf)], ROWS, lambda row: "there")
    assert breach is not None
    assert breach.t_s == 4.0


def test_steady_looks_only_into_its_spans_and_at_their_ends() -> None:
    rows = [Moment(0.0), Moment(3.0), Moment(4.0)]
    assert steady(rows, 2.0, [(1.0, 4.0)], "nothing") is None
    assert steady(rows, 2.0, [(0.0, 4.0)], "nothing") is not None
    assert steady(rows, 2.0, [(3.0, 7.0)], "nothing") is not None
    assert steady([], 2.0, [(0.0, 7.0)], "nothing") is not None


def test_after_and_without_cut_spans() -> None:
    assert after(1.0, [(0.0, 0.5), (2.0, 5.0)]) == [(3.0, 5.0)]
    assert without([(0.0, 10.0)], [(4.0, 5.0)], 1.0) == [(0.0, 4.0), (6.0, 10.0)]
