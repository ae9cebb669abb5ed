"""Faults of the link between autopilot and watchdog."""

import random
from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass

from pymavlink.dialects.v20 import development as mavlink

from vwnav.bench.flights.stage import LINK_LATENCY_S, FlightStage, Lasting
from vwnav.mavlink.modes import AutopilotKind, mode_command
from vwnav.sim.memory_link import LineState, Tap
from vwnav.vehicle import FlightMode

_GARBAGE_BYTES = 60
_GARBAGE_EVERY = 10  # packets: so often comes rubbish, and so often one is cut off
_KINDS = {
    "px4": AutopilotKind.PX4,
    "px4-1.16": AutopilotKind.PX4,
    "copter": AutopilotKind.ARDUPILOT,
}
_STATION = (255, 190)  # system and component of QGroundControl


@dataclass(frozen=True)
class LinkCut:
    """Nothing passes between autopilot and watchdog, either way."""

    def begin(self, world: FlightStage) -> None:
        """Cut."""
        for line in _lines(world):
            line.taps[id(self)] = lambda packet: ()

    def end(self, world: FlightStage) -> None:
        """Joined."""
        for line in _lines(world):
            del line.taps[id(self)]


@dataclass(frozen=True)
class HeldBack:
    """A line that hangs: what the autopilot sends waits, nothing is lost, and all comes at once."""

    seconds: float

    def begin(self, world: FlightStage) -> None:
        """It hangs."""
        until_s = world.t_s + self.seconds
        world.autopilot_link.a_to_b.taps[id(self)] = lambda packet: (
            (max(until_s - world.t_s, 0.0), packet),
        )

    def end(self, world: FlightStage) -> None:
        """It goes on."""
        del world.autopilot_link.a_to_b.taps[id(self)]


@dataclass(frozen=True)
class RoundTrip:
    """Messages take longer, both ways together."""

    seconds: float

    def begin(self, world: FlightStage) -> None:
        """Longer."""
        for line in _lines(world):
            line.latency_s += 0.5 * self.seconds - LINK_LATENCY_S

    def end(self, world: FlightStage) -> None:
        """As before."""
        for line in _lines(world):
            line.latency_s -= 0.5 * self.seconds - LINK_LATENCY_S


@dataclass(frozen=True)
class SlowLine:
    """A serial line of so many bits per second; what does not fit waits in its queue."""

    baud: float

    def begin(self, world: FlightStage) -> None:
        """Slow."""
        for line in _lines(world):
            line.baud = self.baud

    def end(self, world: FlightStage) -> None:
        """As before."""
        for line in _lines(world):
            line.baud = None


class _Spoils(ABC):
    """Both lines are spoilt, each by a chance of its own."""

    seed: int

    def begin(self, world: FlightStage) -> None:
        """Spoilt."""
        for number, line in enumerate(_lines(world)):
            line.taps[id(self)] = self._tap(random.Random(self.seed + number))

    def end(self, world: FlightStage) -> None:
        """Clean."""
        for line in _lines(world):
            del line.taps[id(self)]

    @abstractmethod
    def _tap(self, rng: random.Random) -> Tap: ...


@dataclass(frozen=True)
class Garbage(_Spoils):
    """Between the packets come bytes that are none, and some packets are cut off."""

    seed: int = 11

    def _tap(self, rng: random.Random) -> Tap:
        def soil(packet: bytes) -> Iterable[tuple[float, bytes]]:
            match rng.randrange(_GARBAGE_EVERY):
                case 0:
                    return ((0.0, rng.randbytes(rng.randrange(1, _GARBAGE_BYTES))), (0.0, packet))
                case 1:
                    return ((0.0, packet[: rng.randrange(1, len(packet))]),)
            return ((0.0, packet),)

        return soil


@dataclass(frozen=True)
class PacketsLost(_Spoils):
    """So large a share of the packets is lost, both ways."""

    share: float
    seed: int = 12

    def _tap(self, rng: random.Random) -> Tap:
        return lambda packet: () if rng.random() < self.share else ((0.0, packet),)


@dataclass(frozen=True)
class Replayed:
    """Every packet of the autopilot comes a second time, later."""

    later_s: float

    def begin(self, world: FlightStage) -> None:
        """Twice."""
        world.autopilot_link.a_to_b.taps[id(self)] = lambda packet: (
            (0.0, packet),
            (self.later_s, packet),
        )

    def end(self, world: FlightStage) -> None:
        """Once."""
        del world.autopilot_link.a_to_b.taps[id(self)]


@dataclass(frozen=True)
class StationCommands(Lasting):
    """A second ground station asks the autopilot for another mode."""

    mode: FlightMode

    def begin(self, world: FlightStage) -> None:
        """One command."""
        packer = mavlink.MAVLink(None, srcSystem=_STATION[0], srcComponent=_STATION[1])
        asked = mode_command(_KINDS[world.setup.manners], self.mode)
        params = [*(value or 0.0 for value in asked.params), *(7 * [0.0])][:7]
        command = mavlink.MAVLink_command_long_message(1, 1, asked.number, 0, *params)
        world.note(f"a second station asks for {self.mode.name}")
        world.autopilot_link.b.write(bytes(command.pack(packer)))


def _lines(world: FlightStage) -> tuple[LineState, LineState]:
    """Down from the autopilot, up to it."""
    return world.autopilot_link.a_to_b, world.autopilot_link.b_to_a
