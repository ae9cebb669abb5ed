"""What is noted of a flight in lockstep, for its judge: truth, what was sent, what was said."""

import bisect
from dataclasses import dataclass, field

import numpy as np

from vwnav.sim.px4.modes import NavState
from vwnav.types import Array, Estimate


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """The aircraft at a moment: NED about the run's origin."""

    t_s: float
    position_ned_m: Array
    velocity_ned_m_s: Array
    mode: NavState
    armed: bool
    on_ground: bool


@dataclass(frozen=True, slots=True, eq=False)
class Sent:
    """An estimate as the autopilot got it.

    Attributes:
        t_s: arrival; `stamp_s` is the moment that it is about.
        covariance_ne_m2: (2, 2).
    """

    t_s: float
    stamp_s: float
    position_ned_m: Array
    covariance_ne_m2: Array
    reset_counter: int


@dataclass(frozen=True, slots=True)
class Order:
    """A setpoint or a command as the autopilot got it; `component` is who sent it."""

    t_s: float
    kind: str
    component: int
    number: int = 0
    parameters: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class Event:
    """A line that the program said, or a change that the harness noted."""

    t_s: float
    text: str


@dataclass(slots=True)
class Track:
    """Everything noted, in order of time."""

    truth: list[Truth] = field(default_factory=list)
    sent: list[Sent] = field(default_factory=list)
    orders: list[Order] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    phases: list[Event] = field(default_factory=list)
    believed: list[Estimate] = field(default_factory=list)

    def truth_at(self, t_s: float) -> Truth:
        """The nearest one before, with the position carried on to the moment."""
        i = max(bisect.bisect_right(self.truth, t_s, key=lambda each: each.t_s) - 1, 0)
        near = self.truth[i]
        position = near.position_ned_m + (t_s - near.t_s) * near.velocity_ned_m_s
        return Truth(t_s, position, near.velocity_ned_m_s, near.mode, near.armed, near.on_ground)

    def modes(self) -> list[Event]:
        """Changes of the flown mode."""
        found: list[Event] = []
        for each in self.truth:
            if not found or found[-1].text != each.mode.name:
                found.append(Event(each.t_s, each.mode.name))
        return found

    def sigmas(self, map_off_m: float = 0.0) -> Array:
        """(n, 2) of every estimate sent: arrival, and how many of its sigmas it is wrong.

        An error of the map itself, `map_off_m`, is none of the estimate's.
        """
        rows = []
        for sent in self.sent:
            error = (sent.position_ned_m - self.truth_at(sent.stamp_s).position_ned_m)[:2]
            error = error * max(0.0, 1.0 - map_off_m / max(float(np.hypot(*error)), 1e-9))
            square = float(error @ np.linalg.solve(sent.covariance_ne_m2, error))
            rows.append((sent.t_s, np.sqrt(max(square, 0.0))))
        return np.array(rows, np.float64).reshape(-1, 2)
