"""What of a flight in lockstep may break, and what a fault is.

`bench.flights.world.World` is such a stage, `bench.flights.navigator.Navigator` such a program.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Literal, Protocol

from vwnav.bench.flights.setup import Setup
from vwnav.mavlink.ports.pymavlink_port import PymavlinkPort
from vwnav.recording.recorder import Recorder
from vwnav.sim.lockstep_camera import LockstepCamera
from vwnav.sim.memory_link import MemoryLink
from vwnav.sim.multirotor.simulated import SimulatedMultirotor
from vwnav.sim.processor import Costs, LateExecutor, Processor, SimulatedClock
from vwnav.sim.tiles import DrawnGround
from vwnav.types import FeatureExtractor, Features, Gray
from vwnav.watchdog.keepalive import KeepAlive

LINK_LATENCY_S = 0.002

Loop = Literal["link", "mission", "picture"]


class BreakableFeatures:
    """An extractor that can be made to raise, as a model does that runs out of memory."""

    def __init__(self, features: FeatureExtractor) -> None:
        self._features = features
        self.name = features.name
        self.feature_set_id = features.feature_set_id
        self.log10_per_decade = features.log10_per_decade
        self.broken = False

    def extract(self, gray: Gray, max_keypoints: int) -> Features:
        """As the extractor does, while it works."""
        if self.broken:
            raise RuntimeError("bad allocation in the inference session")
        return self._features.extract(gray, max_keypoints)


class Program(Protocol):
    """What breaks of the navigator's process."""

    port: PymavlinkPort
    keep_alive: KeepAlive
    executor: LateExecutor
    disk_full: bool

    def step_of(self, loop: Loop) -> tuple[object, str]:
        """The owner and the name of what one of its loops calls at each turn."""
        ...

    def hang(self, loop: Loop) -> None:
        """One of its loops never comes round again; the others go on."""
        ...

    def keep(self, writer: Recorder) -> None:
        """Record the flight."""
        ...

    def keep_no_more(self) -> None:
        """Close the recording, if there is one."""
        ...

    def stop_until(self, t_s: float) -> None:
        """Stopped as by SIGSTOP."""
        ...

    def end(self) -> None:
        """The process ends, in whatever way."""
        ...


class Aircraft(Protocol):
    """The simulated vehicle with whoever talks to it (`vwnav.sim.core.VehicleCore`)."""

    @property
    def vehicle(self) -> SimulatedMultirotor:
        """Another one after a reboot."""
        ...

    def reboot(self) -> None:
        """Start again with the parameters as they are."""
        ...

    def wait(self, seconds: float) -> None:
        """Its time stands still for so long."""
        ...


class FlightStage(Protocol):
    """All that a fault may touch; `wall_clock` is the computer's date as it was before a fault."""

    setup: Setup
    clock: SimulatedClock
    processor: Processor
    costs: Costs
    camera: LockstepCamera
    features: BreakableFeatures
    autopilot_link: MemoryLink
    wall_clock: Callable[[], float]

    @property
    def core(self) -> Aircraft:
        """The vehicle."""
        ...

    @property
    def navigator(self) -> Program:
        """The program that flies it."""
        ...

    @property
    def site_seed(self) -> int:
        """Of the site that the map is of."""
        ...

    @property
    def own_map(self) -> Path:
        """A map's file that may be damaged."""
        ...

    @property
    def t_s(self) -> float:
        """Since the mission began."""
        ...

    def show(self, ground: DrawnGround, tiles: Path | None = None) -> None:
        """The camera sees this from now on; its tiles are kept in that folder, for other runs."""
        ...

    def lose_watchdog(self, silent_s: float = 0.0) -> None:
        """Its process is gone, for so long unnoticed."""
        ...

    def note(self, text: str) -> None:
        """A line for the judge and the reader."""
        ...


class Fault(Protocol):
    """One thing that breaks: it changes the world for a while, and puts it back."""

    def begin(self, world: FlightStage) -> None:
        """It breaks."""
        ...

    def end(self, world: FlightStage) -> None:
        """It works again."""
        ...


class Lasting:
    """A fault that stays, or passes by itself: there is nothing to put back."""

    def end(self, world: FlightStage) -> None:
        """It stays as it is by now."""
