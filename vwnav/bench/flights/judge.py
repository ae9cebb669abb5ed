"""What holds for every flight with something broken in it, and what a scenario asks besides."""

import math
from dataclasses import dataclass

import numpy as np

from vwnav.bench.flights.scenario import Ending, Flown
from vwnav.bench.flights.track import Track, Truth
from vwnav.mission import Phase
from vwnav.sim.px4.modes import STICK_STATES, NavState

_PILOT_S = 0.3  # from the pilot's mode to the last setpoint
_NEVER_SIGMAS, _SELDOM_SIGMAS, _SELDOM_S = 5.0, 3.0, 1.0
_FASTEST_ESTIMATE_M_S = 35.0
_HARD_M_S = 2.5
_GOES_ON = {
    Phase.TAKEOFF: (Phase.CLIMB, Phase.FIRST_FIX, Phase.ROUTE),
    Phase.CLIMB: (Phase.CLIMB, Phase.FIRST_FIX, Phase.ROUTE),
    Phase.ROUTE: (Phase.ROUTE,),
    Phase.RETURN: (Phase.RETURN, Phase.DESCEND, Phase.LAND),
    Phase.DESCEND: (Phase.DESCEND, Phase.LAND),
}
_COMMANDS_OF_CONTROL = frozenset({16, 17, 20, 21, 22, 92, 176, 192, 300, 400})


@dataclass(frozen=True, slots=True)
class Verdict:
    """What was wrong with a flight; nothing when it was good."""

    wrong: tuple[str, ...]
    landed_off_m: float | None
    fastest_m_s: float
    worst_sigmas: float


def judge(flown: Flown) -> Verdict:
    """Look at a flight by all rules."""
    track = flown.track
    sigmas = track.sigmas(flown.scenario.map_off_m)
    fastest_m_s = _fastest(track, flown)
    off_m = _landed_off_m(flown)
    wrong = [
        *_ending(flown, off_m),
        *_followed(flown),
        *_pilot_has_it(flown),
        *_sent_wrong(flown, sigmas),
        *_too_fast(flown, fastest_m_s),
    ]
    return Verdict(
        tuple(wrong), off_m, fastest_m_s, float(sigmas[:, 1].max()) if len(sigmas) else 0.0
    )


def _ending(flown: Flown, off_m: float | None) -> list[str]:
    scenario, last = flown.scenario, flown.track.truth[-1]
    flew = any(each.armed and not each.on_ground for each in flown.track.truth)
    bound_m = scenario.lands_within_m
    match scenario.ending:
        case Ending.LANDED if last.armed or not last.on_ground:
            return [f"it is not down after {flown.world.t_s:.0f} s: {_where(last)}"]
        case Ending.LANDED if not flew:
            return ["it never flew"]
        case Ending.LANDED if bound_m is not None and off_m is not None and off_m > bound_m:
            return [f"it landed {off_m:.1f} m off, {bound_m:.0f} m are allowed"]
        case Ending.FLIES_ON if not _flies_on(flown):
            return [f"it does not fly on: {_where(last)}, {_said(flown)}"]
        case Ending.PILOT if last.mode not in STICK_STATES:
            return [f"the pilot does not have it: {_where(last)}"]
        case Ending.OTHERS if not _others_have_it(flown):
            return [f"nobody else has it: {_where(last)}, {_said(flown)}"]
        case Ending.STAYED if flew:
            return [f"it took off: {_where(last)}"]
    return []


def _flies_on(flown: Flown) -> bool:
    """The mission stands where it began, or where it goes from there, and nobody gave it up."""
    if flown.end is not None:
        return flown.end.reason is None
    start = flown.scenario.setup.start
    begun = Phase.TAKEOFF if start is None or start.phase is None else start.phase
    return flown.world.navigator.flight.phase in _GOES_ON[begun]


def _others_have_it(flown: Flown) -> bool:
    """It is not ours any more, and no setpoint was sent since the mission saw that."""
    released = [each for each in flown.track.phases if each.text == Phase.RELEASED.value]
    if not released or flown.track.truth[-1].mode is NavState.OFFBOARD:
        return False
    since_s = released[0].t_s + flown.world.begun_s + _PILOT_S
    return not any(o.kind == "setpoint" and o.t_s > since_s for o in flown.track.orders)


def _followed(flown: Flown) -> list[str]:
    broke_s = flown.broke_s
    if flown.scenario.breaks and broke_s is None:
        return ["nothing broke: the flight never got there"]
    wrong = []
    for each in flown.scenario.follows:
        since_s = broke_s or 0.0
        times = [t for t in each.when(flown.track, flown.world.begun_s) if t >= since_s - 1e-6]
        if not times:
            wrong.append(f"never seen: {each.what}")
        elif times[0] - since_s > each.within_s:
            late_s = times[0] - since_s
            wrong.append(f"{each.what} after {late_s:.1f} s, {each.within_s:g} s are allowed")
    return wrong


def _pilot_has_it(flown: Flown) -> list[str]:
    """No setpoint and no command of control once a person has chosen a mode."""
    taken = [each.t_s for each in flown.track.truth if each.mode in STICK_STATES]
    if not taken:
        return []
    late = [
        order
        for order in flown.track.orders
        if order.t_s > taken[0] + _PILOT_S
        and (order.kind == "setpoint" or order.number in _COMMANDS_OF_CONTROL)
    ]
    if not late:
        return []
    first = late[0]
    return [
        f"{len(late)} orders after the pilot had it, the first {first.t_s - taken[0]:.2f} s later: "
        f"{first.kind} {first.number or ''} of component {first.component}"
    ]


def _sent_wrong(flown: Flown, sigmas: np.ndarray) -> list[str]:
    if not len(sigmas):
        return []
    wrong = []
    worst = int(np.argmax(sigmas[:, 1]))
    if sigmas[worst, 1] > _NEVER_SIGMAS:
        t_s = sigmas[worst, 0] - flown.world.begun_s
        wrong.append(f"an estimate {sigmas[worst, 1]:.1f} sigmas wrong was sent at {t_s:.1f} s")
    since_s = None
    for t_s, count in sigmas:
        if count <= _SELDOM_SIGMAS:
            since_s = None
        elif since_s is None:
            since_s = t_s
        elif t_s - since_s > _SELDOM_S:
            begun_s = since_s - flown.world.begun_s
            wrong.append(f"for over 1 s from {begun_s:.1f} s estimates over 3 sigmas wrong")
            break
    return wrong


def _fastest(track: Track, flown: Flown) -> float:
    """Over the ground, from the fault on and while nobody else steers."""
    since_s = (flown.broke_s or 0.0) + flown.world.begun_s
    speeds = [
        math.hypot(*each.velocity_ned_m_s[:2].tolist())
        for each in track.truth
        if each.t_s >= since_s and each.mode not in STICK_STATES
    ]
    return max(speeds, default=0.0)


def _too_fast(flown: Flown, fastest_m_s: float) -> list[str]:
    setup = flown.scenario.setup
    limit_m_s = setup.config.limits.speed_max_m_s + setup.wind_m_s + flown.scenario.faster_m_s
    wrong = []
    if fastest_m_s > limit_m_s:
        wrong.append(f"{fastest_m_s:.1f} m/s over the ground, {limit_m_s:.1f} are allowed")
    steps = flown.world.navigator.record.steps
    believed = [
        math.hypot(*step.estimate.velocity_ned_m_s[:2].tolist())
        for step in steps
        if step.estimate is not None
    ]
    if max(believed, default=0.0) > _FASTEST_ESTIMATE_M_S:
        wrong.append(f"the filter believed in {max(believed):.0f} m/s")
    return wrong


def _landed_off_m(flown: Flown) -> float | None:
    last = flown.track.truth[-1]
    if not last.on_ground:
        return None
    place = flown.scenario.lands_at_ne_m
    if place is None:
        if flown.broke_s is None:
            return None
        there = flown.track.truth_at(flown.broke_s + flown.world.begun_s).position_ned_m[:2]
    else:
        there = np.array(place)
    return float(np.hypot(*(last.position_ned_m[:2] - there)))


def _where(truth: Truth) -> str:
    north, east, down = truth.position_ned_m
    return f"{truth.mode.name.lower()} at ({north:.0f}, {east:.0f}), {-down:.0f} m high"


def _said(flown: Flown) -> str:
    return flown.world.navigator.flight.phase.value
