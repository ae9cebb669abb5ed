"""A flight with something broken in it, and what became of it, as data; what rows share."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from vwnav.bench.flights.setup import AirStart, Setup
from vwnav.bench.flights.stage import Fault
from vwnav.bench.flights.track import FlightTrace
from vwnav.config import Config
from vwnav.geometry.geodesy import LocalFrame
from vwnav.mission.mission import FlightEnd, Phase
from vwnav.rules.temporal import Span
from vwnav.seams import PipelineConfig, StepResult

HOME = (0.0, 0.0)
# Every other image that could be matched: what is left out costs the most and tells the least.
CONFIG = Config(pipeline=PipelineConfig(fix_interval_s=0.4))
ROUTE = AirStart(phase=Phase.ROUTE, place_ned_m=(15.0, -15.0, -50.0))
CLIMB = AirStart(phase=Phase.CLIMB, place_ned_m=(0.5, 0.5, -15.0))
RETURN = AirStart(phase=Phase.RETURN, place_ned_m=(60.0, 40.0, -50.0))
DESCEND = AirStart(phase=Phase.DESCEND, place_ned_m=(0.5, -0.5, -25.0))
# What no calibration says of a camera, and a flight has to learn.
NOBODY_KNOWS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("rows read in 30 ms and nobody knows", {"readout_s": 0.03}),
    ("pictures dated 0.1 s late and nobody knows", {"late_s": 0.1}),
)
BREAKS_AT_S = 9.0  # on the route: at speed, and after a few fixes


class Ending(Enum):
    """How a flight ends in good order."""

    LANDED = "lands"
    FLIES_ON = "flies on"
    PILOT = "in the pilot's hands"
    STAYED = "never takes off"
    OTHERS = "somebody else flies it"
    ANYHOW = "breaks no rule"


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
        steps: what each image brought; `second_steps` to the navigator that stood in, if one did.
        broke_s: when the first fault began, since the mission began; None: it never did.
        broken: from when to when each fault lasted that may disturb what is sent, likewise.
        stood: from when to when the simulator had no time, likewise.
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
    stood: tuple[Span, ...]
    end: FlightEnd | None


def mode(within_s: float, *names: str) -> Follows:
    """The vehicle flies one of these modes, as a navigator calls them: BRAKE is HOLD."""

    def when(track: FlightTrace, begun_s: float) -> list[float]:
        return [each.t_s - begun_s for each in track.truth if each.mode.name in names]

    return Follows(f"mode {' or '.join(names)}", within_s, when)


def phase(within_s: float, *names: str) -> Follows:
    """The mission stands in one of these phases."""

    def when(track: FlightTrace, _: float) -> list[float]:
        return [each.t_s for each in track.phases if each.text in names]

    return Follows(f"phase {' or '.join(names)}", within_s, when)


def said(within_s: float, *texts: str) -> Follows:
    """The program says one of these."""

    def when(track: FlightTrace, _: float) -> list[float]:
        return [each.t_s for each in track.events if any(text in each.text for text in texts)]

    return Follows(f"says {' or '.join(map(repr, texts))}", within_s, when)


def unsaid(within_s: float, text: str) -> Follows:
    """The program does not say so."""

    def when(track: FlightTrace, _: float) -> list[float]:
        return [] if any(text in each.text for each in track.events) else [within_s]

    return Follows(f"no word of {text!r}", within_s, when)


def down(within_s: float) -> Follows:
    """On the ground, motors off."""

    def when(track: FlightTrace, begun_s: float) -> list[float]:
        return [each.t_s - begun_s for each in track.truth if not each.armed]

    return Follows("down", within_s, when)


def setup(start: AirStart | None = ROUTE, **changes: object) -> Setup:
    """A flight that begins there; None: on the ground."""
    return Setup(**({"start": start, "config": CONFIG} | changes))  # type: ignore[arg-type]


def flies_on(
    name: str, fault: Fault, for_s: float | None = None, after_s: float = 12.0, **changes: object
) -> Scenario:
    """On the route, what breaks for so long is flown through, and `after_s` more."""
    lasts_s = 10.0 if for_s is None else for_s
    return Scenario(
        name=name,
        setup=setup(**changes),  # type: ignore[arg-type]
        breaks=(Break(fault=fault, at_s=BREAKS_AT_S, for_s=for_s),),
        limit_s=BREAKS_AT_S + lasts_s + after_s,
        ending=Ending.FLIES_ON,
    )


RANGEFINDERS = {0.0: ", no rangefinder", 12.0: ", rangefinder of 12 m", 100.0: ""}


def flies_route(
    name: str, *breaks: Break, range_most_m: float = 100.0, **changes: object
) -> Scenario:
    """From the ground along the whole route, and home again."""
    return Scenario(
        name=name + RANGEFINDERS[range_most_m],
        setup=setup(None, range_most_m=range_most_m, **changes),
        breaks=breaks,
        limit_s=260.0,
        follows=(phase(120.0, "on route"),),
        lands_within_m=3.0,
        lands_at_ne_m=(0.0, 0.0),
    )


def again_and_again(
    fault: Fault, every_s: float, for_s: float | None, times: int
) -> tuple[Break, ...]:
    """A loose contact: on the route it breaks, works again, and breaks."""
    return tuple(
        Break(fault=fault, at_s=BREAKS_AT_S + number * every_s, for_s=for_s)
        for number in range(times)
    )


@dataclass(frozen=True, slots=True)
class FlightVerdict:
    """What was wrong with a flight; nothing when it was good."""

    wrong: tuple[str, ...]
    landed_off_m: float | None
    fastest_m_s: float
    worst_sigmas: float
