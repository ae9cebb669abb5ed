"""What is to be flown, in which phases, how it may end, and who the mission speaks with."""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import NamedTuple, Protocol

from vwnav.mission.home import WayHome
from vwnav.safety.check import Check
from vwnav.types import Array
from vwnav.vehicle import Learned, Navigation, VehicleState
from vwnav.watchdog.keepalive import WatchdogReport

ASKS = "a ground station asks for"  # as it is said and recorded
GONE_S = 60.0  # of an autopilot that has not been heard for so long nobody will tell the end


class Phase(Enum):
    """Where the mission stands."""

    GET_READY = "getting ready"
    TAKEOFF = "taking off"
    CLIMB = "climbing"
    FIRST_FIX = "waiting for a fix"
    ROUTE = "on route"
    RETURN = "returning"
    DESCEND = "descending"
    LAND = "landing"
    FAILSAFE = "autopilot's failsafe"
    RELEASED = "pilot flies"
    RESUME = "taking over again"
    DONE = "done"

    @property
    def is_steered(self) -> bool:
        """By us: the autopilot has accepted Offboard."""
        return self in _STEERED

    @property
    def is_ours(self) -> bool:
        """So, or in the autopilot's own take-off: nobody else would bring it down if we died."""
        return self in _STEERED or self in (Phase.TAKEOFF, Phase.RESUME)

    @property
    def is_ours_no_more(self) -> bool:
        """It comes down, or somebody else has it."""
        return self in (Phase.LAND, Phase.FAILSAFE, Phase.RELEASED)


_STEERED = frozenset({Phase.CLIMB, Phase.FIRST_FIX, Phase.ROUTE, Phase.RETURN, Phase.DESCEND})


class Next(NamedTuple):
    """The phase that follows, and why; on to LAND without a reason: the whole route was flown."""

    phase: Phase
    reason: str | None = None


@dataclass(frozen=True, slots=True)
class FlightEnd:
    """How the flight ended.

    Attributes:
        reason: None when the whole route was flown.
        unsafe: it never began, because it was not safe to.
    """

    reason: str | None
    unsafe: bool = False


class DeadMansHandle(Protocol):
    """What the mission needs of `vwnav.watchdog.keepalive.KeepAlive`."""

    @property
    def report(self) -> WatchdogReport | None:
        """The watchdog's newest answer."""
        ...

    def beat(self, engaged: bool, phase: str, learned: Learned | None = None) -> None:
        """Say that the loop lives, whether it steers, and what a successor may begin with."""
        ...

    def rejoin(self) -> None:
        """Take the aircraft back from a watchdog that acts."""
        ...

    def leave(self) -> None:
        """Say that the navigator ends: whoever can take its place may begin."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Mission:
    """What is to be flown.

    Attributes:
        route_ned_m: (n, 3) waypoints; the way back to above home is added.
        about_home: the waypoints are counted from home, wherever that turns out to be; else from
            the frame's origin.
        home_ne_m: (2,) where the aircraft is thought to stand; None when nobody knows.
        home_sigma_m: how well that is known, per axis.
        way_home: how high the straight way there is flown.
        refuse: says why a route (n, 3) must not be flown, "" when it may; asked once home is known
            if it was not before.
    """

    route_ned_m: Array
    about_home: bool = False
    home_ne_m: Array | None = None
    home_sigma_m: float = 5.0
    way_home: WayHome = field(default_factory=WayHome)
    refuse: Callable[[Array], str] = lambda _: ""


@dataclass(frozen=True, slots=True, eq=False)
class Crew:
    """Who the mission speaks with.

    Attributes:
        say: receives one line per event.
        show: receives the readiness list when what is missing changes.
        checks: makes the readiness list.
        arms: arms by itself; else a person does.
    """

    say: Callable[[str], None]
    checks: Callable[[VehicleState, Navigation, float], tuple[Check, ...]]
    show: Callable[[tuple[Check, ...]], None] = lambda _: None
    arms: bool = True
