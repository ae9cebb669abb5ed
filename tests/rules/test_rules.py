"""Each rule is red on a short flight with one thing wrong in it, and green on a good one."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from good_flight import (
    ARM,
    DISARMED_S,
    LAND,
    LAND_S,
    ROUTE_S,
    SET_MODE,
    TAKEOFF,
    WATCHDOG,
    good_flight,
    sent_at,
    silent,
    with_command,
    with_mode,
    with_phases,
    with_sent,
    with_setpoint,
)

from vwnav.mission.mission import Phase
from vwnav.rules.flight_log import (
    MISSION_HANGS,
    NAVIGATOR_ENDED,
    At,
    CommandAck,
    FlightLog,
    Heartbeat,
    ParameterSet,
    Said,
)
from vwnav.rules.rule import Rule, check
from vwnav.rules.table import RULES
from vwnav.vehicle import FlightMode

PILOT_S = 15.0
NAN = math.nan


def taken(log: FlightLog) -> FlightLog:
    return with_mode(log, FlightMode.MANUAL, PILOT_S)


def refused(log: FlightLog, *times_s: float) -> FlightLog:
    return replace(log, answers=[CommandAck(t_s, ARM, False) for t_s in times_s])


def battery(log: FlightLog, ratio: float, from_s: float = 12.0) -> FlightLog:
    rows = [replace(r, battery_ratio=ratio if r.t_s >= from_s else 0.9) for r in log.vehicle]
    return replace(log, vehicle=rows)


def further(log: FlightLog, north_m: float, from_s: float, counter: int = 0) -> FlightLog:
    """From then on estimates are so much off."""
    rows = []
    for row in log.estimates:
        north, east, down = row.position_ned_m
        moved = replace(row, position_ned_m=(north + north_m, east, down), reset_counter=counter)
        rows.append(moved if row.t_s >= from_s else row)
    return replace(log, estimates=rows)


def running_away(log: FlightLog) -> FlightLog:
    rows = []
    for row in log.estimates:
        north, east, down = row.position_ned_m
        north += 60.0 * max(row.t_s - ROUTE_S, 0.0)
        rows.append(replace(row, position_ned_m=(north, east, down)))
    return replace(log, estimates=rows)


RED: dict[str, Callable[[FlightLog], FlightLog]] = {
    "setpoint after the pilot": taken,
    "setpoint out of control": lambda log: with_phases(
        log, (0.0, Phase.ROUTE), (20.0, Phase.RELEASED)
    ),
    "setpoint while landing": lambda log: with_setpoint(log, LAND_S + 1.0, 1.0, 0.0, 0.0),
    "setpoint disarmed": lambda log: with_setpoint(log, 1.5, 0.0, 0.0, 0.0),
    "setpoint finite": lambda log: with_setpoint(log, 12.0, NAN, 0.0, 0.0),
    "setpoint speed": lambda log: with_setpoint(log, 12.0, 8.0, 8.0, 0.0),
    "setpoint climb": lambda log: with_setpoint(log, 12.0, 0.0, 0.0, -4.0),
    "setpoint pause": lambda log: silent(log, "setpoints", 12.0, 13.0),
    "watchdog still": lambda log: with_setpoint(log, 12.0, 1.0, 0.0, 0.0, by=WATCHDOG),
    "own setpoints": lambda log: with_setpoint(log, 12.0, 0.0, 0.0, 0.0, by=1),
    "command after the pilot": lambda log: with_command(taken(log), 20.0, SET_MODE, 1, 4, 3),
    "own commands": lambda log: replace(
        log, commands=[replace(each, component=190) for each in log.commands]
    ),
    "arming on the ground": lambda log: with_command(log, 12.0, ARM, 1.0),
    "arming after a refusal": lambda log: with_command(refused(log, 0.6), 0.9, ARM, 1.0),
    "arming tries": lambda log: with_command(refused(log, -20.0, -10.0, 0.0), 1.0, ARM, 1.0),
    "arming again": lambda log: with_command(log, DISARMED_S + 1.0, ARM, 1.0),
    "arming with a battery": lambda log: battery(log, 0.3, from_s=0.0),
    "arming forced": lambda log: with_command(log, 1.0, ARM, 0.0, 21196.0),
    "disarming in the air": lambda log: with_command(log, 12.0, ARM, 0.0),
    "take-off on the ground": lambda log: with_command(log, 12.0, TAKEOFF),
    "modes asked for": lambda log: with_command(log, 12.0, SET_MODE, 1.0, 3.0, 0.0),
    "Offboard from our modes": lambda log: with_mode(log, FlightMode.RETURN, 5.5, 5.9),
    "Offboard after Land": lambda log: with_command(
        with_command(log, 5.0, LAND), 25.0, SET_MODE, 1.0, 6.0, 0.0
    ),
    "commands repeated": lambda log: replace(
        log, commands=[replace(log.commands[-1], t_s=LAND_S + 0.1 * k) for k in range(6)]
    ),
    "parameters in flight": lambda log: replace(
        log, parameters_set=[ParameterSet(12.0, "EKF2_EV_CTRL", 0.0)]
    ),
    "order of phases": lambda log: with_phases(log, (0.0, Phase.CLIMB), (9.0, Phase.DESCEND)),
    "route after fixes": lambda log: silent(log, "fixes", 0.0, ROUTE_S),
    "over on the ground": lambda log: with_phases(log, (0.0, Phase.LAND), (26.0, Phase.DONE)),
    "battery critical": lambda log: battery(log, 0.1),
    "battery low": lambda log: battery(log, 0.2),
    "lost lands": lambda log: silent(log, "estimates", 12.0, 20.0),
    "uncertain stops": lambda log: with_sent(log, 12.0, 18.0, covariance_ne_m2=(100.0, 0.0, 9.0)),
    "blind lands": lambda log: silent(log, "sights", 12.0, 21.0),
    "landing is flown": lambda log: with_mode(log, FlightMode.OFFBOARD, LAND_S, 29.0),
    "landing ends": lambda log: replace(
        log,
        vehicle=[
            *(row for row in log.vehicle if row.t_s < LAND_S + 1.0),
            *(
                replace(log.vehicle[-1], t_s=LAND_S + t, armed=True, in_air=True)
                for t in range(1, 200)
            ),
        ],
    ),
    "nothing after touch-down": lambda log: with_command(log, 32.0, SET_MODE, 1.0, 4.0, 6.0),
    "soft touch-down": lambda log: replace(
        log, truth=[replace(row, velocity_ned_m_s=(0.0, 0.0, 3.0)) for row in log.truth]
    ),
    "home stays": lambda log: replace(log, homes=[At(10.0, (0.0, 0.0)), At(12.0, (5.0, 0.0))]),
    "reason of a landing": lambda log: with_phases(log, (0.0, Phase.ROUTE), (LAND_S, Phase.LAND)),
    "nothing fails": lambda log: replace(log, events=[Said(9.0, "the mission broke: ...")]),
    "estimate finite": lambda log: with_sent(log, 12.0, 12.1, position_ned_m=(NAN, 0.0, 0.0)),
    "estimate covariance": lambda log: with_sent(log, 12.0, 12.1, covariance_ne_m2=(1.0, 2.0, 1.0)),
    "estimate age": lambda log: with_sent(log, 12.0, 12.1, stamp_s=11.0),
    "estimate of the future": lambda log: with_sent(log, 12.0, 12.1, stamp_s=12.4),
    "estimate order": lambda log: with_sent(log, 12.0, 12.1, stamp_s=11.8),
    "estimate speed": running_away,
    "estimate jump": lambda log: further(log, 8.0, 12.0),
    "reset counter up": lambda log: with_sent(log, 0.0, 12.0, reset_counter=1),
    "reset counter's cause": lambda log: further(log, -0.2, 12.0, counter=1),
    "reset counter steady": lambda log: further(further(log, 1.0, 12.0, 1), 1.0, 12.3, 2),
    "lost comes back new": lambda log: silent(log, "estimates", 12.0, 15.0),
    "estimate rate": lambda log: silent(log, "estimates", 12.0, 12.3),
    "heartbeat": lambda log: silent(log, "beats", 12.0, 15.0),
    "no ground station": lambda log: replace(log, beats=[Heartbeat(1.0, 191, 6)]),
    "sigma without fixes": lambda log: with_sent(
        silent(log, "fixes", 11.0), 15.0, covariance_ne_m2=(0.1, 0.0, 0.1)
    ),
    "sigma bounded": lambda log: with_sent(log, 12.0, covariance_ne_m2=(4900.0, 0.0, 1.0)),
    "never 5 sigmas wrong": lambda log: further(log, 4.0, 12.0),
    "seldom 3 sigmas wrong": lambda log: further(log, 2.0, 12.0),
    "told velocity": lambda log: with_sent(
        log, 12.0, 12.1, velocity_ned_m_s=(9.0, 0.0, 0.0), sigma_m_s=0.3
    ),
    "fix right": lambda log: replace(log, fixes=[At(12.0, (40.0, 0.0))]),
    "belief speed": lambda log: replace(log, beliefs=[At(12.0, (30.0, 30.0))]),
}


def verdict_of(rule: Rule, log: FlightLog) -> str:
    return check([rule], log)[0].outcome


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.name)
def test_a_rule_is_kept_by_a_good_flight_and_broken_by_its_breach(rule: Rule) -> None:
    log = good_flight()
    assert verdict_of(rule, log) == "held", check([rule], log)[0].breach
    assert verdict_of(rule, RED[rule.name](log)) == "broken"


def test_rules_have_names_of_their_own() -> None:
    assert len({rule.name for rule in RULES}) == len(RULES) >= 30


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.name)
def test_a_stream_that_nobody_noted_tells_nothing(rule: Rule) -> None:
    unknown = replace(good_flight(), unknown=frozenset(rule.needs[-1:]))
    assert verdict_of(rule, unknown) == "not to be told"


def test_samples_tell_nothing_of_gaps() -> None:
    sampled = replace(silent(good_flight(), "setpoints", 12.0, 13.0), sampled=True)
    pause = next(rule for rule in RULES if rule.name == "setpoint pause")
    assert verdict_of(pause, sampled) == "not to be told"


def test_what_is_broken_on_purpose_need_not_be_steady() -> None:
    cut = replace(silent(good_flight(), "setpoints", 12.0, 13.0), broken=[(12.0, 13.0)])
    pause = next(rule for rule in RULES if rule.name == "setpoint pause")
    assert verdict_of(pause, cut) == "held"


@pytest.mark.parametrize(("round_trip_s", "verdict"), [(0.0, "broken"), (0.3, "held")])
def test_what_was_said_before_a_pilot_was_heard_of_may_still_come(round_trip_s, verdict) -> None:
    """Rows are of the autopilot's end of a line that takes its time, both ways."""
    log = with_mode(good_flight(), FlightMode.MANUAL, 15.0)
    log = silent(log, "setpoints", 15.5, math.inf)
    rule = next(rule for rule in RULES if rule.name == "setpoint after the pilot")
    assert verdict_of(rule, replace(log, round_trip_s=round_trip_s)) == verdict


def test_a_pilot_who_hands_it_back_is_obeyed() -> None:
    log = with_mode(good_flight(), FlightMode.MANUAL, 15.0, 18.0)
    log = silent(log, "setpoints", 15.0, 18.1)
    assert verdict_of(RULES[0], log) == "held"


@pytest.mark.parametrize(("back_s", "verdict"), [(18.0, "held"), (18.001, "broken")])
def test_a_setpoint_of_the_moment_in_which_a_phase_begins_is_of_that_one(back_s, verdict) -> None:
    """Handed back, the mission streams zero velocity from the very tick on."""
    rule = next(rule for rule in RULES if rule.name == "setpoint out of control")
    log = silent(good_flight(), "setpoints", 15.0, 18.001)
    log = with_setpoint(log, 18.0, 0.0, 0.0, 0.0)
    stages = ((0.0, Phase.ROUTE), (15.0, Phase.RELEASED), (back_s, Phase.RESUME))
    assert verdict_of(rule, with_phases(log, *stages)) == verdict


def test_a_landing_that_a_pilot_took_over_may_be_handed_back_and_flown_on() -> None:
    """The watchdog's landing, say."""
    rule = next(rule for rule in RULES if rule.name == "Offboard after Land")
    asked = with_command(with_command(good_flight(), 8.0, LAND), 15.0, SET_MODE, 1.0, 6.0, 0.0)
    back = replace(asked, events=[Said(14.0, "a ground station asks for going on")])
    assert verdict_of(rule, asked) == "broken"
    assert verdict_of(rule, back) == "held"
    assert verdict_of(rule, with_command(back, 17.0, SET_MODE, 1.0, 6.0, 0.0)) == "held"
    again = with_command(with_command(back, 20.0, LAND), 25.0, SET_MODE, 1.0, 6.0, 0.0)
    assert verdict_of(rule, again) == "broken"


@pytest.mark.parametrize(
    ("number", "after_s", "verdict"),
    [(LAND, 0.1, "held"), (SET_MODE, 2.9, "held"), (LAND, 3.1, "broken"), (ARM, 0.1, "broken")],
)
def test_a_landing_that_the_autopilot_refuses_is_answered(number, after_s, verdict) -> None:
    rule = next(rule for rule in RULES if rule.name == "landing is flown")
    unflown = RED[rule.name](good_flight())
    refused = replace(unflown, answers=[CommandAck(LAND_S + after_s, number, False)])
    assert verdict_of(rule, refused) == verdict


def test_a_mission_travels_no_more_whose_navigator_has_ended() -> None:
    rule = next(rule for rule in RULES if rule.name == "blind lands")
    blind = RED[rule.name](good_flight())
    assert verdict_of(rule, blind) == "broken"
    for text in (NAVIGATOR_ENDED, MISSION_HANGS):
        ended = replace(blind, events=[*blind.events, Said(14.0, text)])
        assert verdict_of(rule, ended) == "held"


def test_who_stops_the_motors_in_the_air_has_it_fall() -> None:
    rule = next(rule for rule in RULES if rule.name == "soft touch-down")
    fallen = RED[rule.name](good_flight())
    assert verdict_of(rule, fallen) == "broken"
    stopped = [replace(row, armed=row.t_s < 12.0) for row in fallen.vehicle]
    assert verdict_of(rule, replace(fallen, vehicle=stopped)) == "held"


def test_an_estimate_of_the_good_flight_is_a_fraction_of_a_metre_wrong() -> None:
    assert sent_at(12.0).sigma_m == pytest.approx(0.5)


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.name)
def test_the_manual_has_every_rule(rule: Rule) -> None:
    manual = (Path(__file__).parents[2] / "docs" / "rules.md").read_text()
    assert f"| {rule.name} | {rule.says} |" in manual
