"""What holds for every flight with something broken in it, and what a scenario asks besides."""

import math

import numpy as np

from vwnav.bench.flights.blame import blamed_wrongly
from vwnav.bench.flights.log import flight_log
from vwnav.bench.flights.scenario import Ending, FlightVerdict, Flown
from vwnav.bench.flights.track import FlightTrace, Truth
from vwnav.mission.mission import Phase
from vwnav.rules.belief import estimate_sigmas
from vwnav.rules.flight_log import FlightLog
from vwnav.rules.rule import PILOT_S, check
from vwnav.rules.table import RULES
from vwnav.vehicle import FlightMode

_GOES_ON = {
    Phase.TAKEOFF: (Phase.CLIMB, Phase.FIRST_FIX, Phase.ROUTE),
    Phase.CLIMB: (Phase.CLIMB, Phase.FIRST_FIX, Phase.ROUTE),
    Phase.ROUTE: (Phase.ROUTE,),
    Phase.RETURN: (Phase.RETURN, Phase.DESCEND, Phase.LAND),
    Phase.DESCEND: (Phase.DESCEND, Phase.LAND),
}
# In these it stays up, whoever is there; and by which words the harness notes that a person chose.
_STAYS_UP = frozenset({FlightMode.HOLD, FlightMode.MANUAL, FlightMode.OTHER})
_ACTS = ("pilot switches", "pilot pushes", "a second station asks")
_ALONE_S = 30.0


def judge(flown: Flown) -> FlightVerdict:
    """Look at a flight by what it asks for itself, and by the rules of every flight."""
    track = flown.track
    log = flight_log(flown)
    fastest_m_s = _fastest(track, flown)
    off_m = _landed_off_m(flown)
    wrong = [
        *_ending(flown, off_m),
        *_followed(flown),
        *_broken_rules(flown, log),
        *_too_fast(flown, fastest_m_s),
        *blamed_wrongly(flown.scenario, [each.text for each in track.events]),
    ]
    worst_sigmas = max((count for _, count in estimate_sigmas(log)), default=0.0)
    return FlightVerdict(tuple(wrong), off_m, fastest_m_s, worst_sigmas)


def _ending(flown: Flown, off_m: float | None) -> list[str]:
    scenario, last = flown.scenario, flown.track.truth[-1]
    flew = flown.track.flew
    bound_m = scenario.lands_within_m
    match scenario.ending:
        case Ending.LANDED if last.armed or not last.on_ground:
            return [f"it is not down after {flown.flown_s:.0f} s: {_where(last)}"]
        case Ending.LANDED if not flew:
            return ["it never flew"]
        case Ending.LANDED if bound_m is not None and off_m is not None and off_m > bound_m:
            return [f"it landed {off_m:.1f} m off, {bound_m:g} m are allowed"]
        case Ending.FLIES_ON if not _flies_on(flown):
            return [f"it does not fly on: {_where(last)}, {_said(flown)}"]
        case Ending.PILOT if last.mode is not FlightMode.MANUAL:
            return [f"the pilot does not have it: {_where(last)}"]
        case Ending.OTHERS if not _others_have_it(flown):
            return [f"nobody else has it: {_where(last)}, {_said(flown)}"]
        case Ending.STAYED if flew:
            return [f"it took off: {_where(last)}"]
        case Ending.ANYHOW:
            return _left_alone(flown)
    return []


def _left_alone(flown: Flown) -> list[str]:
    """Whether it hung in the air until its battery would be empty, chosen so by no person."""
    # Where a radio is heard, a mode of the sticks is the pilot's.
    stays_up = _STAYS_UP - ({FlightMode.MANUAL} if flown.scenario.setup.rc_on else set())
    acts = (each.t_s for each in flown.track.events if each.text.startswith(_ACTS))
    until_s = min(acts, default=math.inf) + flown.begun_s
    since_s: float | None = None
    for each in flown.track.truth:
        hangs = each.armed and not each.on_ground and each.mode in stays_up
        if not hangs or each.t_s > until_s:
            since_s = None
        elif since_s is None:
            since_s = each.t_s
        elif each.t_s - since_s > _ALONE_S:
            return [f"nobody flies it since {since_s - flown.begun_s:.1f} s: {_where(each)}"]
    return []


def _flies_on(flown: Flown) -> bool:
    """The mission stands where it began, or where it goes from there, and nobody gave it up."""
    if flown.end is not None:
        return flown.end.reason is None
    start = flown.scenario.setup.start
    begun = Phase.TAKEOFF if start is None or start.phase is None else start.phase
    return flown.phase in _GOES_ON[begun]


def _others_have_it(flown: Flown) -> bool:
    """It is not ours any more, and no setpoint was sent since the mission saw that."""
    released = [each for each in flown.track.phases if each.text == Phase.RELEASED.value]
    if not released or flown.track.truth[-1].mode is FlightMode.OFFBOARD:
        return False
    since_s = released[0].t_s + flown.begun_s + PILOT_S
    return not any(each.t_s > since_s for each in flown.track.heard.setpoints)


def _followed(flown: Flown) -> list[str]:
    broke_s = flown.broke_s
    is_whatever = flown.scenario.ending is Ending.ANYHOW
    if flown.scenario.breaks and broke_s is None and not is_whatever:
        return ["nothing broke: the flight never got there"]
    wrong = []
    for each in flown.scenario.follows:
        since_s = broke_s or 0.0
        times = [t for t in each.when(flown.track, flown.begun_s) if t >= since_s - 1e-6]
        if not times:
            wrong.append(f"never seen: {each.what}")
        elif times[0] - since_s > each.within_s:
            late_s = times[0] - since_s
            wrong.append(f"{each.what} after {late_s:.1f} s, {each.within_s:g} s are allowed")
    return wrong


def _broken_rules(flown: Flown, log: FlightLog) -> list[str]:
    return [
        f"{verdict.rule.name}, at {verdict.breach.t_s - flown.begun_s:.2f} s: {verdict.breach.what}"
        for verdict in check(RULES, log)
        if verdict.breach is not None
    ]


def _pilot_flies(truth: Truth) -> bool:
    """In a mode of the sticks; disarmed it means nothing, ArduCopter boots in one."""
    return truth.armed and truth.mode is FlightMode.MANUAL


def _fastest(track: FlightTrace, flown: Flown) -> float:
    """Over the ground, from the fault on and while nobody else steers."""
    since_s = (flown.broke_s or 0.0) + flown.begun_s
    speeds = [
        math.hypot(*each.velocity_ned_m_s[:2].tolist())
        for each in track.truth
        if each.t_s >= since_s and not _pilot_flies(each)
    ]
    return max(speeds, default=0.0)


def _too_fast(flown: Flown, fastest_m_s: float) -> list[str]:
    setup = flown.scenario.setup
    limit_m_s = setup.config.limits.speed_max_m_s + setup.wind_m_s + flown.scenario.faster_m_s
    if fastest_m_s <= limit_m_s:
        return []
    return [f"{fastest_m_s:.1f} m/s over the ground, {limit_m_s:.1f} are allowed"]


def _landed_off_m(flown: Flown) -> float | None:
    last = flown.track.truth[-1]
    if not last.on_ground:
        return None
    place = flown.scenario.lands_at_ne_m
    if place is None:
        if flown.broke_s is None:
            return None
        there = flown.track.truth_at(flown.broke_s + flown.begun_s).position_ned_m[:2]
    else:
        there = np.array(place)
    return float(np.hypot(*(last.position_ned_m[:2] - there)))


def _where(truth: Truth) -> str:
    north, east, down = truth.position_ned_m
    return f"{truth.mode.name.lower()} at ({north:.0f}, {east:.0f}), {-down:.0f} m high"


def _said(flown: Flown) -> str:
    return flown.phase.value
