"""What is asked of an autopilot that flies its own failsafe, tick by tick."""

from dataclasses import replace

import numpy as np
import pytest
from vehicles import FLYING

from vwnav.safety.recovery import Recovery, Wish
from vwnav.safety.safety_config import SafetyConfig
from vwnav.types import Estimate
from vwnav.vehicle import FlightMode

CONFIG = SafetyConfig()
TICK_S = 0.1
ESTIMATE = Estimate(
    t_s=0.0, position_ned_m=np.array([10.0, 20.0, -50.0]), velocity_ned_m_s=np.zeros(3),
    covariance=np.eye(6), quat_wxyz=np.array([1.0, 0.0, 0.0, 0.0]), sigma_yaw_rad=0.1,
    agl_m=50.0, sigma_agl_m=1.0, t_last_fix_s=0.0, reset_counter=0,
)  # fmt: skip
LANDS = replace(
    FLYING, mode=FlightMode.LAND, failsafe=True, own_position_ned_m=np.array([10.0, 20.0, -40.0])
)


def wishes(recovery: Recovery, seconds: float, vehicle=LANDS, estimate=ESTIMATE, gap_s=3.0) -> list:
    steps = range(round(seconds / TICK_S))
    return [recovery.step(vehicle, estimate, gap_s, i * TICK_S) for i in steps]


def test_hold_is_asked_for_once_a_new_estimate_agrees_for_a_second_then_land():
    recovery = Recovery(CONFIG, explained=True)
    asked = wishes(recovery, 5.0)
    assert asked[:10] == [Wish.WAIT] * 10
    assert asked[10] is Wish.HOLD
    assert recovery.has_asked
    assert asked[11:30] == [Wish.WAIT] * 19
    assert asked[30:] == [Wish.LAND] * 20


@pytest.mark.parametrize("explained", [True, False])
@pytest.mark.parametrize("mode", [FlightMode.OFFBOARD, FlightMode.RETURN, FlightMode.HOLD])
def test_nothing_is_asked_of_an_aircraft_that_the_autopilot_has_brought_down(mode, explained):
    recovery = Recovery(CONFIG, explained=explained)
    wishes(recovery, 1.1)
    landed = replace(LANDS, mode=mode, in_air=False)
    assert set(wishes(recovery, 5.0, landed)) == {Wish.WAIT}


def test_land_follows_at_once_when_the_hold_shows():
    recovery = Recovery(CONFIG, explained=True)
    assert wishes(recovery, 1.1)[-1] is Wish.HOLD
    held = replace(LANDS, mode=FlightMode.HOLD)
    assert recovery.step(held, ESTIMATE, 3.0, 1.2) is Wish.LAND


@pytest.mark.parametrize("mode", [FlightMode.RETURN, FlightMode.OTHER, FlightMode.MANUAL])
def test_nothing_follows_the_hold_while_nobody_has_told_whose_mode_it_is(mode):
    recovery = Recovery(CONFIG, explained=True)
    assert wishes(recovery, 1.1)[-1] is Wish.HOLD
    untold = replace(LANDS, mode=mode, intended_mode=FlightMode.UNKNOWN, failsafe=False)
    assert {recovery.step(untold, ESTIMATE, 3.0, t_s) for t_s in (1.2, 3.0, 4.0)} == {Wish.WAIT}


@pytest.mark.parametrize(
    ("own", "sigma_m"),
    [(None, 1.0), (np.array([13.1, 20.0, -50.0]), 0.1), (np.array([10.0, 26.2, -50.0]), 2.0)],
)
def test_an_autopilot_that_is_elsewhere_or_does_not_say_is_asked_for_nothing(own, sigma_m):
    estimate = replace(ESTIMATE, covariance=sigma_m**2 * np.eye(6))
    vehicle = replace(LANDS, own_position_ned_m=own)
    recovery = Recovery(CONFIG, explained=True)
    assert set(wishes(recovery, 5.0, vehicle, estimate)) == {Wish.WAIT}
    assert not recovery.has_asked


def test_three_sigmas_off_is_still_agreement_and_so_are_three_metres():
    for own, sigma_m in [((12.9, 20.0, 0.0), 0.1), ((10.0, 25.8, 0.0), 2.0)]:
        estimate = replace(ESTIMATE, covariance=sigma_m**2 * np.eye(6))
        vehicle = replace(LANDS, own_position_ned_m=np.array(own))
        assert Wish.HOLD in wishes(Recovery(CONFIG, explained=True), 2.0, vehicle, estimate)


def test_agreement_that_is_interrupted_begins_anew():
    recovery = Recovery(CONFIG, explained=True)
    wishes(recovery, 0.9)
    assert recovery.step(LANDS, None, 3.0, 0.9) is Wish.WAIT
    assert recovery.step(LANDS, ESTIMATE, 3.0, 1.5) is Wish.WAIT
    assert recovery.step(LANDS, ESTIMATE, 3.0, 2.4) is Wish.WAIT
    assert recovery.step(LANDS, ESTIMATE, 3.0, 2.6) is Wish.HOLD


@pytest.mark.parametrize(("gap_s", "wish"), [(1.0, Wish.GO_ON), (1.1, Wish.LAND)])
def test_back_in_our_mode_it_goes_on_after_a_short_gap_and_lands_after_a_long_one(gap_s, wish):
    back = replace(LANDS, mode=FlightMode.OFFBOARD, failsafe=False)
    assert Recovery(CONFIG, explained=True).step(back, ESTIMATE, gap_s, 0.0) is wish


def test_after_a_short_gap_it_stays_where_it_is_if_there_is_an_estimate():
    assert set(wishes(Recovery(CONFIG, True), 5.0, gap_s=1.0)) == {Wish.STAY}
    assert set(wishes(Recovery(CONFIG, True), 5.0, estimate=None, gap_s=1.0)) == {Wish.WAIT}


def test_a_failsafe_that_no_gap_of_ours_explains_is_not_ours_to_end():
    recovery = Recovery(CONFIG, explained=False)
    for i, failsafe in enumerate((False, True, True)):
        seen = replace(LANDS, failsafe=failsafe)
        assert recovery.step(seen, ESTIMATE, 0.5, 0.1 * i) is Wish.STAY
    untold = replace(LANDS, mode=FlightMode.UNKNOWN)
    assert recovery.step(untold, ESTIMATE, 0.5, 0.3) is Wish.WAIT


STICKS = replace(
    LANDS, mode=FlightMode.MANUAL, intended_mode=FlightMode.OFFBOARD, failsafe=True,
    own_position_ned_m=None, rc_available=False,
)  # fmt: skip


def test_in_a_mode_of_the_sticks_nothing_is_sent_until_it_is_told_that_no_pilot_chose_it():
    recovery = Recovery(CONFIG, explained=False)
    untold = replace(STICKS, intended_mode=FlightMode.UNKNOWN, failsafe=False)
    assert recovery.step(untold, ESTIMATE, 0.5, 0.0) is Wish.WAIT
    assert recovery.step(STICKS, ESTIMATE, 0.5, 0.2) is Wish.STAY


@pytest.mark.parametrize("explained", [True, False])
def test_left_in_a_mode_of_the_sticks_it_is_asked_to_land(explained):
    """PX4 of the 1.16 era holds its height in it for as long as the battery lasts."""
    asked = wishes(Recovery(CONFIG, explained=explained), 6.0, STICKS, None)
    assert Wish.LAND not in asked[:49]
    assert set(asked[51:]) == {Wish.LAND}


def test_a_long_gap_is_not_forgotten_however_late_the_autopilot_agrees():
    """It held for good: the watches remember a gap for ten seconds."""
    recovery = Recovery(CONFIG, explained=True)
    holds = replace(LANDS, mode=FlightMode.HOLD, own_position_ned_m=None)
    assert set(wishes(recovery, 1.0, holds)) == {Wish.WAIT}
    assert set(wishes(recovery, 20.0, holds, gap_s=0.0)) == {Wish.WAIT}
    agrees = replace(holds, own_position_ned_m=np.array([10.0, 20.0, -40.0]))
    assert wishes(recovery, 2.0, agrees, gap_s=0.0)[-1] is Wish.LAND
