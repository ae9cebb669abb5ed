"""Positions that follow each other: excess, silence, velocity."""

import pytest

from vwnav.safety.estimate_track import Track


def track(*points: tuple[float, float, float]) -> Track:
    made = Track(max_speed_m_s=10.0, max_jump_m=3.0)
    for point in points:
        made.add(*point)
    return made


def test_before_the_first_one_nothing_jumps_is_silent_or_moves():
    empty = track()
    assert empty.excess_m(5.0, 1e6, 0.0) == 0.0
    assert not empty.jumped(5.0, 1e6, 0.0)
    assert empty.silent_s(5.0) == 0.0
    assert empty.velocity_m_s() == (0.0, 0.0)


def test_what_flight_explains_is_no_excess_and_the_rest_is():
    one = track((1.0, 100.0, 200.0))
    assert one.excess_m(2.0, 106.0, 208.0) == 0.0
    assert one.excess_m(2.0, 109.0, 212.0) == pytest.approx(5.0)
    assert one.excess_m(0.0, 103.0, 204.0) == pytest.approx(5.0)  # it does not fly back in time


def test_a_jump_is_more_than_was_allowed():
    one = track((1.0, 0.0, 0.0))
    assert not one.jumped(1.0, 3.0, 0.0)
    assert one.jumped(1.0, 3.01, 0.0)


def test_the_oldest_and_the_newest_both_count():
    """It creeps away by less than a jump at a time."""
    creeping = track((0.0, 0.0, 0.0), (0.1, 3.9, 0.0), (0.2, 7.8, 0.0))
    assert creeping.excess_m(0.3, 11.7, 0.0) == pytest.approx(8.7)
    assert creeping.excess_m(0.3, 1.0, 0.0) == pytest.approx(5.8)


def test_only_the_last_second_counts():
    old = track((0.0, 0.0, 0.0), (1.0, 8.0, 0.0), (1.5, 12.0, 0.0))
    assert old.velocity_m_s() == (8.0, 0.0)
    assert old.silent_s(1.75) == 0.25
    kept = track((0.0, 50.0, 0.0), (1.0, 8.0, 0.0))  # a second old is not yet too old
    assert kept.velocity_m_s() == (-42.0, 0.0)


def test_velocity_is_that_from_end_to_end_and_zero_of_too_short_a_time():
    assert track((0.0, 1.0, 2.0), (0.2, 2.0, -2.0)).velocity_m_s() == pytest.approx((5.0, -20.0))
    assert track((0.0, 1.0, 2.0), (0.19, 2.0, -2.0)).velocity_m_s() == (0.0, 0.0)


def test_a_cleared_one_begins_anew():
    one = track((0.0, 0.0, 0.0))
    one.clear()
    assert not one.jumped(0.1, 1e3, 0.0)
