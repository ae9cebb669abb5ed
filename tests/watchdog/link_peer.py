"""A minimal autopilot on a real UDP link, by pymavlink: no physics, but identity and manners."""

import math
import socket
import threading
import time
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

PX4_HOLD, PX4_OFFBOARD, PX4_POSITION = (4 << 16) | (3 << 24), 6 << 16, 3 << 16
PX4_LAND, PX4_DESCEND, PX4_TAKEOFF = (4 << 16) | (6 << 24), (4 << 16) | (20 << 24), 0x02040000
PX4_RETURN = (4 << 16) | (5 << 24)
COPTER_GUIDED, COPTER_BRAKE, COPTER_LAND, COPTER_LOITER = 4, 17, 9, 5
PX4 = mavlink.MAV_AUTOPILOT_PX4
NEVER_BROADCAST = ("COMMAND_LONG", "PARAM_REQUEST_READ", "PARAM_SET", "SET_GPS_GLOBAL_ORIGIN")
ACCEPTED, TEMPORARILY_REJECTED, DENIED = 0, 1, 2
HIGHRES_IMU, RAW_IMU = 105, 27
ON_GROUND, IN_AIR = 1, 2


class Peer:
    """Sends telemetry to `port` (an autopilot "udpout"), answers commands, remembers all it hears.

    `rates_hz` of 0 keeps a message away. `refuse` maps command numbers to their result.
    """

    def __init__(self, port: int, kind: int = mavlink.MAV_AUTOPILOT_PX4, system_id: int = 7):
        self.system_id = system_id
        self.kind, self.custom_mode, self.armed = kind, PX4_HOLD, False
        self.flags, self.prearm, self.landed_state = 0x1FF, True, ON_GROUND
        self.pressure_hpa, self.yaw_rad, self.time_skew_s = 1008.0, 0.5, 0.0
        self.refuse: dict[int, int] = {}
        self.unknown: set[int] = set()  # messages that it cannot stream
        self.streamed: set[int] = set()
        self.params: dict[str, tuple[float, int]] = {}
        self.origin: tuple[int, int, int] | None = None
        self.keeps_origin = False
        self.heard: list[tuple[float, Any]] = []
        self.speaks, self.answers = True, True
        self.heartbeat_hz = 10.0
        self._boot_s = time.monotonic() - 100.0
        self._mav = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=1)
        self._mav.robust_parsing = True
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(0.002)
        self.to = ("127.0.0.1", port)
        self._stop = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def __enter__(self) -> "Peer":
        return self

    def __exit__(self, *_: object) -> None:
        self._stop = True
        self._thread.join()
        self.socket.close()

    def boot_s(self) -> float:
        return time.monotonic() - self._boot_s + self.time_skew_s

    def send(self, message: Any) -> None:
        self.socket.sendto(bytes(message.pack(self._mav)), self.to)

    def of(self, name: str, since_s: float = 0.0) -> list[Any]:
        return [m for t, m in list(self.heard) if m.get_type() == name and t >= since_s]

    def commands(self, number: int) -> list[Any]:
        return [m for m in self.of("COMMAND_LONG") if m.command == number]

    def _run(self) -> None:
        due = {name: 0.0 for name in ("heartbeat", "slow", "attitude")}
        while not self._stop:
            now_s = time.monotonic()
            if self.speaks:
                self._speak(now_s, due)
            try:
                data = self.socket.recv(4096)
            except (TimeoutError, ConnectionError):
                continue
            for message in self._mav.parse_buffer(data) or []:
                self.heard.append((time.monotonic(), message))
                self._answer(message)

    def _speak(self, now_s: float, due: dict[str, float]) -> None:
        if now_s >= due["heartbeat"]:
            due["heartbeat"] = now_s + 1.0 / self.heartbeat_hz
            mode = 1 | (128 if self.armed else 0)
            self.send(mavlink.MAVLink_heartbeat_message(2, self.kind, mode, self.custom_mode, 4, 3))
        if now_s >= due["attitude"]:
            due["attitude"] = now_s + 0.02
            ms = int(self.boot_s() * 1e3)
            self.send(mavlink.MAVLink_attitude_message(ms, 0.1, -0.2, self.yaw_rad, 0, 0, 0.0))
            self.send(mavlink.MAVLink_scaled_pressure_message(ms, self.pressure_hpa, 0.0, 1500))
            self._speak_of_motion(ms * 1000)
        if now_s >= due["slow"]:
            due["slow"] = now_s + 0.2
            self._speak_slowly()

    def _speak_of_motion(self, us: int) -> None:
        """At rest and level, turning right at 0.1 rad/s."""
        if HIGHRES_IMU in self.streamed:
            felt = (0.0, 0.0, -9.80665, 0.0, 0.0, 0.1)
            self.send(mavlink.MAVLink_highres_imu_message(us, *felt, *[0.0] * 7, 63))
        if RAW_IMU in self.streamed:
            self.send(mavlink.MAVLink_raw_imu_message(us, 0, 0, -1000, 0, 0, 100, 0, 0, 0))

    def _speak_slowly(self) -> None:
        health = 0x10000 | (0x10000000 if self.prearm else 0)
        self.send(
            mavlink.MAVLink_sys_status_message(health, health, health, *[0] * 3, 87, *[0] * 6)
        )
        self.send(mavlink.MAVLink_extended_sys_state_message(0, self.landed_state))
        if self.kind == mavlink.MAV_AUTOPILOT_PX4:
            us = int(self.boot_s() * 1e6)
            self.send(mavlink.MAVLink_estimator_status_message(us, self.flags, *[0.0] * 8))
        else:
            self.send(mavlink.MAVLink_ekf_status_report_message(self.flags, *[0.0] * 5))

    def _is_for_us(self, message: Any) -> bool:
        """PX4 ignores commands, parameters and origins that are broadcast; ArduPilot takes them."""
        system = getattr(message, "target_system", None)
        px4_wants_its_own = message.get_type() in NEVER_BROADCAST and self.kind == PX4
        return system in ((self.system_id,) if px4_wants_its_own else (None, 0, self.system_id))

    def _answer(self, message: Any) -> None:
        if not self._is_for_us(message) or not self.answers:
            return
        match message.get_type():
            case "COMMAND_LONG":
                self._obey(message)
            case "TIMESYNC" if message.tc1 == 0:
                self.send(mavlink.MAVLink_timesync_message(int(self.boot_s() * 1e9), message.ts1))
            case "PARAM_REQUEST_READ" | "PARAM_SET":
                self._parameter(message)
            case "SET_GPS_GLOBAL_ORIGIN":
                if not self.keeps_origin:
                    self.origin = (message.latitude, message.longitude, message.altitude)

    def _obey(self, message: Any) -> None:
        result = self.refuse.get(message.command, ACCEPTED)
        if message.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            wanted = int(message.param1)
            result = DENIED if wanted in self.unknown else result
            self.streamed |= {wanted} if result == ACCEPTED else set()
        if result == ACCEPTED and message.command == mavlink.MAV_CMD_DO_SET_MODE:
            px4 = self.kind == mavlink.MAV_AUTOPILOT_PX4
            numbers = int(message.param2), int(message.param3)
            self.custom_mode = numbers[0] << 16 | numbers[1] << 24 if px4 else numbers[0]
        if result == ACCEPTED and message.command == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
            self.armed = message.param1 == 1.0
        source = message.get_srcSystem(), message.get_srcComponent()
        self.send(mavlink.MAVLink_command_ack_message(message.command, result, 0, 0, *source))
        if message.command == mavlink.MAV_CMD_REQUEST_MESSAGE and self.origin is not None:
            self.send(mavlink.MAVLink_gps_global_origin_message(*self.origin))

    def _parameter(self, message: Any) -> None:
        name = message.param_id
        if message.get_type() == "PARAM_SET" and name in self.params:
            self.params[name] = (message.param_value, message.param_type)
        if name in self.params:
            value, kind = self.params[name]
            self.send(mavlink.MAVLink_param_value_message(name.encode(), value, kind, 1, 0))


def wait_for(condition: Callable[[], Any], timeout_s: float = 5.0) -> Any:
    """The first true value of `condition`; fails the test when none comes."""
    until_s = time.monotonic() + timeout_s
    while time.monotonic() < until_s:
        value = condition()
        if value:
            return value
        time.sleep(0.01)
    raise AssertionError(f"nothing within {timeout_s} s")


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def is_still(setpoint: Any) -> bool:
    """A setpoint of zero velocity."""
    return math.hypot(setpoint.vx, setpoint.vy, setpoint.vz) == 0.0
