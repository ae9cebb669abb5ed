"""What is noted of a flight in lockstep, for its judge: truth, what was sent, what was said."""

import bisect
from dataclasses import dataclass, field, replace

from vwnav.rules.flight_log import (
    At,
    CommandAck,
    Heartbeat,
    LoggedCommand,
    LoggedSetpoint,
    ParameterSet,
    Sent,
)
from vwnav.types import Array
from vwnav.vehicle import FlightMode


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """The aircraft at a moment: NED about the run's origin."""

    t_s: float
    position_ned_m: Array
    velocity_ned_m_s: Array
    mode: FlightMode
    armed: bool
    on_ground: bool
    battery_ratio: float = 1.0


@dataclass(frozen=True, slots=True)
class LogLine:
    """A line that the program said, or a change that the harness noted."""

    t_s: float
    text: str


@dataclass(slots=True)
class Heard:
    """Messages on the autopilot's link, by what they are: rows of a `FlightLog`."""

    estimates: list[Sent] = field(default_factory=list)
    setpoints: list[LoggedSetpoint] = field(default_factory=list)
    commands: list[LoggedCommand] = field(default_factory=list)
    answers: list[CommandAck] = field(default_factory=list)
    parameters_set: list[ParameterSet] = field(default_factory=list)
    beats: list[Heartbeat] = field(default_factory=list)


@dataclass(slots=True)
class FlightTrace:
    """Everything noted, in order of time.

    Attributes:
        heard: what the autopilot got, and answered.
        events, phases: their times count from the mission's begin.
    """

    truth: list[Truth] = field(default_factory=list)
    heard: Heard = field(default_factory=Heard)
    homes: list[At] = field(default_factory=list)
    events: list[LogLine] = field(default_factory=list)
    phases: list[LogLine] = field(default_factory=list)

    def enters(self, phase: str, t_s: float) -> None:
        """The mission stands in it; to be called at every step, for a setpoint may follow at once.

        `t_s` since the mission began.
        """
        if not self.phases or self.phases[-1].text != phase:
            self.phases.append(LogLine(t_s, phase))

    def truth_at(self, t_s: float) -> Truth:
        """The nearest one before, with the position carried on to the moment."""
        i = max(bisect.bisect_right(self.truth, t_s, key=lambda each: each.t_s) - 1, 0)
        near = self.truth[i]
        position = near.position_ned_m + (t_s - near.t_s) * near.velocity_ned_m_s
        return replace(near, t_s=t_s, position_ned_m=position)

    @property
    def flew(self) -> bool:
        """It has been in the air."""
        return any(each.armed and not each.on_ground for each in self.truth)

    def modes(self) -> list[LogLine]:
        """Changes of the flown mode."""
        found: list[LogLine] = []
        for each in self.truth:
            if not found or found[-1].text != each.mode.name:
                found.append(LogLine(each.t_s, each.mode.name))
        return found
