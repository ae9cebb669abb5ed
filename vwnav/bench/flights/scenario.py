"""A flight with something broken in it, as data; and how it is flown."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path

from vwnav.bench.flights import faults
from vwnav.bench.flights.faults import Fault
from vwnav.bench.flights.place import Place
from vwnav.bench.flights.setup import Setup
from vwnav.bench.flights.track import Track
from vwnav.bench.flights.world import World
from vwnav.mission import FlightEnd, Phase
from vwnav.rules.temporal import Span

# Through these all that is sent must stay as steady as ever.
_STEADY_THROUGH = (
    faults.BarometerWrong,
    faults.BatteryAt,
    faults.CameraTrouble,
    faults.CommandRefused,
    faults.DiskFull,
    faults.ModelRaises,
    faults.PilotSwitches,
)
_DOWN_S = 1.0  # disarmed for so long: it is over


class Ending(Enum):
    """How a flight ends in good order."""

    LANDED = "landed: motors off, on the ground"
    FLIES_ON = "the mission goes on"
    PILOT = "in the pilot's hands"
    STAYED = "never took off"


@dataclass(frozen=True, slots=True, kw_only=True)
class Break:
    """One thing that breaks.

    Attributes:
        at_s: since the mission began; with `phase` since that phase was first entered.
        for_s: how long it lasts; None: for good.
    """

    fault: Fault
    at_s: float = 6.0
    phase: Phase | None = None
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
    when: Callable[[Track, float], list[float]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """One row of the table.

    Attributes:
        limit_s: simulated seconds after which it is over, whatever flies.
        follows: what must follow the first fault.
        lands_within_m: of where it is meant to come down; None is not looked at.
        lands_at_ne_m: that place, about the run's origin; None is where it was when it broke.
        faster_m_s: allowed beyond the route's speed and the wind.
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
    track: Track
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

    def step(self, world: World, phases: dict[str, float]) -> None:
        """Begin or end it when it is time to."""
        t_s = world.t_s
        if self.begun_s is None:
            since_s = 0.0 if self.plan.phase is None else phases.get(self.plan.phase.value)
            if since_s is not None and t_s >= since_s + self.plan.at_s:
                self.begun_s = t_s
                world.note(f"breaks: {self.plan.fault}")
                self.plan.fault.begin(world)
        elif not self.ended and t_s >= self.begun_s + self._lasts_s:
            self.ended = True
            world.note("mended")
            self.plan.fault.end(world)


def fly(scenario: Scenario, place: Place, recording: Path | None = None) -> Flown:
    """Fly it to its end; `recording` is where to keep what it records."""
    world = World(scenario.setup, place)
    if recording is not None:
        world.navigator.keep(recording)
    world.begin()
    planned = [_Planned(each) for each in scenario.breaks]
    phases: dict[str, float] = {}
    down_s: float | None = None
    has_flown = False
    while world.t_s < scenario.limit_s:
        world.step()
        phases.setdefault(world.navigator.flight.phase.value, world.t_s)
        for each in planned:
            each.step(world, phases)
        armed = world.core.vehicle.commander.armed
        has_flown = has_flown or armed
        if armed or not has_flown:
            down_s = None
        elif down_s is None:
            down_s = world.t_s
        elif world.t_s - down_s > _DOWN_S and world.navigator.over:
            break
    if world.navigator.record.recorder is not None:
        world.navigator.record.recorder.close()
    broke_s = planned[0].begun_s if planned else None
    broken = tuple(each.span for each in planned if each.span is not None and each.disturbs)
    return Flown(scenario, world, world.track, broke_s, broken, world.navigator.flight.end)
