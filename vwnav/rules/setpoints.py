"""Rules of setpoints: who may ask for a velocity, when, and which."""

import math

from vwnav.mission.mission import Phase
from vwnav.rules.flight_log import FlightLog, LoggedSetpoint
from vwnav.rules.moments import in_phases, taken
from vwnav.rules.rule import NAVIGATOR, PILOT_S, WATCHDOG, Rule
from vwnav.rules.temporal import (
    Breach,
    Span,
    after,
    always,
    never_while,
    spans_where,
    steady,
    without,
)
from vwnav.vehicle import FlightMode

_SHOWS_S = 1.0  # from a change of state to the heartbeat that tells it
_STILL_M_S = 0.01
_SLACK_M_S = 0.05
_LONGEST_PAUSE_S = 0.5  # PX4 leaves Offboard after 1.0 s
_RECOVERY_S = 2.0  # after something was broken


def _level_m_s(setpoint: LoggedSetpoint) -> float:
    return math.hypot(*setpoint.velocity_ned_m_s[:2])


def _is_still(setpoint: LoggedSetpoint) -> bool:
    return all(abs(v) < _STILL_M_S for v in setpoint.velocity_ned_m_s)


def _navigators(log: FlightLog) -> list[LoggedSetpoint]:
    return [each for each in log.setpoints if each.component in (None, NAVIGATOR)]


def _flown(setpoint: LoggedSetpoint) -> str:
    speeds = ", ".join(f"{v:.2f}" for v in setpoint.velocity_ned_m_s)
    return f"setpoint ({speeds}) m/s of component {setpoint.component or '?'}"


def _too_steep(log: FlightLog) -> Breach | None:
    up = log.bounds.climb_m_s + _SLACK_M_S
    down = log.bounds.descend_m_s + _SLACK_M_S
    return always(log.setpoints, lambda s: -up <= s.velocity_ned_m_s[2] <= down, _flown)


def _disarmed(log: FlightLog) -> list[Span]:
    """Where the link tells that it is."""
    disarmed = after(_SHOWS_S, spans_where(log.vehicle, lambda row: not row.armed))
    return without(disarmed, log.broken, _RECOVERY_S)


def _pauses(log: FlightLog) -> Breach | None:
    offboard = spans_where(log.vehicle, lambda row: row.armed and row.mode is FlightMode.OFFBOARD)
    # ArduCopter takes off in GUIDED, and a setpoint would end that.
    spans = without(without(offboard, in_phases(log, Phase.TAKEOFF)), log.broken, _RECOVERY_S)
    return steady(log.setpoints, _LONGEST_PAUSE_S, spans, "no setpoint in Offboard")


SETPOINTS = (
    Rule(
        "setpoint after the pilot",
        "Once a person has the aircraft no setpoint is sent until it is handed back.",
        ("vehicle", "setpoints"),
        lambda log: never_while(
            after(PILOT_S + log.round_trip_s, taken(log)), log.setpoints, _flown
        ),
    ),
    Rule(
        "setpoint out of control",
        "Getting ready, released or done, the navigator sends no setpoint.",
        ("phases", "setpoints"),
        lambda log: never_while(
            after(PILOT_S, in_phases(log, Phase.GET_READY, Phase.RELEASED, Phase.DONE)),
            _navigators(log),
            _flown,
        ),
    ),
    Rule(
        "setpoint while landing",
        "Landing, or in a failsafe, the navigator sends no setpoint but zero velocity.",
        ("phases", "setpoints"),
        lambda log: never_while(
            after(PILOT_S, in_phases(log, Phase.LAND, Phase.FAILSAFE)),
            [each for each in _navigators(log) if not _is_still(each)],
            _flown,
        ),
    ),
    Rule(
        "setpoint disarmed",
        "No setpoint is sent to an aircraft that is disarmed.",
        ("vehicle", "setpoints"),
        lambda log: never_while(_disarmed(log), log.setpoints, _flown),
    ),
    Rule(
        "setpoint finite",
        "Every setpoint is finite.",
        ("setpoints",),
        lambda log: always(
            log.setpoints, lambda s: all(map(math.isfinite, s.velocity_ned_m_s)), _flown
        ),
    ),
    Rule(
        "setpoint speed",
        "No setpoint is faster than the route's limit.",
        ("setpoints",),
        lambda log: always(
            log.setpoints,
            lambda s: _level_m_s(s) <= log.bounds.speed_max_m_s + _SLACK_M_S,
            _flown,
        ),
    ),
    Rule(
        "setpoint climb",
        "No setpoint climbs or sinks faster than the limits.",
        ("setpoints",),
        _too_steep,
    ),
    Rule(
        "setpoint pause",
        "In Offboard, once taken off, setpoints never pause for over 0.5 s.",
        ("vehicle", "setpoints"),
        _pauses,
        whole=True,
    ),
    Rule(
        "watchdog still",
        "The watchdog's setpoints are zero velocity.",
        ("setpoints", "commands"),  # senders are noted where commands are
        lambda log: always(
            log.setpoints, lambda s: s.component != WATCHDOG or _is_still(s), _flown
        ),
    ),
    Rule(
        "own setpoints",
        "Setpoints come from the navigator's and the watchdog's own components.",
        ("setpoints", "commands"),
        lambda log: always(log.setpoints, lambda s: s.component in (NAVIGATOR, WATCHDOG), _flown),
    ),
)
