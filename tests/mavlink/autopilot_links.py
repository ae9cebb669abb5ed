"""Links for the autopilot's tests, in memory and on a simulated clock: nothing waits for real."""

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import all as mavlink

from vwnav.geometry.rotations import quat_from_rotation, rotation_from_euler
from vwnav.mavlink.autopilot import LinkedAutopilot
from vwnav.mavlink.ports.pymavlink_port import PymavlinkPort
from vwnav.types import Estimate
from vwnav.vehicle import Request

HOME = (60.403, 22.461, 40.0)
PX4, COPTER = mavlink.MAV_AUTOPILOT_PX4, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
PX4_HOLD, PX4_OFFBOARD, PX4_POSITION = (4 << 16) | (3 << 24), 6 << 16, 3 << 16
PX4_LAND, PX4_DESCEND, PX4_TAKEOFF = (4 << 16) | (6 << 24), (4 << 16) | (20 << 24), 0x02040000
COPTER_GUIDED, COPTER_BRAKE, COPTER_LAND, COPTER_LOITER = 4, 17, 9, 5
ACCEPTED, NOT_NOW, DENIED, IN_PROGRESS = 0, 1, 2, 5
ARM, TAKEOFF, SET_MODE, INTERVAL = 400, 22, 176, 511
HIGHRES_IMU, RAW_IMU = 105, 27
STEP_S = 0.01
NAMES_A_TARGET = ("COMMAND_LONG", "PARAM_REQUEST_READ", "PARAM_SET", "SET_GPS_GLOBAL_ORIGIN")


@contextmanager
def stepped(autopilot: LinkedAutopilot) -> Iterator[None]:
    """Step it in real time, as a flight does."""
    over = threading.Event()

    def run() -> None:
        while not over.wait(0.02):
            autopilot.step(time.monotonic())

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    yield
    over.set()
    thread.join()


class Clock:
    """Simulated seconds."""

    def __init__(self) -> None:
        self.t_s = 1000.0

    def __call__(self) -> float:
        return self.t_s


@dataclass
class Way:
    """One direction: bytes arrive `delay_s` later, in order, unless it is cut.

    A line of `baud` carries one byte after the other.
    """

    clock: Clock
    delay_s: float = 0.0
    baud: float = math.inf
    cut: bool = False
    written: int = 0
    free_s: float = 0.0
    _flying: deque[tuple[float, bytes]] = field(default_factory=deque)

    def write(self, data: bytes) -> None:
        self.written += len(data)
        if not self.cut:
            self.free_s = max(self.free_s, self.clock()) + 10.0 * len(data) / self.baud
            self._flying.append((self.free_s + self.delay_s, data))

    def read(self) -> bytes:
        if self._flying and self._flying[0][0] <= self.clock():
            return self._flying.popleft()[1]
        return b""


@dataclass
class End:
    """The driver's end of the link."""

    inward: Way
    outward: Way
    closed: bool = False

    def fileno(self) -> int:
        return -1

    def read(self) -> bytes:
        return self.inward.read()

    def write(self, data: bytes) -> None:
        if not self.closed:
            self.outward.write(data)

    def close(self) -> None:
        self.closed = True


class Scripted:
    """An autopilot without physics: identity, manners, and what a test wants it to say.

    `refuse` maps command numbers to results, `deaf` holds those that get no answer.
    """

    def __init__(self, clock: Clock, to: Way, kind: int, system_id: int = 7) -> None:
        self.clock, self.to, self.kind, self.system_id = clock, to, kind, system_id
        self.custom_mode = PX4_HOLD if kind == PX4 else 0
        self.intended_mode: int | None = None
        self.armed, self.prearm, self.landed_state, self.system_status = False, True, 1, 3
        self.flags = 0x1FF if kind == PX4 else 0x33F
        self.pressure_hpa, self.yaw_rad = 1008.0, 0.5
        self.boot_at_s, self.rate = clock() - 100.0, 1.0
        self.refuse: dict[int, int] = {}
        self.deaf: set[int] = set()
        self.unknown: set[int] = set()
        self.intervals_us: dict[int, float] = {}
        self.params: dict[str, tuple[float, int]] = {"MIS_TAKEOFF_ALT": (2.5, 9)}
        self.origin: tuple[int, int, int] | None = None
        self.keeps_origin = False
        self.heard: list[tuple[float, Any]] = []
        self.speaks, self.chatters, self.radio = True, False, True
        self.heartbeat_hz = 5.0
        self.mav = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=1)
        self.mav.robust_parsing = True
        self._due: dict[str, float] = {}
        self._setpoint_s = -math.inf

    def boot_s(self) -> float:
        return (self.clock() - self.boot_at_s) * self.rate

    def send(self, message: Any, mav: Any = None) -> None:
        self.to.write(bytes(message.pack(mav or self.mav)))

    def of(self, name: str) -> list[Any]:
        return [m for _, m in self.heard if m.get_type() == name]

    def commands(self, number: int) -> list[Any]:
        return [m for m in self.of("COMMAND_LONG") if m.command == number]

    def say(self, text: str, severity: int = 4) -> None:
        self.send(mavlink.MAVLink_statustext_message(severity, text.encode()))

    def step(self, data: bytes) -> None:
        for message in self.mav.parse_buffer(data) or []:
            self.heard.append((self.clock(), message))
            self._answer(message)
        if self.speaks:
            self._speak()

    def beat(self, system_id: int = 0, custom_mode: int | None = None) -> None:
        """A heartbeat now; of another aircraft when `system_id` is given."""
        mode = self.custom_mode if custom_mode is None else custom_mode
        flags = 1 | (128 if self.armed else 0)
        other = mavlink.MAVLink(None, srcSystem=system_id or self.system_id, srcComponent=1)
        status = self.system_status
        beat = mavlink.MAVLink_heartbeat_message(2, self.kind, flags, mode, status, 3)
        self.send(beat, other)

    def rate_hz(self, number: int) -> float:
        """As asked for, or its own."""
        return 1e6 / self.intervals_us.get(number, 20_000.0)

    def _is_due(self, name: str, rate_hz: float) -> bool:
        if self.clock() < self._due.get(name, -math.inf) - 1e-6:
            return False
        self._due[name] = self.clock() + 1.0 / rate_hz
        return True

    def _speak(self) -> None:
        if self._is_due("heartbeat", self.heartbeat_hz):
            self.beat()
        ms = int(self.boot_s() * 1e3)
        if self._is_due("attitude", self.rate_hz(30)):
            self.send(mavlink.MAVLink_attitude_message(ms, 0.1, -0.2, self.yaw_rad, 0, 0, 0.0))
        if self._is_due("pressure", self.rate_hz(29)):
            self.send(mavlink.MAVLink_scaled_pressure_message(ms, self.pressure_hpa, 0.0, 1500))
        if self._is_due("motion", self.rate_hz(HIGHRES_IMU)):
            self._speak_of_motion(ms * 1000)
        if self.chatters and self.intervals_us.get(331) != -1.0 and self._is_due("chatter", 30.0):
            self.send(
                mavlink.MAVLink_odometry_message(
                    0, 1, 8, *[0.1] * 3, [1, 0, 0, 0], *[0.1] * 6, [0.1] * 21, [0.1] * 21
                )
            )
        if 436 in self.intervals_us and self._is_due("mode", 10.0):
            asked = self.custom_mode if self.intended_mode is None else self.intended_mode
            self.send(mavlink.MAVLink_current_mode_message(0, self.custom_mode, asked))
        if self._is_due("slow", 5.0):
            self._speak_slowly()

    def _speak_of_motion(self, us: int) -> None:
        """Feels gravity where the attitude has it, turning right at 0.1 rad/s."""
        if HIGHRES_IMU in self.intervals_us:
            felt = rotation_from_euler(0.1, -0.2, 0.0).T @ [0.0, 0.0, -9.80665]
            self.send(mavlink.MAVLink_highres_imu_message(us, *felt, 0, 0, 0.1, *[0.0] * 7, 63))
        if RAW_IMU in self.intervals_us:
            felt = rotation_from_euler(0.1, -0.2, 0.0).T @ [0.0, 0.0, -1000.0]
            milli_g = [round(v) for v in felt]
            self.send(mavlink.MAVLink_raw_imu_message(us, *milli_g, 0, 0, 100, 0, 0, 0))

    def _speak_slowly(self) -> None:
        health = (0x10000 if self.radio else 0) | (0x10000000 if self.prearm else 0)
        self.send(
            mavlink.MAVLink_sys_status_message(health, health, health, *[0] * 3, 87, *[0] * 6)
        )
        self.send(mavlink.MAVLink_extended_sys_state_message(0, self.landed_state))
        if self.kind == PX4:
            us = int(self.boot_s() * 1e6)
            self.send(mavlink.MAVLink_estimator_status_message(us, self.flags, *[0.0] * 8))
        else:
            self.send(mavlink.MAVLink_ekf_status_report_message(self.flags, *[0.0] * 5))

    def _is_for_us(self, message: Any) -> bool:
        """PX4 ignores commands, parameters and origins that are broadcast; ArduPilot takes them."""
        system = getattr(message, "target_system", None)
        own_only = message.get_type() in NAMES_A_TARGET and self.kind == PX4
        return system in ((self.system_id,) if own_only else (None, 0, self.system_id))

    def _answer(self, message: Any) -> None:
        if not self._is_for_us(message):
            return
        match message.get_type():
            case "COMMAND_LONG":
                self._obey(message)
            case "SET_POSITION_TARGET_LOCAL_NED":
                self._setpoint_s = self.clock()
            case "TIMESYNC" if message.tc1 == 0:
                self.send(mavlink.MAVLink_timesync_message(int(self.boot_s() * 1e9), message.ts1))
            case "PARAM_REQUEST_READ" | "PARAM_SET":
                self._parameter(message)
            case "SET_GPS_GLOBAL_ORIGIN":
                if not self.keeps_origin:
                    self.origin = (message.latitude, message.longitude, message.altitude)

    def _obey(self, message: Any) -> None:
        result = self.refuse.get(message.command, ACCEPTED)
        if message.command == INTERVAL:
            wanted = int(message.param1)
            result = DENIED if wanted in self.unknown else result
            if result == ACCEPTED:
                self.intervals_us[wanted] = message.param2
        if result == ACCEPTED and message.command == SET_MODE:
            result = self._set_mode(message)
        if result == ACCEPTED and message.command == ARM:
            self.armed = message.param1 == 1.0
        if result == ACCEPTED and message.command == TAKEOFF and self.kind == PX4:
            self.custom_mode = PX4_TAKEOFF
        if message.command not in self.deaf:
            self.acknowledge(message, result)
        if message.command == 512 and self.origin is not None:
            self.send(mavlink.MAVLink_gps_global_origin_message(*self.origin))

    def acknowledge(self, message: Any, result: int) -> None:
        source = message.get_srcSystem(), message.get_srcComponent()
        self.send(mavlink.MAVLink_command_ack_message(message.command, result, 0, 0, *source))

    def _set_mode(self, message: Any) -> int:
        numbers = int(message.param2), int(message.param3)
        mode = numbers[0] << 16 | numbers[1] << 24 if self.kind == PX4 else numbers[0]
        if mode == PX4_OFFBOARD and self.clock() - self._setpoint_s > 0.5:
            return NOT_NOW
        self.custom_mode = mode
        return ACCEPTED

    def _parameter(self, message: Any) -> None:
        name = message.param_id
        if message.get_type() == "PARAM_SET" and name in self.params:
            self.params[name] = (message.param_value, message.param_type)
        if name in self.params:
            value, kind = self.params[name]
            self.send(mavlink.MAVLink_param_value_message(name.encode(), value, kind, 1, 0))


class Bench:
    """An autopilot, the driver, and the link between them."""

    def __init__(
        self,
        kind: int = PX4,
        round_trip_s: float = 0.004,
        settle_s: float = 2.5,
        baud: float = math.inf,
    ) -> None:
        self.clock = Clock()
        self.down = Way(self.clock, round_trip_s / 2.0, baud)  # to the driver
        self.up = Way(self.clock, round_trip_s / 2.0, baud)
        self.peer = Scripted(self.clock, self.down, kind)
        self.port = PymavlinkPort(End(self.down, self.up), self.clock)
        capacity_bytes_s = baud / 10.0 if math.isfinite(baud) else None
        self.autopilot = LinkedAutopilot(self.port, self.clock, capacity_bytes_s)
        self.peer.chatters = capacity_bytes_s is not None
        self.run(settle_s + 2.0 * round_trip_s)

    def run(self, seconds: float, until: Callable[[], Any] = lambda: False) -> Any:
        """Let time pass, the link stepped at 50 Hz; stops early with the value of `until`."""
        for i in range(round(seconds / STEP_S)):
            self.clock.t_s += STEP_S
            self.peer.step(b"".join(iter(self.up.read, b"")))
            self.port.poll()
            if i % 2 == 0:
                self.autopilot.step(self.clock())
            if value := until():
                return value
        return None

    def wait(self, until: Callable[[], Any], seconds: float = 5.0) -> Any:
        """The first true value; fails the test when none comes."""
        value = self.run(seconds, until)
        assert value, f"nothing within {seconds} s"
        return value

    def finish(self, request: Request, seconds: float = 10.0) -> str | None:
        """Its outcome."""
        self.wait(lambda: request.done, seconds)
        return request.refused

    def has_origin(self) -> None:
        self.peer.heard.clear()
        self.autopilot.set_origin(*HOME)
        self.autopilot.send_estimate(self.estimate())
        self.run(0.1)
        assert not self.peer.of("VISION_POSITION_ESTIMATE"), "sent before the origin is agreed upon"
        self.wait(lambda: self.offset_ned_m() is not None)

    def offset_ned_m(self) -> Any:
        return self.autopilot._telemetry.origin_offset_ned_m

    def estimate(self, yaw_rad: float = 0.0) -> Estimate:
        covariance = np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
        quat = quat_from_rotation(rotation_from_euler(0.1, -0.2, yaw_rad))
        velocity, position = np.array([4.0, 5.0, -6.0]), np.array([10.0, -20.0, -30.0])
        now_s = self.clock()
        return Estimate(now_s, position, velocity, covariance, quat, 0.1, 30.0, 1.0, 1.0, 258)
