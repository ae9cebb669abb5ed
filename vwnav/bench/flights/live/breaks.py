"""How the table's faults are made in a real flight: on the link, in our processes, by a pilot."""

import signal
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace

from vwnav.bench.flights.faults import aircraft, camera, computer, link, telemetry
from vwnav.bench.flights.live.inside import trigger_of
from vwnav.bench.flights.live.processes import guarding, send, stop_for
from vwnav.bench.flights.live.session import LiveFlight
from vwnav.bench.flights.planned import ARMED, BEGAN, Planned
from vwnav.bench.flights.scenario import Break, Scenario
from vwnav.bench.flights.stage import Fault, FlightStage
from vwnav.mission.mission import Phase
from vwnav.types import Array

_ON_THE_LINK = (
    link.LinkCut, link.RoundTrip, link.SlowLine, link.Garbage, link.PacketsLost, link.Replayed,
    telemetry.Missing, telemetry.Doubled, telemetry.Altered, telemetry.TelemetryLate,
)  # fmt: skip
_INSIDE = (
    camera.CameraTrouble, camera.ImagesLate, computer.ModelRaises, computer.MatchingRaises,
    computer.StepRaises, computer.LoopHangs,
)  # fmt: skip
_TO_PROCESSES = (
    computer.NavigatorKilled, computer.NavigatorStopped,
    computer.WatchdogKilled, computer.WatchdogHangs,
)  # fmt: skip
_BY_A_PILOT = (
    aircraft.PilotSwitches, aircraft.PilotHandsBack, aircraft.StationOrders, link.StationCommands,
)  # fmt: skip


def can_be_broken(breaks: Sequence[Break], has_pilot: bool) -> bool:
    """Whether all of it can be made from our side, or by a pilot who has a link."""
    kinds = (*_ON_THE_LINK, *_INSIDE, *_TO_PROCESSES, *(_BY_A_PILOT if has_pilot else ()))
    return bool(breaks) and all(isinstance(each.fault, kinds) for each in breaks)


def inside_of(breaks: Sequence[Break]) -> dict[int, Fault]:
    """Those that have to break within our processes, by their number: see `inside`."""
    return {i: each.fault for i, each in enumerate(breaks) if isinstance(each.fault, _INSIDE)}


@dataclass(frozen=True)
class _ByOurMeans:
    """A fault of the table, as it is made here."""

    fault: Fault
    how: Callable[[], None]
    back: Callable[[], object] = lambda: None

    def begin(self, world: FlightStage) -> None:
        """It breaks."""
        self.how()

    def end(self, world: FlightStage) -> None:
        """It works again."""
        self.back()

    def __str__(self) -> str:
        return str(self.fault)


class _Stage:
    """As much of a stage as faults of the link and orders of a station touch."""

    def __init__(self, flight: LiveFlight, since_s: float) -> None:
        self._flight, self._since_s = flight, since_s
        self.autopilot_link = flight.simulator.relay.autopilot_link
        self.note = flight.note

    @property
    def t_s(self) -> float:
        """Since the row began."""
        return self._flight.t_s - self._since_s

    @property
    def navigator(self) -> SimpleNamespace:
        """Whom a station speaks to."""
        return SimpleNamespace(port=SimpleNamespace(own_id=self._flight.simulator.navigators_id))


class LiveBreaks:
    """What breaks in a flight, from now on; a row that begins at speed on the route breaks at once.

    Attributes:
        broke_s: when the first did, on the flight's clock, and where that was; None before.
    """

    def __init__(self, row: Scenario, flight: LiveFlight) -> None:
        start, first = row.setup.start, row.breaks[0]
        at_speed = start is not None and start.phase is Phase.ROUTE and first.phase is None
        self._began_s = flight.t_s - (first.at_s if at_speed else 0.0)
        self._flight, self._stage = flight, _Stage(flight, self._began_s)
        self._planned = [
            Planned(replace(each, fault=_by_our_means(each.fault, i, flight)))
            for i, each in enumerate(row.breaks)
        ]
        self._begun = {BEGAN: 0.0}
        self.broke_s: float | None = None
        self.broke_at_ned_m: Array | None = None

    def step(self) -> None:
        """Begin and end what it is time for."""
        for line in self._flight.track.phases:
            self._begun.setdefault(line.text, line.t_s - self._began_s)
        if self._flight.simulator.armed:
            self._begun.setdefault(ARMED, self._stage.t_s)
        for each in self._planned:
            each.step(self._stage, self._begun)  # type: ignore[arg-type]
        if self.broke_s is None and any(each.begun_s is not None for each in self._planned):
            self.broke_s, self.broke_at_ned_m = self._flight.t_s, self._flight.place_ned_m()

    def finish(self) -> None:
        """Put back whatever is not."""
        for each in self._planned:
            each.finish(self._stage)  # type: ignore[arg-type]


def _by_our_means(fault: Fault, number: int, flight: LiveFlight) -> Fault:
    pilot, navigator = flight.simulator.pilot, flight.process.pid
    match fault:
        case _ if isinstance(fault, _INSIDE):
            trigger = trigger_of(flight.patch, number)
            return _ByOurMeans(fault, trigger.touch, lambda: trigger.unlink(missing_ok=True))
        case computer.NavigatorKilled():
            return _ByOurMeans(fault, flight.process.kill)
        case computer.NavigatorStopped(seconds):
            return _ByOurMeans(fault, lambda: stop_for(seconds, navigator))
        case computer.WatchdogKilled():
            return _ByOurMeans(fault, lambda: send(signal.SIGKILL, guarding(navigator)))
        case computer.WatchdogHangs():
            return _ByOurMeans(fault, lambda: send(signal.SIGSTOP, guarding(navigator)))
        case aircraft.PilotSwitches():
            assert pilot is not None
            return _ByOurMeans(fault, pilot.take_over)
        case aircraft.PilotHandsBack():
            return _ByOurMeans(fault, flight.simulator.hand_back)
        case link.StationCommands(mode):
            assert pilot is not None
            return _ByOurMeans(fault, lambda: pilot.ask(mode))
    return fault
