"""Faults on their way: each begins and ends when it is time to."""

import math
from dataclasses import dataclass

from vwnav.bench.flights.faults.aircraft import (
    BarometerWrong,
    BatteryAt,
    CommandRefused,
    PilotSwitches,
    SimulatorStands,
)
from vwnav.bench.flights.faults.camera import CameraTrouble
from vwnav.bench.flights.faults.computer import DiskFull, ModelRaises
from vwnav.bench.flights.scenario import Break
from vwnav.bench.flights.stage import FlightStage
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
BEGAN, ARMED = "began", "armed"  # what a fault may wait for, beside the mission's phases


@dataclass(slots=True)
class Planned:
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

    def step(self, world: FlightStage, begun: dict[str, float]) -> None:
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

    def finish(self, world: FlightStage) -> None:
        """Put back what was changed, if it was."""
        if self.begun_s is not None and not self.ended:
            self.ended = True
            self.plan.fault.end(world)

    @property
    def _awaited(self) -> str:
        if self.plan.armed:
            return ARMED
        return BEGAN if self.plan.phase is None else self.plan.phase.value
