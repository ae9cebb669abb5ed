"""A flight with something broken in it, and what became of it, as data."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import Enum

from vwnav.bench.flights.setup import Setup
from vwnav.bench.flights.stage import Fault
from vwnav.bench.flights.track import FlightTrace
from vwnav.geometry.geodesy import LocalFrame
from vwnav.mission.mission import FlightEnd, Phase
from vwnav.rules.temporal import Span
from vwnav.seams import StepResult


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


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Flown:
    """A scenario that was flown.

    Attributes:
        track: what was noted of it.
        begun_s: when the mission began, on the track's clock; `flown_s` how long it was flown.
        local_frame: the run's.
        phase: where the mission stood last.
        steps: what each picture brought; `second_steps` to the navigator that stood in, if one did.
        broke_s: when the first fault began, since the mission began; None: it never did.
        broken: from when to when each fault lasted that may disturb what is sent, likewise.
        end: what the mission said; None while it went on.
    """

    scenario: Scenario
    track: FlightTrace
    begun_s: float
    flown_s: float
    local_frame: LocalFrame
    phase: Phase
    steps: Sequence[StepResult]
    second_steps: Sequence[StepResult]
    broke_s: float | None
    broken: tuple[Span, ...]
    end: FlightEnd | None
