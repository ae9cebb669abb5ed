"""Faults of the navigator's computer: its processor, processes, model, map file, disk and clock."""

import time
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any, Literal

from vwnav.bench.flights.stalled_recorder import StalledRecorder
from vwnav.bench.flights.world import World
from vwnav.watchdog.launch import HANGS_S

_SQLITE_PAGE_BYTES = 4096


@dataclass(frozen=True)
class ModelRaises:
    """The learned features raise."""

    def begin(self, world: World) -> None:
        """Broken."""
        world.features.broken = True

    def end(self, world: World) -> None:
        """Works."""
        world.features.broken = False


@dataclass(frozen=True)
class SlowSearch:
    """A search of the whole map takes so long."""

    seconds: float

    def begin(self, world: World) -> None:
        """Slow."""
        world.costs.search = self.seconds

    def end(self, world: World) -> None:
        """As before."""
        world.costs.search = type(world.costs)().search


@dataclass(frozen=True)
class Starved:
    """Other programs take the processor: so much of it is left."""

    share: float
    seconds: float

    def begin(self, world: World) -> None:
        """From now on, for the seconds."""
        now_s = world.clock.now_s
        world.processor.starve(now_s, now_s + self.seconds, self.share)

    def end(self, world: World) -> None:
        """Planned already."""


# ---- processes


@dataclass(frozen=True)
class NavigatorStopped:
    """Its process is stopped for so long, and goes on."""

    seconds: float

    def begin(self, world: World) -> None:
        """Stopped."""
        world.navigator.stop_until(world.clock.now_s + self.seconds)

    def end(self, world: World) -> None:
        """It wakes by itself."""


@dataclass(frozen=True)
class NavigatorKilled:
    """Its process ends without a word; the watchdog sees that."""

    def begin(self, world: World) -> None:
        """Dead."""
        world.navigator.end()

    def end(self, world: World) -> None:
        """It stays dead."""


@dataclass(frozen=True)
class NavigatorLeaves:
    """Its process unwinds in an orderly way, whatever the reason: `KeepAlive.close`."""

    def begin(self, world: World) -> None:
        """It says that it ends."""
        world.navigator.keep_alive.close()
        world.navigator.end()

    def end(self, world: World) -> None:
        """It is gone."""


@dataclass(frozen=True)
class WatchdogKilled:
    """The watchdog's process ends; nothing passes until the spare one has the link."""

    def begin(self, world: World) -> None:
        """Dead."""
        world.lose_watchdog()

    def end(self, world: World) -> None:
        """It stays dead."""


@dataclass(frozen=True)
class WatchdogHangs:
    """The watchdog's process is stopped; the navigator ends it when it does not answer."""

    def begin(self, world: World) -> None:
        """Silent."""
        world.lose_watchdog(HANGS_S)

    def end(self, world: World) -> None:
        """Another one has its place."""


@dataclass(frozen=True)
class StepRaises:
    """One of the navigator's steps raises, each time."""

    step: Literal["link", "mission", "picture"]

    def begin(self, world: World) -> None:
        """Broken."""
        owner, name = self._place(world)
        setattr(owner, name, _raise)

    def end(self, world: World) -> None:
        """As it was."""
        owner, name = self._place(world)
        delattr(owner, name)

    def _place(self, world: World) -> tuple[Any, str]:
        navigator = world.navigator
        match self.step:
            case "link":
                return navigator.autopilot, "step"
            case "mission":
                return navigator.runtime, "step_control"
            case "picture":
                return navigator.pipeline, "step"


@dataclass(frozen=True)
class MatchingRaises:
    """Whichever features are matched: the thread that matches raises."""

    def begin(self, world: World) -> None:
        """Broken."""
        executor = world.navigator.executor
        whole = executor.submit

        def submit(_: object, *args: object, **kwargs: object) -> Future[Any]:
            return whole(_raise, *args, **kwargs)

        executor.submit = submit  # type: ignore[method-assign]

    def end(self, world: World) -> None:
        """As it was."""
        del world.navigator.executor.submit


def _raise(*_: object, **__: object) -> None:
    raise RuntimeError("broken on purpose")


# ---- files and clocks


@dataclass(frozen=True)
class MapTilesDamaged:
    """The second half of the map's file reads as zeros. Wants a flight with a map of its own."""

    def begin(self, world: World) -> None:
        """Sectors of the disk die."""
        path = world.own_map
        size = path.stat().st_size
        first = size // 2 // _SQLITE_PAGE_BYTES * _SQLITE_PAGE_BYTES
        with path.open("r+b") as file:
            file.seek(first)
            file.write(bytes(size - first))

    def end(self, world: World) -> None:
        """It stays damaged."""


@dataclass(frozen=True)
class MapDeleted:
    """The map's file is deleted. Wants a flight with a map of its own."""

    def begin(self, world: World) -> None:
        """Gone from the folder."""
        world.own_map.unlink()

    def end(self, world: World) -> None:
        """It stays deleted."""


@dataclass(frozen=True)
class DiskFull:
    """Nothing can be recorded."""

    def begin(self, world: World) -> None:
        """Full."""
        world.navigator.record.disk_full = True

    def end(self, world: World) -> None:
        """Room again."""
        world.navigator.record.disk_full = False


@dataclass(frozen=True)
class DiskStalled:
    """Whatever is written waits: the true recorder, with a thread that never gets on."""

    def begin(self, world: World) -> None:
        """Stalled."""
        world.navigator.keep(StalledRecorder())

    def end(self, world: World) -> None:
        """It writes again."""
        recorder, world.navigator.record.recorder = world.navigator.record.recorder, None
        if recorder is not None:
            recorder.close()


@dataclass(frozen=True)
class WallClockJumps:
    """The computer's date is set, as by NTP; its monotonic clock knows nothing of it."""

    seconds: float

    def begin(self, world: World) -> None:
        """Set."""
        world.wall_clock = time.time
        time.time = lambda: world.wall_clock() + self.seconds

    def end(self, world: World) -> None:
        """Set back."""
        time.time = world.wall_clock
