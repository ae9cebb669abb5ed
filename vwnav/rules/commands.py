"""Rules of commands: who may ask the autopilot for a mode, arming, take-off, and when."""

import math
from itertools import pairwise

from vwnav.rules.flight_log import FlightLog, LoggedCommand
from vwnav.rules.moments import flying, handed_back, taken
from vwnav.rules.rule import NAVIGATOR, PILOT_S, WATCHDOG, Rule
from vwnav.rules.temporal import Breach, after, always, never_while
from vwnav.vehicle import FlightMode

TAKEOFF, LAND, SET_MODE, ARM = 22, 21, 176, 400
_OF_CONTROL = frozenset({16, 17, 20, LAND, TAKEOFF, 92, SET_MODE, 192, 300, ARM})
_BORROWED = "MIS_TAKEOFF_ALT"  # of its owner, put back once the take-off is over
_FORCED = 21196.0  # MAV_CMD_COMPONENT_ARM_DISARM, parameter 2
# PX4's main and sub modes, or ArduCopter's number and nothing, as parameters 2 and 3.
_OFFBOARD = frozenset({(6, 0), (4, 0)})
_LANDINGS = frozenset({(4, 6), (9, 0)})
_OUR_MODES = _OFFBOARD | _LANDINGS | {(4, 3), (17, 0), (4, 5)}  # (6, 0) is ArduCopter's RTL too
_TAKES_BACK_S = 5.0  # from the word to the last command
_BEFORE_S = 0.03
_REPEATED_S = 1.5  # a command that is not answered is repeated within this
_MOST_IN_A_SECOND = 4  # of one command, lost ones repeated included


def _of_control(log: FlightLog) -> list[LoggedCommand]:
    return [each for each in log.commands if each.number in _OF_CONTROL]


def _numbered(log: FlightLog, number: int, first: float | None = None) -> list[LoggedCommand]:
    """Commands of a number, with a first parameter."""
    return [
        each
        for each in log.commands
        if each.number == number and first in (None, *each.parameters[:1])
    ]


def _mode_of(command: LoggedCommand) -> tuple[int, int]:
    main, sub = (int(value) if math.isfinite(value) else 0 for value in command.parameters[1:3])
    return main, sub


def _arms_in_flight(log: FlightLog) -> Breach | None:
    """A command whose answer is still on its way is sent again: the first of a row counts."""
    asked = _numbered(log, ARM, 1.0)
    anew = [b for a, b in pairwise(asked) if b.t_s - a.t_s > _REPEATED_S]
    first = asked[:1] + anew
    return always(first, lambda command: not _flies_or_runs(log, command), _asked)


def _flies_or_runs(log: FlightLog, command: LoggedCommand) -> bool:
    """As it was before the command."""
    vehicle = log.vehicle_at(command.t_s - _BEFORE_S)
    return vehicle is not None and (vehicle.armed or vehicle.in_air)


def _is_in_air(log: FlightLog, command: LoggedCommand) -> bool:
    vehicle = log.vehicle_at(command.t_s)
    return vehicle is not None and vehicle.in_air


def _asked(command: LoggedCommand) -> str:
    return f"command {command.number} {command.parameters} of component {command.component}"


def _arms_too_soon(log: FlightLog) -> Breach | None:
    wait_s = log.bounds.flight.ready_steady_s
    refused = [each for each in log.answers if each.number == ARM and not each.accepted]
    spans = [(answer.t_s, answer.t_s + wait_s) for answer in refused]
    return never_while(spans, _numbered(log, ARM, 1.0), _asked)


def _arms_too_often(log: FlightLog) -> Breach | None:
    refused = [each for each in log.answers if each.number == ARM and not each.accepted]
    tries = log.bounds.flight.arming_tries
    if len(refused) < tries:
        return None
    return never_while([(refused[tries - 1].t_s, math.inf)], _numbered(log, ARM, 1.0), _asked)


def _arms_again(log: FlightLog) -> Breach | None:
    ran = [row.t_s for row in log.vehicle if row.armed]
    stopped = [row.t_s for row in log.vehicle if ran and not row.armed and row.t_s > ran[0]]
    spans = [(stopped[0], math.inf)] if stopped else []
    return never_while(spans, _numbered(log, ARM, 1.0), _asked)


def _offboard_asked(log: FlightLog) -> list[LoggedCommand]:
    return [each for each in _numbered(log, SET_MODE) if _mode_of(each) in _OFFBOARD]


def _offboard_from_elsewhere(log: FlightLog) -> Breach | None:
    good = (FlightMode.TAKEOFF, FlightMode.HOLD, FlightMode.OFFBOARD)

    words = handed_back(log)

    def from_ours(command: LoggedCommand) -> bool:
        vehicle = log.vehicle_at(command.t_s)
        told = any(0.0 <= command.t_s - t_s <= _TAKES_BACK_S for t_s in words)
        return told or vehicle is None or not vehicle.armed or vehicle.mode in good

    return always(_offboard_asked(log), from_ours, _asked)


def _offboard_after_land(log: FlightLog) -> Breach | None:
    modes = [each for each in _numbered(log, SET_MODE) if _mode_of(each) in _LANDINGS]
    words = handed_back(log)
    spans = [
        (each.t_s, next((word_s for word_s in words if word_s > each.t_s), math.inf))
        for each in (*_numbered(log, LAND), *modes)
    ]
    return never_while(spans, _offboard_asked(log), _asked)


def _too_many(log: FlightLog) -> Breach | None:
    commands = _of_control(log)
    for i, last in enumerate(commands[_MOST_IN_A_SECOND:], _MOST_IN_A_SECOND):
        lately = [c for c in commands[:i] if last.t_s - c.t_s < 1.0 and c.number == last.number]
        if len(lately) >= _MOST_IN_A_SECOND:
            return Breach(last.t_s, f"{_asked(last)} for the {len(lately) + 1}th time in a second")
    return None


def _low_battery(log: FlightLog) -> Breach | None:
    least = log.bounds.safety.battery_takeoff_ratio

    def enough(command: LoggedCommand) -> bool:
        vehicle = log.vehicle_at(command.t_s)
        return vehicle is None or not vehicle.has_less_than(least)

    return always(_numbered(log, ARM, 1.0), enough, _asked)


COMMANDS = (
    Rule(
        "command after the pilot",
        "Once a person has the aircraft nothing is commanded until it is handed back.",
        ("vehicle", "commands"),
        lambda log: never_while(
            after(PILOT_S + log.round_trip_s, taken(log)), _of_control(log), _asked
        ),
    ),
    Rule(
        "own commands",
        "Commands come from the navigator's and the watchdog's own components.",
        ("commands",),
        lambda log: always(log.commands, lambda c: c.component in (NAVIGATOR, WATCHDOG), _asked),
    ),
    Rule(
        "arming on the ground",
        "Arming is asked for only of a disarmed aircraft on the ground.",
        ("vehicle", "commands"),
        _arms_in_flight,
    ),
    Rule(
        "arming after a refusal",
        "A refused arming is asked for again only when all has been ready anew.",
        ("commands", "answers"),
        _arms_too_soon,
    ),
    Rule(
        "arming tries",
        "After three refusals arming is not asked for any more.",
        ("commands", "answers"),
        _arms_too_often,
    ),
    Rule(
        "arming again",
        "An aircraft whose motors have run and stopped is not armed again.",
        ("vehicle", "commands"),
        _arms_again,
    ),
    Rule(
        "arming with a battery",
        "Nobody arms with less charge than a take-off needs.",
        ("vehicle", "commands"),
        _low_battery,
    ),
    Rule(
        "arming forced",
        "Arming and disarming are never forced.",
        ("commands",),
        lambda log: always(_numbered(log, ARM), lambda c: _FORCED not in c.parameters[1:2], _asked),
    ),
    Rule(
        "disarming in the air",
        "Disarming is never asked for in the air.",
        ("vehicle", "commands"),
        lambda log: always(_numbered(log, ARM, 0.0), lambda c: not _is_in_air(log, c), _asked),
    ),
    Rule(
        "take-off on the ground",
        "Take-off is asked for only on the ground.",
        ("vehicle", "commands"),
        lambda log: always(_numbered(log, TAKEOFF), lambda c: not _is_in_air(log, c), _asked),
    ),
    Rule(
        "modes asked for",
        "No modes are asked for but Offboard, Hold, Return and Land.",
        ("commands",),
        lambda log: always(_numbered(log, SET_MODE), lambda c: _mode_of(c) in _OUR_MODES, _asked),
    ),
    Rule(
        "Offboard from our modes",
        "Offboard is asked for only before arming, out of take-off or Hold, never out of another's "
        "mode unless it is handed back.",
        ("vehicle", "commands"),
        _offboard_from_elsewhere,
    ),
    Rule(
        "Offboard after Land",
        "Once Land has been asked for Offboard never is, unless a pilot hands it back since.",
        ("commands",),
        _offboard_after_land,
    ),
    Rule(
        "commands repeated",
        "No command is sent more than four times in a second.",
        ("commands",),
        _too_many,
    ),
    Rule(
        "parameters in flight",
        "In the air no parameter is written but the take-off height that was borrowed for it.",
        ("vehicle", "parameters_set"),
        lambda log: never_while(
            flying(log),
            [each for each in log.parameters_set if each.name != _BORROWED],
            lambda each: f"{each.name} is written",
        ),
    ),
)
