"""The table, row by row: what decides, with which words, and exactly from when."""

import math
from dataclasses import replace

import pytest

from vwnav.safety.hierarchy import Action, Decision, Hierarchy, Rank
from vwnav.safety.safety_config import SafetyConfig
from vwnav.safety.situation import BatteryLevel, Situation
from vwnav.vehicle import FlightMode, Order

CONFIG = SafetyConfig()
WELL = Situation()
BLIND = "the camera shows nothing that can be followed"
LATE = "pictures are late or do not come"


def decide(**changes) -> Decision:
    return Hierarchy(CONFIG).step(replace(WELL, **changes))


@pytest.mark.parametrize(
    ("changes", "action", "reason", "rank"),
    [
        ({}, Action.NAVIGATE, "", Rank.NAVIGATION),
        ({"released": "the pilot took over"}, Action.RELEASE, "the pilot took over", Rank.PILOT),
        ({"failsafe": FlightMode.LAND}, Action.YIELD,
         f"the autopilot flies its failsafe: {FlightMode.LAND.value}", Rank.PILOT),
        ({"battery": BatteryLevel.CRITICAL}, Action.LAND, "battery critical", Rank.BATTERY),
        ({"battery": BatteryLevel.LOW}, Action.RETURN, "battery low", Rank.WAY_HOME),
        ({"silence_s": 3.0}, Action.NAVIGATE, "", Rank.NAVIGATION),
        ({"silence_s": 3.1}, Action.HOLD, "the autopilot is not heard", Rank.SIGNAL),
        ({"connected": False}, Action.HOLD, "the autopilot is not heard", Rank.SIGNAL),
        ({"silence_s": 10.0}, Action.HOLD, "the autopilot is not heard", Rank.SIGNAL),
        ({"silence_s": 10.1}, Action.LAND, "the autopilot has gone silent", Rank.SIGNAL),
        ({"lost_s": 0.0, "lost": "it jumped"}, Action.HOLD, "the estimate is lost: it jumped",
         Rank.SIGNAL),
        ({"lost_s": 1.9, "lost": "x"}, Action.HOLD, "the estimate is lost: x", Rank.SIGNAL),
        ({"lost_s": 2.0, "lost": "x"}, Action.LAND, "the estimate is lost: x", Rank.SIGNAL),
        ({"blind_s": 0.9}, Action.NAVIGATE, "", Rank.NAVIGATION),
        ({"blind_s": 1.0}, Action.HOLD, BLIND, Rank.SIGNAL),
        ({"blind_s": 6.0}, Action.LAND, BLIND, Rank.SIGNAL),
        ({"blind_s": 5.9}, Action.HOLD, BLIND, Rank.SIGNAL),
        ({"blind_s": 0.9, "is_unseen": True}, Action.NAVIGATE, "", Rank.NAVIGATION),
        ({"blind_s": 1.0, "is_unseen": True}, Action.HOLD, LATE, Rank.SIGNAL),
        ({"blind_s": 6.0, "is_unseen": True}, Action.LAND, LATE, Rank.SIGNAL),
        ({"contradicted": True}, Action.NAVIGATE, "", Rank.NAVIGATION),
        ({"contradicted": True, "had_fix": False}, Action.LAND,
         "the camera shows what contradicts the IMU", Rank.SIGNAL),
        ({"is_battery_for_home_only": True}, Action.RETURN,
         "the battery is just enough for the way home", Rank.WAY_HOME),
        ({"radio_lost_s": 5.0}, Action.NAVIGATE, "", Rank.NAVIGATION),
        ({"radio_lost_s": 5.1}, Action.RETURN, "the pilot's radio is lost", Rank.WAY_HOME),
        ({"ground_lost_s": 30.0}, Action.NAVIGATE, "", Rank.NAVIGATION),
        ({"ground_lost_s": 30.1}, Action.RETURN, "the ground station is lost", Rank.WAY_HOME),
        ({"radio_lost_s": 6.0, "had_fix": False}, Action.LAND, "the pilot's radio is lost",
         Rank.WAY_HOME),
        ({"off_route_m": 60.0}, Action.NAVIGATE, "", Rank.NAVIGATION),
        ({"off_route_m": 61.0}, Action.RETURN, "61 m off the route", Rank.POSITION),
        ({"warning": "poor"}, Action.SLOW, "poor", Rank.POSITION),
        ({"bad_s": 0.0, "complaint": "bad"}, Action.HOLD, "bad", Rank.POSITION),
        ({"bad_s": 4.9, "complaint": "bad"}, Action.HOLD, "bad", Rank.POSITION),
        ({"bad_s": 5.0, "complaint": "bad"}, Action.CLIMB, "bad", Rank.POSITION),
        ({"bad_s": 5.0, "complaint": "bad", "is_usable": False}, Action.HOLD, "bad",
         Rank.POSITION),
        ({"bad_s": 15.0, "complaint": "bad"}, Action.RETURN, "bad", Rank.POSITION),
        ({"bad_s": 15.0, "complaint": "bad", "is_usable": False}, Action.LAND, "bad",
         Rank.POSITION),
        ({"order": Order.LAND}, Action.LAND, "the ground station asks for a landing",
         Rank.OPERATOR),
        ({"order": Order.RETURN}, Action.RETURN, "the ground station asks for the way home",
         Rank.OPERATOR),
        ({"order": Order.RETURN, "had_fix": False}, Action.LAND,
         "the ground station asks for the way home", Rank.OPERATOR),
        ({"order": Order.PAUSE}, Action.HOLD, "the ground station asks for a pause",
         Rank.OPERATOR),
        ({"order": Order.GO_ON}, Action.NAVIGATE, "", Rank.NAVIGATION),
    ],
)  # fmt: skip
def test_each_row_decides_from_its_limit_on_with_its_words(changes, action, reason, rank):
    assert decide(**changes) == Decision(action, reason, rank)


def test_a_landing_goes_before_what_stands_above_it_but_not_before_the_pilot():
    both = {"silence_s": 4.0, "order": Order.LAND}
    assert decide(**both).action is Action.LAND
    assert decide(**both, released="taken").action is Action.RELEASE
    assert decide(**both, failsafe=FlightMode.RETURN).action is Action.YIELD


def test_what_stays_keeps_its_first_reason_and_what_the_pilot_overrules_does_not_begin():
    hierarchy = Hierarchy(CONFIG)
    low = replace(WELL, battery=BatteryLevel.LOW)
    assert hierarchy.step(low).reason == "battery low"
    assert hierarchy.step(replace(WELL, radio_lost_s=9.0)).reason == "battery low"
    assert hierarchy.step(WELL).action is Action.RETURN
    overruled = Hierarchy(CONFIG)
    overruled.step(replace(low, released="taken"))
    assert overruled.step(WELL).action is Action.NAVIGATE


def test_nobody_returns_on_a_position_that_leads_nowhere():
    assert decide(battery=BatteryLevel.LOW, is_usable=False).action is Action.NAVIGATE
    hierarchy = Hierarchy(CONFIG)
    hierarchy.step(replace(WELL, battery=BatteryLevel.LOW))
    assert hierarchy.step(replace(WELL, is_usable=False, warning="poor")).action is Action.SLOW
    assert hierarchy.step(WELL).action is Action.RETURN


def test_a_situation_begins_without_any_trouble():
    assert WELL.lost_s == WELL.radio_lost_s == WELL.ground_lost_s == WELL.bad_s == -math.inf
