"""How the table's faults are made in a real flight: on the link, in our processes, by a pilot."""

import signal
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from vwnav.bench.flights.faults import aircraft, camera, computer, link, telemetry
from vwnav.bench.flights.live.inside import patch_folder, trigger_of
from vwnav.bench.flights.live.processes import guarding, send, stop_for
from vwnav.bench.flights.live.relay import MavlinkPilot
from vwnav.bench.flights.scenario import Break
from vwnav.bench.flights.stage import Fault, FlightStage
from vwnav.vehicle import Order

_PATCH = "patch"
_ON_THE_LINK = (
    link.LinkCut, link.HeldBack, link.RoundTrip, link.SlowLine, link.Garbage, link.PacketsLost,
    link.Replayed, telemetry.Missing, telemetry.Doubled, telemetry.Altered, telemetry.TelemetryLate,
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
    """Those that have to break within our processes, by their number."""
    return {i: each.fault for i, each in enumerate(breaks) if isinstance(each.fault, _INSIDE)}


def patch_of(breaks: Sequence[Break], folder: Path) -> Path:
    """Where the processes of a flight of that folder load them from."""
    return patch_folder(folder / _PATCH, inside_of(breaks))


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


@dataclass(frozen=True, slots=True)
class Reach:
    """What of a flight can be broken.

    Attributes:
        navigator: its process.
        folder: of the flight's files.
        pilot: who flies the aircraft by a link of his own; None without one.
        order: has a ground station ask the program for something.
    """

    navigator: "subprocess.Popen[bytes]"
    folder: Path
    pilot: MavlinkPilot | None
    order: Callable[[Order], None]


def by_our_means(fault: Fault, number: int, reach: Reach) -> Fault:
    """A fault of a row, by its number there, as it is made in a real flight.

    Those of the link break a stage whose link is the relay's.
    """
    pilot, navigator = reach.pilot, reach.navigator.pid
    match fault:
        case _ if isinstance(fault, _INSIDE):
            trigger = trigger_of(reach.folder / _PATCH, number)
            return _ByOurMeans(fault, trigger.touch, lambda: trigger.unlink(missing_ok=True))
        case computer.NavigatorKilled():
            return _ByOurMeans(fault, reach.navigator.kill)
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
            return _ByOurMeans(fault, lambda: reach.order(Order.GO_ON))
        case link.StationCommands(mode):
            assert pilot is not None
            return _ByOurMeans(fault, lambda: pilot.ask(mode))
    return fault
