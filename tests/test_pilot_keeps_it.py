"""A law: whatever broke before, who has taken over is neither steered nor commanded against."""

import copy
from functools import cache

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from test_flight import Scene, failsafe, gap, hold_asked_for, in_phase, on_route

from vwnav.mission.mission import Phase
from vwnav.vehicle import FlightMode, Order
from vwnav.watchdog.keepalive import GuardState, WatchdogReport

HEARD_S = 0.3  # from the mode; the word on who chose it may come later
FALLS_TO = [
    FlightMode.HOLD, FlightMode.DESCEND, FlightMode.LAND, FlightMode.RETURN, FlightMode.MANUAL,
]  # fmt: skip
HAPPENINGS = {
    "a gap of the link": lambda scene: gap(scene, 2.5),
    "a longer gap": lambda scene: gap(scene, 6.0),
    "no estimate": lambda scene: setattr(scene, "lost", "the estimate is lost"),
    "an estimate again": lambda scene: setattr(scene, "lost", ""),
    "the autopilot agrees": lambda scene: scene.vehicle.be(
        own_position_ned_m=scene.vehicle.position.copy()
    ),
    "it is elsewhere": lambda scene: scene.vehicle.be(
        own_position_ned_m=scene.vehicle.position + 40.0
    ),
    "it refuses": lambda scene: scene.vehicle.refuse.update(
        {name: ["not now"] * 50 for name in ("hold", "land", "offboard")}
    ),
    "it answers late": lambda scene: setattr(scene.vehicle, "answers_after", 15),
    "it answers never": lambda scene: setattr(scene.vehicle, "answers_after", 10_000),
    "back in our mode": lambda scene: scene.vehicle.be(mode=FlightMode.OFFBOARD, failsafe=False),
    "Hold is wanted": lambda scene: scene.vehicle.be(intended_mode=FlightMode.HOLD),
    "blind": lambda scene: setattr(scene, "sees", False),
    "battery low": lambda scene: scene.vehicle.be(battery_ratio=0.2),
    "battery critical": lambda scene: scene.vehicle.be(battery_ratio=0.08),
    "a pilot for a while": lambda scene: scene.vehicle.be(mode=FlightMode.MANUAL, failsafe=False),
    "interrupted": lambda scene: scene.flight.abort("interrupted"),
}
HAPPENINGS |= {
    f"{order.value} is asked for": lambda scene, order=order: scene.flight.obey(order)
    for order in Order
}
HAPPENINGS |= {
    f"the watchdog: {state.name}": lambda scene, state=state: setattr(
        scene.handle, "report", WatchdogReport(state, 1, 0.1)
    )
    for state in (GuardState.RELAY, GuardState.BRAKING)
}
HAPPENINGS |= {
    f"falls to {mode.value}": lambda scene, mode=mode: scene.vehicle.be(
        mode=mode, intended_mode=FlightMode.OFFBOARD, failsafe=True
    )
    for mode in FALLS_TO
}
DAY = st.lists(
    st.tuples(st.sampled_from(sorted(HAPPENINGS)), st.sampled_from([0.1, 0.6, 1.2, 2.4, 5.5])),
    max_size=6,
)  # fmt: skip


PERSONS = [
    FlightMode.MANUAL, FlightMode.RETURN, FlightMode.OTHER, FlightMode.MISSION, FlightMode.HOLD,
    FlightMode.LAND,
]  # fmt: skip
STARTS = {
    **{
        phase.value: lambda phase=phase: Scene().run(in_phase(phase)).go_on(1.0)
        for phase in (Phase.TAKEOFF, Phase.CLIMB, Phase.RETURN, Phase.DESCEND)
    },
    "on route": on_route,
    "a failsafe after a gap": lambda: failsafe(gap(on_route(), 4.0), FlightMode.DESCEND),
    "Hold was asked for": lambda: hold_asked_for(FlightMode.DESCEND),
    "a landing that is refused": lambda: _landing_refused(),
}


@pytest.mark.parametrize("mode", [each for each in PERSONS if each is not FlightMode.LAND])
def test_who_takes_over_an_aircraft_that_has_landed_may_lift_off_again(mode):
    """No motors are stopped then that a pilot wants to run."""
    scene = on_route()
    scene.vehicle.stays_armed = True
    scene.flight.abort("interrupted")
    scene.run(lambda s: not s.vehicle.vehicle.in_air).go_on(2.0)
    scene.vehicle.be(mode=mode)
    scene.go_on(30.0)
    assert "disarm" not in scene.vehicle.asked
    assert scene.flight.phase is Phase.RELEASED


def _landing_refused() -> Scene:
    scene = on_route()
    scene.vehicle.refuse = {"land": ["not now"] * 100}
    scene.flight.abort("interrupted")
    return scene.go_on(0.5)


@cache
def begun(start: str) -> Scene:
    """Made once; each example flies on with a copy."""
    return STARTS[start]()


def is_up_after(scene: Scene, day, happenings) -> bool:
    """Whether its motors still run when all of the day has happened."""
    for happens, seconds in day:
        happenings[happens](scene)
        scene.go_on(seconds)
        if not scene.vehicle.vehicle.armed:
            return False
    return True


REFUSED_IN_RETURN = [
    ("a gap of the link", 0.1), ("falls to return", 0.1), ("it refuses", 0.1),
    ("the autopilot agrees", 0.1), ("a gap of the link", 0.6),
]  # fmt: skip


@pytest.mark.parametrize("start", STARTS)
@example(day=REFUSED_IN_RETURN, mode=FlightMode.RETURN, sticks=False, told_after_s=0.0)
@given(
    day=DAY,
    mode=st.sampled_from(PERSONS),
    sticks=st.booleans(),
    told_after_s=st.sampled_from([0.0, 0.2]),
)
def test_who_has_taken_over_keeps_the_aircraft(start, day, mode, sticks, told_after_s):
    scene = copy.deepcopy(begun(start))
    if not is_up_after(scene, day, HAPPENINGS):
        return
    assume(mode is not FlightMode.HOLD or "hold" not in scene.vehicle.asked)  # else it may be ours
    seen = {"failsafe": False, "rc_available": sticks}
    scene.vehicle.be(mode=mode, intended_mode=FlightMode.UNKNOWN, **seen)
    scene.go_on(told_after_s)
    scene.vehicle.be(mode=mode, intended_mode=mode, **seen)
    scene.go_on(HEARD_S - told_after_s)
    asked, setpoints = list(scene.vehicle.asked), scene.vehicle.setpoints
    scene.vehicle.be(own_position_ned_m=np.array(scene.vehicle.position))
    scene.lost, scene.sees = "", True
    scene.go_on(15.0)
    assert scene.vehicle.asked == asked
    assert scene.vehicle.setpoints == setpoints
