"""A flight with something broken in it, as data; and how it is flown."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path

from vwnav.bench.flights.faults.aircraft import (
    BarometerWrong,
    BatteryAt,
    CommandRefused,
    PilotSwitches,
)
from vwnav.bench.flights.faults.camera import CameraTrouble
from vwnav.bench.flights.faults.computer import DiskFull, ModelRaises
from vwnav.bench.flights.faults.fault import Fault
from vwnav.bench.flights.place import Place
from vwnav.bench.flights.setup import Setup
from vwnav.bench.flights.track import FlightTrace
from vwnav.bench.flights.world import World
from vwnav.mission.mission import FlightEnd, Phase
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


class Ending(Enum):
    """How a flight ends in good order."""

    LANDED = "lands"
    FLIES_ON = "flies on"
    PILOT = "in the pilot's hands"
    STAYED = "never takes off"
    OTHERS = "somebody else flies it"


@dataclass(frozen=True, slots=True, kw_only=True)
class Break:
    """One thing that breaks.

    Attributes:
        at_s: since the mission began; with `phase` since that phase was first entered, with
            `armed` since the motors started.
        for_s: how long it lasts; None: for good.
    """

    fault: Fault
    at_s: float = 6.0
    phase: Phase | None = None
    armed: bool = False
    for_s: float | None = None


@dataclass(frozen=True, slots=True)
class Follows:
    """What must be seen within so many seconds of the first fault.

    Attributes:
        what: in words.
        when: the times at which it is seen, since the mission began.
    """

    what: str
    within_s: float
    when: Callable[[FlightTrace, float], list[float]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """One row of the table.

    Attributes:
        limit_s: simulated seconds after which it is over, whatever flies.
        follows: what must follow the first fault.
        lands_within_m: of where it is meant to come down; None is not looked at.
        lands_at_ne_m: that place, about the run's origin; None is where it was when it broke.
        faster_m_s: allowed beyond the route's speed and the wind.
        map_off_m: how far the map itself is off, which no estimate can tell.
    """

    name: str
    breaks: tuple[Break, ...]
    setup: Setup = field(default_factory=Setup)
    limit_s: float = 40.0
    ending: Ending = Ending.LANDED
    follows: tuple[Follows, ...] = ()
    lands_within_m: float | None = None
    lands_at_ne_m: tuple[float, float] | None = None
    faster_m_s: float = 1.5
    map_off_m: float = 0.0

    @property
    def expected(self) -> str:
        """What must become of it, in words."""
        words = [f"{each.what} within {each.within_s:g} s" for each in self.follows]
        where = "" if self.lands_within_m is None else f" within {self.lands_within_m:g} m"
        return ", ".join([*words, f"{self.ending.value}{where}"])

    @property
    def where(self) -> str:
        """Where in a flight it breaks, or begins."""
        first = self.breaks[0] if self.breaks else None
        if first is not None and first.armed:
            return "arming"
        if first is not None and first.phase is not None:
            return first.phase.value
        start = self.setup.start
        if start is None:
            return "on the ground"
        return "in the air" if start.phase is None else start.phase.value

    @property
    def when(self) -> str:
        """When it breaks there, and for how long."""
        if not self.breaks:
            return "whole flight"
        first = self.breaks[0]
        lasts = "for good" if first.for_s is None else f"for {first.for_s:g} s"
        return f"at {first.at_s:g} s {lasts}"


@dataclass(frozen=True, slots=True, eq=False)
class Flown:
    """A scenario that was flown.

    Attributes:
        broke_s: when the first fault began, since the mission began; None: it never did.
        broken: from when to when each fault lasted that may disturb what is sent, likewise.
        end: what the mission said; None while it went on.
    """

    scenario: Scenario
    world: World
    track: FlightTrace
    broke_s: float | None
    broken: tuple[Span, ...]
    end: FlightEnd | None


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
) -> Flown:
    """Fly it to its end.

    Args:
        scenario: the row.
        place: where.
        recording: where to keep what it records.
        see: called after every step.
    """
    world = World(scenario.setup, place)
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
    if world.navigator.record.recorder is not None:
        world.navigator.record.recorder.close()
    broke_s = planned[0].begun_s if planned else None
    broken = tuple(each.span for each in planned if each.span is not None and each.disturbs)
    return Flown(scenario, world, world.track, broke_s, broken, world.navigator.flight.end)
