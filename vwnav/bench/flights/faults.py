"""What can break in a flight: each fault changes the world for a while, and puts it back."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from pymavlink.dialects.v20 import development as mavlink

from vwnav.bench.flights.world import World
from vwnav.errors import SourceError
from vwnav.sim.memory_link import Tap
from vwnav.types import Frame

_ATTITUDE, _HIGHRES_IMU = 30, 105
_ATTITUDES = (_ATTITUDE, 31)


class Fault(Protocol):
    """One thing that breaks."""

    def begin(self, world: World) -> None:
        """It breaks."""
        ...

    def end(self, world: World) -> None:
        """It works again."""
        ...


# ---- the link


@dataclass(frozen=True)
class LinkCut:
    """Nothing passes between autopilot and watchdog, either way."""

    def begin(self, world: World) -> None:
        """Cut."""
        world.autopilot_link.cut(True)

    def end(self, world: World) -> None:
        """Joined."""
        world.autopilot_link.cut(False)


@dataclass(frozen=True)
class RoundTrip:
    """Messages take longer, both ways together."""

    seconds: float

    def begin(self, world: World) -> None:
        """Longer."""
        for line in (world.autopilot_link.a_to_b, world.autopilot_link.b_to_a):
            line.latency_s = 0.5 * self.seconds

    def end(self, world: World) -> None:
        """As before."""
        RoundTrip(0.004).begin(world)


# ---- telemetry: altered on its way to the watchdog


@dataclass(frozen=True)
class TelemetryLate:
    """Everything from the autopilot is late."""

    seconds: float

    def begin(self, world: World) -> None:
        """Late."""
        world.autopilot_link.a_to_b.latency_s = self.seconds

    def end(self, world: World) -> None:
        """As before."""
        world.autopilot_link.a_to_b.latency_s = 0.002


@dataclass(frozen=True)
class Missing:
    """Messages of some kinds do not come."""

    numbers: tuple[int, ...] = _ATTITUDES

    def begin(self, world: World) -> None:
        """They are dropped."""
        world.autopilot_link.a_to_b.tap = self._drop

    def end(self, world: World) -> None:
        """They come."""
        world.autopilot_link.a_to_b.tap = None

    def _drop(self, packet: bytes) -> Iterable[tuple[float, bytes]]:
        return () if _number(packet) in self.numbers else ((0.0, packet),)


@dataclass(frozen=True)
class WrongAttitude:
    """Attitudes say something else: `level` and north, not a number, or turned by `turned_rad`."""

    level: bool = False
    nan: bool = False
    turned_rad: float = 0.0

    def begin(self, world: World) -> None:
        """They are altered."""
        world.autopilot_link.a_to_b.tap = self._tap()

    def end(self, world: World) -> None:
        """They are right."""
        world.autopilot_link.a_to_b.tap = None

    def _tap(self) -> Tap:
        parser = mavlink.MAVLink(None)

        def alter(packet: bytes) -> Iterable[tuple[float, bytes]]:
            if _number(packet) != _ATTITUDE:
                return ((0.0, packet),)
            message = parser.decode(bytearray(packet))
            if self.level:
                message.roll = message.pitch = message.yaw = 0.0
            if self.nan:
                message.roll = message.pitch = message.yaw = float("nan")
            message.yaw += self.turned_rad
            packer = mavlink.MAVLink(None, srcSystem=packet[5], srcComponent=packet[6])
            packer.seq = packet[4]
            return ((0.0, bytes(message.pack(packer))),)

        return alter


@dataclass(frozen=True)
class BarometerWrong:
    """The pressure at the port is off, for the autopilot as for us."""

    metres: float

    def begin(self, world: World) -> None:
        """A gust."""
        world.core.vehicle.sensors.baro_error_m = self.metres

    def end(self, world: World) -> None:
        """Calm."""
        world.core.vehicle.sensors.baro_error_m = 0.0


# ---- the camera


@dataclass(frozen=True)
class CameraTrouble:
    """Pictures are not what they should be: see the functions below."""

    make: Callable[[], Callable[[Frame], Frame | None]]

    def begin(self, world: World) -> None:
        """Trouble."""
        world.camera.trouble = self.make()

    def end(self, world: World) -> None:
        """None."""
        world.camera.trouble = None


def no_pictures() -> Callable[[Frame], Frame | None]:
    """Nothing comes."""
    return lambda frame: None


def raising() -> Callable[[Frame], Frame | None]:
    """The driver raises."""

    def fail(frame: Frame) -> Frame | None:
        raise SourceError("cannot read from /dev/video0: No such device")

    return fail


def black() -> Callable[[Frame], Frame | None]:
    """Lens covered: the sensor's noise is all there is."""
    rng = np.random.default_rng(5)

    def cover(frame: Frame) -> Frame | None:
        dark = rng.normal(3.0, 1.5, frame.image.shape)
        return replace(frame, image=np.clip(np.round(dark), 0, 255).astype(np.uint8))

    return cover


def frozen() -> Callable[[Frame], Frame | None]:
    """The same picture again and again, with new times."""
    kept: list[Frame] = []

    def freeze(frame: Frame) -> Frame | None:
        kept.append(frame)
        return replace(frame, image=kept[0].image)

    return freeze


# ---- the navigator's computer


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
        if world.watchdog is not None:
            world.watchdog.handle_navigator_end(world.clock.now_s)

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
class DiskFull:
    """Nothing can be recorded."""

    def begin(self, world: World) -> None:
        """Full."""
        world.navigator.record.disk_full = True

    def end(self, world: World) -> None:
        """Room again."""
        world.navigator.record.disk_full = False


# ---- the aircraft and its pilot


@dataclass(frozen=True)
class BatteryAt:
    """The charge falls to so much at once."""

    ratio: float

    def begin(self, world: World) -> None:
        """A cell fails."""
        world.core.vehicle.battery.remaining = self.ratio

    def end(self, world: World) -> None:
        """It does not recover."""


@dataclass(frozen=True)
class PilotSwitches:
    """The pilot flips the mode switch to Position, Loiter on ArduCopter, and flies."""

    def begin(self, world: World) -> None:
        """Flipped."""
        vehicle = world.core.vehicle
        vehicle.pilot.plan = replace(vehicle.pilot.plan, switch_at_s=vehicle.t_s)
        world.note("pilot switches")

    def end(self, world: World) -> None:
        """It stays."""


@dataclass(frozen=True)
class CommandRefused:
    """The autopilot refuses a command (its MAV_CMD number)."""

    number: int

    def begin(self, world: World) -> None:
        """Refused from now on."""
        world.core.vehicle.refuses.add(self.number)

    def end(self, world: World) -> None:
        """Taken again."""
        world.core.vehicle.refuses.discard(self.number)


def _number(packet: bytes) -> int:
    """Of a MAVLink 2 packet."""
    return int.from_bytes(packet[7:10], "little")
