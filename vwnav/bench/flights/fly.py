"""How a flight with something broken in it is flown."""

from collections.abc import Callable
from pathlib import Path

from vwnav.bench.flights.planned import ARMED, BEGAN, Planned
from vwnav.bench.flights.scenario import Flown, Scenario
from vwnav.bench.flights.setup import Setup
from vwnav.bench.flights.world import Place, World

_DOWN_S = 1.0  # disarmed for so long: it is over


def fly(
    scenario: Scenario,
    place: Place,
    recording: Path | None = None,
    see: Callable[[World], None] = lambda _: None,
    make: Callable[[Setup, Place], World] = World,
) -> Flown:
    """Fly it to its end.

    Args:
        scenario: the row.
        place: where.
        recording: where to keep what it records.
        see: called after every step.
        make: the world that it is flown in.
    """
    world = make(scenario.setup, place)
    if recording is not None:
        world.navigator.keep_at(recording)
    world.begin()
    planned = [Planned(each) for each in scenario.breaks]
    begun = {BEGAN: 0.0}
    down_s: float | None = None
    has_flown = False
    while world.t_s < scenario.limit_s:
        world.step()
        armed = world.core.vehicle.commander.armed
        begun.setdefault(world.navigator.flight.phase.value, world.t_s)
        if armed:
            begun.setdefault(ARMED, world.t_s)
        for each in planned:
            each.step(world, begun)
        see(world)
        has_flown = has_flown or armed
        if armed or not has_flown:
            down_s = None
        elif down_s is None:
            down_s = world.t_s
        elif world.t_s - down_s > _DOWN_S and world.navigator.over and _is_noted(world):
            break
    for each in planned:
        each.finish(world)
    navigator, second = world.navigator, world.successor.navigator
    navigator.keep_no_more()
    return Flown(
        scenario=scenario,
        track=world.track,
        begun_s=world.begun_s,
        flown_s=world.t_s,
        local_frame=world.local_frame,
        phase=navigator.flight.phase,
        steps=navigator.record.steps,
        second_steps=[] if second is None else second.record.steps,
        broke_s=planned[0].begun_s if planned else None,
        broken=tuple(e.span for e in planned if e.span is not None and e.disturbs),
        stood=tuple(e.span for e in planned if e.span is not None and e.stands),
        end=navigator.flight.end,
    )


def _is_noted(world: World) -> bool:
    """How the mission ended stands in the track."""
    return world.track.phases[-1].text == world.navigator.flight.phase.value
