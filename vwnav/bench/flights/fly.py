"""How a flight with something broken in it is flown."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from vwnav.bench.flights.faults.aircraft import (
    BarometerWrong,
    BatteryAt,
    CommandRefused,
    PilotSwitches,
    SimulatorStands,
)
from vwnav.bench.flights.faults.camera import CameraTrouble
from vwnav.bench.flights.faults.computer import DiskFull, ModelRaises
from vwnav.bench.flights.scenario import Break, Flown, Scenario
from vwnav.bench.flights.setup import Setup
from vwnav.bench.flights.world import Place, World
from vwnav.rules.temporal import Span

# Through these all that is sent must stay as steady as ever.
_STEADY_THROUGH = (
    BarometerWrong,
    BatteryAt,
    CameraTrouble,
    CommandRefused,
    DiskFull,
    ModelRaises,
    PilotSwitches,
)
_DOWN_S = 1.0  # disarmed for so long: it is over
_BEGAN, _ARMED = "began", "armed"  # what a fault may wait for, beside the mission's phases


@dataclass(slots=True)
class _Planned:
    """A fault on its way."""

    plan: Break
    begun_s: float | None = None
    ended: bool = False

    @property
    def _lasts_s(self) -> float:
        return math.inf if self.plan.for_s is None else self.plan.for_s

    @property
    def disturbs(self) -> bool:
        """Whether what is sent may pause for it."""
        return not isinstance(self.plan.fault, _STEADY_THROUGH)

    @property
    def stands(self) -> bool:
        """Whether the simulator gets no processor meanwhile."""
        return isinstance(self.plan.fault, SimulatorStands)

    @property
    def span(self) -> Span | None:
        """While it lasts, since the mission began; None: it never began."""
        return None if self.begun_s is None else (self.begun_s, self.begun_s + self._lasts_s)

    def step(self, world: World, begun: dict[str, float]) -> None:
        """Begin or end it when it is time to; `begun` says since when what it waits for is so."""
        t_s = world.t_s
        if self.begun_s is None:
            since_s = begun.get(self._awaited)
            if since_s is not None and t_s >= since_s + self.plan.at_s:
                self.begun_s = t_s
                world.note(f"breaks: {self.plan.fault}")
                self.plan.fault.begin(world)
        elif not self.ended and t_s >= self.begun_s + self._lasts_s:
            world.note("mended")
            self.finish(world)

    def finish(self, world: World) -> None:
        """Put back what was changed, if it was."""
        if self.begun_s is not None and not self.ended:
            self.ended = True
            self.plan.fault.end(world)

    @property
    def _awaited(self) -> str:
        if self.plan.armed:
            return _ARMED
        return _BEGAN if self.plan.phase is None else self.plan.phase.value


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
    planned = [_Planned(each) for each in scenario.breaks]
    begun = {_BEGAN: 0.0}
    down_s: float | None = None
    has_flown = False
    while world.t_s < scenario.limit_s:
        world.step()
        armed = world.core.vehicle.commander.armed
        begun.setdefault(world.navigator.flight.phase.value, world.t_s)
        if armed:
            begun.setdefault(_ARMED, world.t_s)
        for each in planned:
            each.step(world, begun)
        see(world)
        has_flown = has_flown or armed
        if armed or not has_flown:
            down_s = None
        elif down_s is None:
            down_s = world.t_s
        elif world.t_s - down_s > _DOWN_S and world.navigator.over:
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
