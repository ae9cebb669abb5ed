"""A law: whatever broke, an aircraft that no person has taken does not hang in the air for good."""

import copy

import pytest
import test_pilot_keeps_it
from hypothesis import example, given
from hypothesis import strategies as st
from test_flight import Scene, gap
from test_pilot_keeps_it import STARTS, begun, is_up_after

from vwnav.vehicle import FlightMode, Order
from vwnav.watchdog.keepalive import GuardState, WatchdogReport

HEALED_S = 300.0
# In these it stays up until somebody asks for something, or follows nobody's setpoints.
STAYS_UP = (FlightMode.HOLD, FlightMode.MANUAL, FlightMode.OFFBOARD, FlightMode.TAKEOFF)


def falls(scene: Scene, mode: FlightMode, told_after_s: float) -> None:
    """Into a failsafe for a gap of the link; who chose the mode is told a moment later."""
    gap(scene, 2.5)
    now = scene.vehicle.vehicle
    wanted = now.intended_mode if now.failsafe else now.mode
    if mode is wanted:
        return
    if told_after_s:
        scene.vehicle.be(mode=mode, intended_mode=FlightMode.UNKNOWN)
        scene.go_on(told_after_s)
    scene.vehicle.be(mode=mode, intended_mode=wanted, failsafe=True)


def comes_back(scene: Scene) -> None:
    """PX4 goes back to what was asked for when what was lost returns."""
    if scene.vehicle.vehicle.failsafe:
        scene.vehicle.be(mode=scene.vehicle.vehicle.intended_mode, failsafe=False)


def takeoff_ends(scene: Scene) -> None:
    if scene.vehicle.vehicle.mode is FlightMode.TAKEOFF:
        scene.vehicle.be(mode=FlightMode.HOLD)


ALSO_THERE = (
    "a gap of the link", "a longer gap", "no estimate", "an estimate again", "the autopilot agrees",
    "it is elsewhere", "it answers late", "blind", "interrupted",
)  # fmt: skip
HAPPENINGS = {name: test_pilot_keeps_it.HAPPENINGS[name] for name in ALSO_THERE} | {
    "it refuses": lambda scene: scene.vehicle.refuse.update(
        {name: ["not now"] * 5 for name in ("hold", "land", "offboard")}
    ),
    "it sees again": lambda scene: setattr(scene, "sees", True),
    "no fix": lambda scene: setattr(scene, "fixes", False),
    "fixes again": lambda scene: setattr(scene, "fixes", True),
    "the watchdog brakes": lambda scene: setattr(
        scene.handle, "report", WatchdogReport(GuardState.BRAKING, 1, 0.1)
    ),
    "the watchdog relays": lambda scene: setattr(
        scene.handle, "report", WatchdogReport(GuardState.RELAY, 1, 0.1)
    ),
    "the way home is asked for": lambda scene: scene.flight.obey(Order.RETURN),
    "a landing is asked for": lambda scene: scene.flight.obey(Order.LAND),
    "back in the mode": comes_back,
    "the take-off is over": takeoff_ends,
}
HAPPENINGS |= {
    f"falls to {mode.value}, told after {told_s} s": lambda scene, mode=mode, told_s=told_s: falls(
        scene, mode, told_s
    )
    for mode in (FlightMode.HOLD, FlightMode.DESCEND, FlightMode.LAND, FlightMode.MANUAL)
    for told_s in (0.0, 0.6)
}
DAY = st.lists(
    st.tuples(st.sampled_from(sorted(HAPPENINGS)), st.sampled_from([0.1, 0.6, 1.2, 2.4, 5.5])),
    max_size=6,
)  # fmt: skip


# Each of these once hung: its second fallback was taken for a person's, because nobody had told yet
# who chose the first; its landing was a pilot's when PX4 went back to Offboard; it was never asked
# for, because PX4 had come down by itself when it began; the gap before it had been forgotten.
TOLD_LATE = [
    ("falls to descend, told after 0.6 s", 0.1), ("falls to manual, told after 0.6 s", 0.1),
]  # fmt: skip
BACK_IN_OFFBOARD = [("falls to land, told after 0.0 s", 0.1), ("back in the mode", 0.1)]
NEVER_ASKED = [
    ("falls to descend, told after 0.0 s", 0.1), ("interrupted", 0.1), ("back in the mode", 0.1),
]  # fmt: skip
FORGOTTEN = [("falls to hold, told after 0.0 s", 5.5), ("an estimate again", 5.5)]


@pytest.mark.parametrize("start", [name for name in STARTS if name != "Hold was asked for"])
@example(day=TOLD_LATE)
@example(day=BACK_IN_OFFBOARD)
@example(day=NEVER_ASKED)
@example(day=FORGOTTEN)
@given(day=DAY)
def test_an_aircraft_that_nobody_has_taken_comes_down_or_flies_on(start, day):
    scene = copy.deepcopy(begun(start))
    if not is_up_after(scene, day, HAPPENINGS):
        return
    # All is well again, and the autopilot stays in what it flies.
    scene.lost, scene.sees, scene.fixes, scene.vehicle.answers_after = "", True, True, 1
    scene.handle.report = None
    scene.vehicle.refuse.clear()
    if scene.vehicle.vehicle.mode not in STAYS_UP:
        return
    scene.vehicle.be(silence_s=0.1)
    until_s = scene.t_s + HEALED_S
    while scene.flight.end is None and scene.t_s < until_s:
        scene.vehicle.be(own_position_ned_m=scene.vehicle.position.copy())
        scene.go_on(1.0)
        if scene.vehicle.vehicle.mode not in STAYS_UP:
            return
    assert scene.flight.end is not None, scene.said[-8:]
