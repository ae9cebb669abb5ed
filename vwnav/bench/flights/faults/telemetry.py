"""Faults of the autopilot's telemetry: altered, late or missing on its way to the watchdog."""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import all as mavlink

from vwnav.bench.flights.stage import LINK_LATENCY_S, FlightStage
from vwnav.sim.memory_link import Tap

SYS_STATUS, ATTITUDE, ATTITUDE_QUATERNION = 1, 30, 31
HIGHRES_IMU, TIMESYNC, BATTERY_STATUS = 105, 111, 147
_ATTITUDES = (ATTITUDE, ATTITUDE_QUATERNION)


@dataclass(frozen=True)
class TelemetryLate:
    """Messages of some kinds are late; () means all of them."""

    seconds: float
    numbers: tuple[int, ...] = ()

    def begin(self, world: FlightStage) -> None:
        """Late."""
        if not self.numbers:
            world.autopilot_link.a_to_b.latency_s += self.seconds - LINK_LATENCY_S
        else:
            world.autopilot_link.a_to_b.taps[id(self)] = lambda packet: (
                (self.seconds if number_of(packet) in self.numbers else 0.0, packet),
            )

    def end(self, world: FlightStage) -> None:
        """As before."""
        if not self.numbers:
            world.autopilot_link.a_to_b.latency_s -= self.seconds - LINK_LATENCY_S
        else:
            del world.autopilot_link.a_to_b.taps[id(self)]


@dataclass(frozen=True)
class Missing:
    """Messages of some kinds do not come."""

    numbers: tuple[int, ...] = _ATTITUDES

    def begin(self, world: FlightStage) -> None:
        """They are dropped."""
        world.autopilot_link.a_to_b.taps[id(self)] = self._drop

    def end(self, world: FlightStage) -> None:
        """They come."""
        del world.autopilot_link.a_to_b.taps[id(self)]

    def _drop(self, packet: bytes) -> Iterable[tuple[float, bytes]]:
        return () if number_of(packet) in self.numbers else ((0.0, packet),)


@dataclass(frozen=True)
class Doubled:
    """Messages of some kinds come twice."""

    numbers: tuple[int, ...]

    def begin(self, world: FlightStage) -> None:
        """Twice."""
        world.autopilot_link.a_to_b.taps[id(self)] = self._double

    def end(self, world: FlightStage) -> None:
        """Once."""
        del world.autopilot_link.a_to_b.taps[id(self)]

    def _double(self, packet: bytes) -> Iterable[tuple[float, bytes]]:
        return ((0.0, packet),) * (2 if number_of(packet) in self.numbers else 1)


@dataclass(frozen=True)
class Altered:
    """Messages of some kinds say something else: `change` is handed each of them.

    Attributes:
        what: in words.
    """

    what: str
    numbers: tuple[int, ...]
    change: Callable[[Any], None]

    def begin(self, world: FlightStage) -> None:
        """They are altered."""
        world.autopilot_link.a_to_b.taps[id(self)] = altering(self.numbers, self.change)

    def end(self, world: FlightStage) -> None:
        """They are right."""
        del world.autopilot_link.a_to_b.taps[id(self)]

    def __str__(self) -> str:
        return self.what


def level() -> Altered:
    """Attitudes say level, and north."""

    def change(message: Any) -> None:
        message.roll = message.pitch = message.yaw = 0.0

    return Altered("attitude level and north", (ATTITUDE,), change)


def not_a_number() -> Altered:
    """Attitudes are NaN."""

    def change(message: Any) -> None:
        message.roll = message.pitch = message.yaw = math.nan

    return Altered("attitude not a number", (ATTITUDE,), change)


def turned(yaw_rad: float) -> Altered:
    """Headings are off by so much."""

    def change(message: Any) -> None:
        message.yaw = math.remainder(message.yaw + yaw_rad, math.tau)

    return Altered(f"heading {math.degrees(yaw_rad):.0f} degrees off", (ATTITUDE,), change)


def imu_on_its_side() -> Altered:
    """The IMU is mounted a quarter turn about forward: its right is down, and not set up so."""

    def change(message: Any) -> None:
        message.yacc, message.zacc = message.zacc, -message.yacc
        message.ygyro, message.zgyro = message.zgyro, -message.ygyro

    return Altered("IMU mounted on its side", (HIGHRES_IMU,), change)


def accelerometer_off(forward_m_s2: float, right_m_s2: float, down_m_s2: float) -> Altered:
    """The accelerometer tells so much more than it feels, in the body's axes."""

    def change(message: Any) -> None:
        message.xacc += forward_m_s2
        message.yacc += right_m_s2
        message.zacc += down_m_s2

    return Altered("accelerometer off", (HIGHRES_IMU,), change)


def imu_shaken(accelerometer_m_s2: float, gyro_rad_s: float) -> Altered:
    """A propeller out of balance: one sigma of what each reading is off by, on each axis."""
    rng = np.random.default_rng(6)

    def change(message: Any) -> None:
        for axis in "xyz":
            for name, sigma in (("acc", accelerometer_m_s2), ("gyro", gyro_rad_s)):
                shaken = getattr(message, axis + name) + rng.normal(0.0, sigma)
                setattr(message, axis + name, shaken)

    return Altered("IMU shaken", (HIGHRES_IMU,), change)


def battery_unknown() -> Altered:
    """The autopilot does not know its battery's charge."""

    def change(message: Any) -> None:
        message.battery_remaining = -1

    return Altered("charge not known", (SYS_STATUS, BATTERY_STATUS), change)


@dataclass(frozen=True)
class BootClockJumps:
    """The autopilot's clock, as all its messages carry it, begins at zero again."""

    def begin(self, world: FlightStage) -> None:
        """From now on."""
        lost_s = world.core.vehicle.t_s
        link = world.autopilot_link
        link.a_to_b.taps[id(self)] = altering(None, lambda message: _set_back(message, lost_s))
        link.b_to_a.taps[id(self)] = altering(
            (TIMESYNC,), lambda message: _set_forward(message, lost_s)
        )

    def end(self, world: FlightStage) -> None:
        """It counts on."""
        del world.autopilot_link.a_to_b.taps[id(self)]
        del world.autopilot_link.b_to_a.taps[id(self)]


def _set_back(message: Any, by_s: float) -> None:
    """Times of the autopilot in what it says."""
    if message.get_msgId() == TIMESYNC:
        if message.tc1:  # an answer: ts1 is the asker's
            message.tc1 = max(1, message.tc1 - round(by_s * 1e9))
        else:
            message.ts1 = max(0, message.ts1 - round(by_s * 1e9))
    if hasattr(message, "time_boot_ms"):
        message.time_boot_ms = max(0, message.time_boot_ms - round(by_s * 1e3))
    if hasattr(message, "time_usec"):
        message.time_usec = max(0, message.time_usec - round(by_s * 1e6))


def _set_forward(message: Any, by_s: float) -> None:
    """The autopilot's own time in an answer to it."""
    if message.tc1:
        message.ts1 += round(by_s * 1e9)


def altering(numbers: tuple[int, ...] | None, change: Callable[[Any], None]) -> Tap:
    """Hands `change` the messages of these kinds, None: of all, and sends what is left of them."""
    parser = mavlink.MAVLink(None)

    def alter(packet: bytes) -> Iterable[tuple[float, bytes]]:
        if numbers is not None and number_of(packet) not in numbers:
            return ((0.0, packet),)
        message = parser.decode(bytearray(packet))
        change(message)
        packer = mavlink.MAVLink(None, srcSystem=packet[5], srcComponent=packet[6])
        packer.seq = packet[4]
        return ((0.0, bytes(message.pack(packer))),)

    return alter


def number_of(packet: bytes) -> int:
    """Of a MAVLink 2 packet."""
    return int.from_bytes(packet[7:10], "little")
