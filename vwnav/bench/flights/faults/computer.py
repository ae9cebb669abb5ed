"""Faults of the navigator's computer: its processor, processes, model, map file, disk and clock."""

import threading
import time
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from vwnav.bench.flights.stage import FlightStage, Lasting, Loop
from vwnav.recording.recorder import Recorder
from vwnav.watchdog.spare import HANGS_S

_SQLITE_PAGE_BYTES = 4096


@dataclass(frozen=True)
class ModelRaises:
    """The learned features raise."""

    def begin(self, world: FlightStage) -> None:
        """Broken."""
        world.features.broken = True

    def end(self, world: FlightStage) -> None:
        """Works."""
        world.features.broken = False


@dataclass(frozen=True)
class SlowSearch:
    """A search of the whole map takes so long."""

    seconds: float

    def begin(self, world: FlightStage) -> None:
        """Slow."""
        world.costs.search = self.seconds

    def end(self, world: FlightStage) -> None:
        """As before."""
        world.costs.search = type(world.costs)().search


@dataclass(frozen=True)
class Starved(Lasting):
    """Other programs take the processor: so much of it is left."""

    share: float
    seconds: float

    def begin(self, world: FlightStage) -> None:
        """From now on, for the seconds."""
        now_s = world.clock.now_s
        world.processor.starve(now_s, now_s + self.seconds, self.share)


# ---- processes


@dataclass(frozen=True)
class NavigatorStopped(Lasting):
    """Its process is stopped for so long, and goes on."""

    seconds: float

    def begin(self, world: FlightStage) -> None:
        """Stopped."""
        world.navigator.stop_until(world.clock.now_s + self.seconds)


@dataclass(frozen=True)
class NavigatorKilled(Lasting):
    """Its process ends without a word; the watchdog sees that."""

    def begin(self, world: FlightStage) -> None:
        """Dead."""
        world.navigator.end()


@dataclass(frozen=True)
class NavigatorLeaves(Lasting):
    """Its process unwinds in an orderly way, whatever the reason: `KeepAlive.close`."""

    def begin(self, world: FlightStage) -> None:
        """It says that it ends."""
        world.navigator.keep_alive.close()
        world.navigator.end()


@dataclass(frozen=True)
class WatchdogKilled(Lasting):
    """The watchdog's process ends; nothing passes until the spare one has the link."""

    def begin(self, world: FlightStage) -> None:
        """Dead."""
        world.lose_watchdog()


@dataclass(frozen=True)
class WatchdogHangs(Lasting):
    """The watchdog's process is stopped; the spare one ends it when it says nothing."""

    def begin(self, world: FlightStage) -> None:
        """Silent."""
        world.lose_watchdog(HANGS_S)


@dataclass(frozen=True)
class StepRaises:
    """One of the navigator's steps raises, each time."""

    step: Loop

    def begin(self, world: FlightStage) -> None:
        """Broken."""
        setattr(*world.navigator.step_of(self.step), _raise)

    def end(self, world: FlightStage) -> None:
        """As it was, however often it was broken."""
        owner, name = world.navigator.step_of(self.step)
        vars(owner).pop(name, None)


@dataclass(frozen=True)
class LoopHangs(Lasting):
    """One of the navigator's loops waits for good for what never comes: a lock, a driver."""

    loop: Loop

    def begin(self, world: FlightStage) -> None:
        """It hangs."""
        world.navigator.hang(self.loop)


@dataclass(frozen=True)
class MatchingRaises:
    """Whichever features are matched: the thread that matches raises."""

    def begin(self, world: FlightStage) -> None:
        """Broken."""
        executor = world.navigator.executor
        whole = executor.submit

        def submit(_: object, *args: object, **kwargs: object) -> Future[Any]:
            return whole(_raise, *args, **kwargs)

        executor.submit = submit  # type: ignore[method-assign]

    def end(self, world: FlightStage) -> None:
        """As it was, however often it was broken."""
        vars(world.navigator.executor).pop("submit", None)


def _raise(*_: object, **__: object) -> None:
    raise RuntimeError("broken on purpose")


# ---- files and clocks


@dataclass(frozen=True)
class MapTilesDamaged(Lasting):
    """The second half of the map's file reads as zeros. Wants a flight with a map of its own."""

    def begin(self, world: FlightStage) -> None:
        """Sectors of the disk die."""
        path = world.own_map
        size = path.stat().st_size
        first = size // 2 // _SQLITE_PAGE_BYTES * _SQLITE_PAGE_BYTES
        with path.open("r+b") as file:
            file.seek(first)
            file.write(bytes(size - first))


@dataclass(frozen=True)
class MapDeleted(Lasting):
    """The map's file is deleted. Wants a flight with a map of its own."""

    def begin(self, world: FlightStage) -> None:
        """Gone from the folder."""
        world.own_map.unlink()


@dataclass(frozen=True)
class DiskFull:
    """Nothing can be recorded."""

    def begin(self, world: FlightStage) -> None:
        """Full."""
        world.navigator.disk_full = True

    def end(self, world: FlightStage) -> None:
        """Room again."""
        world.navigator.disk_full = False


class StalledRecorder(Recorder):
    """Takes everything and writes nothing, until it is closed."""

    def __init__(self) -> None:
        self._released = threading.Event()
        self._folder = TemporaryDirectory(prefix="vwnav-stalled-")
        super().__init__(Path(self._folder.name) / "flight.mcap", {})
        self._disk.put(self._stall)

    def close(self) -> None:
        """The disk answers again."""
        self._released.set()
        super().close()
        self._folder.cleanup()

    def _stall(self) -> None:
        self._released.wait()


@dataclass(frozen=True)
class DiskStalled:
    """Whatever is written waits: the true recorder, with a thread that never gets on."""

    def begin(self, world: FlightStage) -> None:
        """Stalled."""
        world.navigator.keep(StalledRecorder())

    def end(self, world: FlightStage) -> None:
        """It writes again."""
        world.navigator.keep_no_more()


@dataclass(frozen=True)
class WallClockJumps:
    """The computer's date is set, as by NTP; its monotonic clock knows nothing of it."""

    seconds: float

    def begin(self, world: FlightStage) -> None:
        """Set."""
        world.wall_clock = time.time
        time.time = lambda: world.wall_clock() + self.seconds

    def end(self, world: FlightStage) -> None:
        """Set back."""
        time.time = world.wall_clock
