"""Rules of the mission: its phases, and what must follow within how long."""

import math
from itertools import pairwise

from vwnav.mission.mission import Phase
from vwnav.rules.flight_log import (
    MISSION_HANGS,
    NAVIGATOR_ENDED,
    At,
    FlightLog,
    LoggedCommand,
    LoggedSetpoint,
    Moment,
    PhaseStart,
    Said,
)
from vwnav.rules.moments import NOT_OURS, in_modes, phase_begins, steered, touch_down_s
from vwnav.rules.rule import Rule
from vwnav.rules.temporal import (
    Breach,
    after,
    always,
    always_pairs,
    inside,
    never_while,
    spans_where,
    within,
    without,
)
from vwnav.vehicle import FlightMode

_OUT = {Phase.LAND, Phase.RELEASED, Phase.FAILSAFE}
_ENDS = {*_OUT, Phase.DONE}  # disarmed in flight; that it is, the rule below sees to
_NEXT: dict[Phase, set[Phase]] = {
    Phase.GET_READY: {Phase.TAKEOFF, Phase.RELEASED, Phase.LAND, Phase.DONE},
    Phase.TAKEOFF: {Phase.CLIMB, *_ENDS},
    Phase.CLIMB: {Phase.FIRST_FIX, Phase.RETURN, *_ENDS},
    Phase.FIRST_FIX: {Phase.ROUTE, Phase.RETURN, *_ENDS},
    Phase.ROUTE: {Phase.DESCEND, Phase.RETURN, *_ENDS},
    Phase.RETURN: {Phase.DESCEND, *_ENDS},
    Phase.DESCEND: _ENDS,
    Phase.LAND: {Phase.RELEASED, Phase.DONE},
    Phase.FAILSAFE: set(Phase) - {Phase.GET_READY},  # back to where it was: `_order`
    Phase.RELEASED: {Phase.DONE, Phase.RESUME},
    Phase.RESUME: {Phase.ROUTE, Phase.RETURN, *_ENDS},
    Phase.DONE: set(),
}
_TRAVELS = (Phase.ROUTE, Phase.RETURN)
_HOMEWARD = (Phase.RETURN, Phase.DESCEND)
_DOWN_MODES = frozenset({FlightMode.LAND, FlightMode.DESCEND, FlightMode.RETURN})
_DISARM = 400
_LAND, _SET_MODE = 21, 176
_CONTROLS = (_LAND, 22, _SET_MODE)
_REACTS_S = 1.5  # from a limit to what follows in the autopilot's mode
_MODE_S = 3.0  # from a landing to its mode, asked for again each second
_LANDS_S = 150.0
_DOWN_S = 1.0  # from touch-down until the autopilot tells it
_SOFT_M_S = 2.5
_TOUCHES_S = 0.3
_MOVES_M_S = 0.5
_HOME_M = 0.01
_RECOVERY_S = 3.0
_FAILURES = ("the mission broke", "a step of the link failed", "a picture could not be used")


def _order(log: FlightLog) -> Breach | None:
    before_failsafe: Phase | None = None
    rows = log.phases
    for a, b in pairwise(rows):
        allowed = _NEXT[a.phase]
        if b.phase is Phase.FAILSAFE:
            before_failsafe = a.phase
        if a.phase is Phase.FAILSAFE and before_failsafe is not None:
            allowed = {before_failsafe, Phase.LAND, Phase.RELEASED, Phase.DONE}
        if b.phase not in allowed:
            return Breach(b.t_s, f"{b.phase.value} after {a.phase.value}")
    return None


def _entered(log: FlightLog, *phases: Phase) -> list[PhaseStart]:
    """Changes to a phase; the first one known is no change."""
    return [row for row in log.phases[1:] if row.phase in phases]


def _route_without_fixes(log: FlightLog) -> Breach | None:
    wanted = log.bounds.flight.fixes_to_start
    times = [fix.t_s for fix in log.fixes]
    for stage in _entered(log, Phase.ROUTE):
        if sum(t_s <= stage.t_s for t_s in times) < wanted:
            return Breach(stage.t_s, f"on route before {wanted} fixes")
        return None
    return None


def _over_in_the_air(log: FlightLog) -> Breach | None:
    def stands(stage: PhaseStart) -> bool:
        vehicle = log.vehicle_at(stage.t_s)
        return vehicle is None or not vehicle.armed or not vehicle.in_air

    return always(_entered(log, Phase.DONE), stands, lambda _: "over, armed and in the air")


def _low_for(log: FlightLog, ratio: float) -> list[float]:
    """When the battery had been below, in Offboard, for as long as makes it count."""
    spans = spans_where(
        log.vehicle,
        lambda row: (
            row.armed
            and row.in_air
            and row.mode is FlightMode.OFFBOARD
            and row.has_less_than(ratio)
        ),
    )
    return [lo for lo, _ in after(log.bounds.safety.battery_time_s, spans)]


def _battery_critical(log: FlightLog) -> Breach | None:
    answers = [*phase_begins(log, *_OUT), *in_modes(log, NOT_OURS)]
    triggers = _low_for(log, log.bounds.safety.battery_critical_ratio)
    return within(_REACTS_S, triggers, answers, log.end_s, "a landing")


def _battery_low(log: FlightLog) -> Breach | None:
    homeward = [row for row in log.vehicle if log.phase_at(row.t_s) in _HOMEWARD]
    answers = [row.t_s for row in homeward]
    answers += [*phase_begins(log, *_OUT), *in_modes(log, NOT_OURS)]
    triggers = _low_for(log, log.bounds.safety.battery_low_ratio)
    return within(_REACTS_S, triggers, answers, log.end_s, "the way home")


def _lost(log: FlightLog) -> Breach | None:
    """A pause of the estimates that lasts long enough, while we steer, ends in another mode."""
    times = [each.t_s for each in log.estimates]
    pauses = without(pairwise([*times, log.end_s]), log.broken)  # what a cut link holds up
    ours = steered(log)
    triggers = [lo for lo, _ in after(log.bounds.safety.lost_land_s, pauses) if inside(lo, ours)]
    answers = in_modes(log, NOT_OURS)
    return within(_REACTS_S, triggers, answers, log.end_s, "without estimates, another mode")


def _uncertain(log: FlightLog) -> Breach | None:
    """Where the position is too uncertain to fly the route, nobody flies it."""
    limit_m, first = log.bounds.safety.hold_sigma_m, _first_fix_s(log)
    spans = spans_where(
        [each for each in log.estimates if each.t_s > first],
        lambda each: not each.sigma_m <= limit_m,
    )
    moving = [
        each
        for each in log.setpoints
        if math.hypot(*each.velocity_ned_m_s[:2]) > _MOVES_M_S
        and log.phase_at(each.t_s) is Phase.ROUTE
    ]
    return never_while(after(1.0, spans), moving, _velocity)


def _velocity(setpoint: LoggedSetpoint) -> str:
    return f"on route at {math.hypot(*setpoint.velocity_ned_m_s[:2]):.1f} m/s"


def _first_fix_s(log: FlightLog) -> float:
    return next((fix.t_s for fix in log.fixes), math.inf)


def _blind(log: FlightLog) -> Breach | None:
    """Travelling, without an image that tells anything for too long: it lands.

    A mission whose navigator has ended, or that hangs, travels no more: that one is the watchdog's.
    """
    ends = (NAVIGATOR_ENDED, MISSION_HANGS)
    ended_s = min((e.t_s for e in log.events if e.text in ends), default=math.inf)
    limit_s = log.bounds.safety.blind_land_s
    times = [each.t_s for each in log.sights]
    pauses = list(pairwise([*times, log.end_s]))
    ours = steered(log)
    triggers = [
        lo
        for lo, _ in after(limit_s, pauses)
        if log.phase_at(lo) in _TRAVELS and inside(lo, ours) and lo < ended_s
    ]
    answers = [*phase_begins(log, *_OUT), *in_modes(log, NOT_OURS)]
    return within(_REACTS_S, triggers, answers, log.end_s, "blind, a landing")


def _landing_mode(log: FlightLog) -> Breach | None:
    answered = _DOWN_MODES | {FlightMode.MANUAL}
    spans = [(stage.t_s, stage.t_s + _MODE_S) for stage in _entered(log, Phase.LAND)]
    whole = [lo for lo, hi in spans if without([(lo, hi)], log.broken, _RECOVERY_S) == [(lo, hi)]]
    answers = [*in_modes(log, answered), *phase_begins(log, Phase.RELEASED, Phase.DONE)]
    refused = [each for each in log.answers if not each.accepted]
    answers += [each.t_s for each in refused if each.number in (_LAND, _SET_MODE)]
    return within(_MODE_S, whole, answers, log.end_s, "the mode of a landing")


def _landing_ends(log: FlightLog) -> Breach | None:
    answers = [row.t_s for row in log.vehicle if not row.in_air]
    answers += phase_begins(log, Phase.RELEASED)
    landings = [stage.t_s for stage in _entered(log, Phase.LAND)]
    return within(_LANDS_S, landings, answers, log.end_s, "the ground")


def _asks_after_touch_down(log: FlightLog) -> Breach | None:
    rows: list[LoggedSetpoint | LoggedCommand] = [*log.setpoints, *log.commands]
    asked = sorted(
        (row for row in rows if not isinstance(row, LoggedCommand) or row.number != _DISARM),
        key=lambda row: row.t_s,
    )
    spans = without([(touch_down_s(log) + _DOWN_S, math.inf)], log.broken, _RECOVERY_S)
    controls = [r for r in asked if isinstance(r, LoggedSetpoint) or r.number in _CONTROLS]
    return never_while(spans, controls, lambda row: f"asked for: {row}")


def _hard_touch_down(log: FlightLog) -> Breach | None:
    """Of motors that run: who has stopped them in the air, a person, has it fall."""
    down_s = touch_down_s(log)
    if any(row.t_s == down_s and not row.armed for row in log.vehicle):
        return None
    last = [row for row in log.truth if down_s - _TOUCHES_S <= row.t_s <= down_s]
    return always(
        last,
        lambda row: row.velocity_ned_m_s[2] <= _SOFT_M_S,
        lambda row: f"touches down at {row.velocity_ned_m_s[2]:.1f} m/s",
    )


def _home_moves(log: FlightLog) -> Breach | None:
    def stays(a: At, b: At) -> bool:
        return math.dist(a.ne, b.ne) <= _HOME_M

    return always_pairs(
        log.homes, stays, lambda a, b: f"home moves by {math.dist(a.ne, b.ne):.1f} m"
    )


def _fails(event: Said) -> bool:
    return event.text.startswith(_FAILURES)


def _step_failed(log: FlightLog) -> Breach | None:
    """Of itself: not while something was broken."""
    unbroken = [e for e in log.events if not inside(e.t_s, log.broken)]
    return always(unbroken, lambda e: not _fails(e), lambda e: e.text)


def _unexplained(log: FlightLog) -> Breach | None:
    """A landing that the route has not come to is preceded by its reason."""
    phases = log.phases
    names = {phase.value for phase in Phase}
    reasons = [Moment(each.t_s) for each in log.events if each.text not in names]
    for a, b in pairwise(phases):
        early = b.phase is Phase.LAND and a.phase is not Phase.DESCEND
        if early and not any(b.t_s - 1.0 <= r.t_s <= b.t_s + 0.1 for r in reasons):
            return Breach(b.t_s, "lands, and does not say why")
    return None


MISSION = (
    Rule("order of phases", "Phases follow each other as they may.", ("phases",), _order),
    Rule(
        "route after fixes",
        "The route begins only after three fixes.",
        ("phases", "fixes"),
        _route_without_fixes,
    ),
    Rule(
        "over on the ground",
        "The mission ends only with motors off, or on the ground.",
        ("phases", "vehicle"),
        _over_in_the_air,
    ),
    Rule(
        "battery critical",
        "Below the critical charge a landing follows within 1.5 s.",
        ("vehicle", "phases"),
        _battery_critical,
    ),
    Rule(
        "battery low",
        "Below the low charge the way home, or down, follows within 1.5 s.",
        ("vehicle", "phases"),
        _battery_low,
    ),
    Rule(
        "lost lands",
        "Without estimates for 2 s Hold or Land is flown within 1.5 s.",
        ("vehicle", "estimates"),
        _lost,
    ),
    Rule(
        "uncertain stops",
        "A position too uncertain for the route stops it within 1 s.",
        ("estimates", "setpoints", "phases", "fixes"),
        _uncertain,
    ),
    Rule(
        "blind lands",
        "Travelling without a picture that tells anything for 6 s, it lands within 1.5 s.",
        ("vehicle", "events", "phases", "sights"),
        _blind,
    ),
    Rule(
        "landing is flown",
        "A landing that is wanted is the mode within 3 s, or refused.",
        ("vehicle", "phases"),
        _landing_mode,
    ),
    Rule(
        "landing ends",
        "A landing ends on the ground within 150 s.",
        ("vehicle", "phases"),
        _landing_ends,
    ),
    Rule(
        "nothing after touch-down",
        "After touch-down nothing is asked for but disarming.",
        ("vehicle", "setpoints", "commands"),
        _asks_after_touch_down,
    ),
    Rule(
        "soft touch-down",
        "It touches down at 2.5 m/s at most, where nobody stopped its motors before.",
        ("vehicle", "truth"),
        _hard_touch_down,
    ),
    Rule("home stays", "Home never moves once it is known.", ("homes",), _home_moves),
    Rule(
        "reason of a landing",
        "A landing before the end of the route says why.",
        ("phases", "events"),
        _unexplained,
    ),
    Rule(
        "nothing fails",
        "No step of the program fails of itself.",
        ("events",),
        _step_failed,
    ),
)
