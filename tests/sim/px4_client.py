"""A companion computer in a few lines: pymavlink over UDP, vision made from the truth."""

import math
import socket
import threading
import time
from collections import Counter
from typing import Any

from pymavlink.dialects.v20 import development as mavlink

from vwnav.geometry.geodesy import LocalFrame
from vwnav.sim.truth import TruthReader
from vwnav.sim.vehicle import VehicleConfig, VehicleProcess, start_vehicle


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def make_config(**changes: Any) -> VehicleConfig:
    """Free ports, no ground station, four times real time unless told otherwise."""
    settings: dict[str, Any] = {
        "companion_url": f"udpout:127.0.0.1:{free_port()}",
        "ground_url": "",
        "truth_url": f"udpin:127.0.0.1:{free_port()}",
        "speed": 4.0,
    }
    return VehicleConfig(**(settings | changes))


class Companion:
    """Hears the vehicle, sends vision at 30 Hz and setpoints at 20 Hz of simulated time."""

    def __init__(self, config: VehicleConfig, mav_type: int = 18) -> None:
        self.config = config
        self._type = mav_type
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        host, port = config.companion_url.rsplit(":", 2)[1:]
        self._socket.bind((host, int(port)))
        self._socket.settimeout(0.005)
        self._mav = mavlink.MAVLink(None, srcSystem=config.system_id, srcComponent=191)
        self._mav.robust_parsing = True
        self.peer: Any = None
        self._lock = threading.Lock()
        self.latest: dict[str, Any] = {}
        self.count: Counter[str] = Counter()
        self.acks: list[Any] = []
        self.modes: list[tuple[float, int, int]] = []
        self.texts: list[str] = []
        self.vision = False
        self.setpoint: tuple[float, float, float, float] | None = None
        self.pitch: int | None = None
        self.truth = TruthReader(config.truth_url.replace("udpin", "udpout"), 50.0)
        self._frame = LocalFrame(config.home_lat_deg, config.home_lon_deg, config.home_alt_amsl_m)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    @property
    def t_s(self) -> float:
        """The vehicle's time."""
        message = self.latest.get("ATTITUDE")
        return 0.0 if message is None else message.time_boot_ms * 1e-3

    def _run(self) -> None:
        due = dict.fromkeys(("heartbeat", "vision", "setpoint", "sticks"), 0.0)
        periods = {"heartbeat": 1.0, "vision": 1 / 30, "setpoint": 1 / 20, "sticks": 1 / 25}
        while not self._stop.is_set():
            self._receive()
            now = time.monotonic() * self.config.speed
            for name, when in due.items():
                if now >= when and self.peer is not None:
                    due[name] = max(when + periods[name], now)
                    getattr(self, f"_send_{name}")()

    def _receive(self) -> None:
        try:
            data, self.peer = self._socket.recvfrom(65536)
        except TimeoutError:
            return
        for message in self._mav.parse_buffer(data) or []:
            kind = message.get_type()
            self.latest[kind] = message
            self.count[kind] += 1
            if kind == "COMMAND_ACK":
                self.acks.append(message)
            elif kind == "STATUSTEXT":
                self.texts.append(message.text)
            elif kind == "HEARTBEAT":
                mode = message.custom_mode
                self.modes.append((self.t_s, mode >> 16 & 255, mode >> 24))

    def send(self, message: Any) -> None:
        with self._lock:
            packet = message.pack(self._mav)
            self._mav.seq = (self._mav.seq + 1) % 256
        self._socket.sendto(packet, self.peer)

    def send_raw(self, data: bytes) -> None:
        self._socket.sendto(data, self.peer)

    def _send_heartbeat(self) -> None:
        self.send(mavlink.MAVLink_heartbeat_message(self._type, 8, 0, 0, 4, 3))

    def _send_vision(self) -> None:
        state = self.truth.latest()
        if self.vision and state is not None:
            ned = self._frame.to_ned(state.lat_deg, state.lon_deg, state.alt_amsl_m)
            self.send_vision(*(float(v) for v in ned))

    def send_vision(self, n: float, e: float, d: float, reset_counter: int = 0) -> None:
        covariance = [0.0] * 21
        covariance[0] = covariance[6] = covariance[11] = 0.25
        nothing = (math.nan, math.nan, math.nan)
        usec = time.time_ns() // 1000
        self.send(
            mavlink.MAVLink_vision_position_estimate_message(
                usec, n, e, d, *nothing, covariance, reset_counter
            )
        )

    def _send_setpoint(self) -> None:
        if self.setpoint is None:
            return
        vn, ve, vd, yaw = self.setpoint
        target = (self.config.system_id, 1)
        self.send(
            mavlink.MAVLink_set_position_target_local_ned_message(
                0, *target, 1, 2503, 0, 0, 0, vn, ve, vd, 0, 0, 0, yaw, 0
            )
        )

    def _send_sticks(self) -> None:
        if self.pitch is not None:
            self.send(mavlink.MAVLink_manual_control_message(1, self.pitch, 0, 500, 0, 0))

    def command(self, number: int, *parameters: float, timeout_s: float = 3.0) -> int:
        """Send a COMMAND_LONG, three times without an answer; its MAV_RESULT, -1 for none."""
        before, me = len(self.acks), self.config.system_id
        values = [*parameters, *([math.nan] * (7 - len(parameters)))]
        for again in range(3):
            self.send(mavlink.MAVLink_command_long_message(me, 1, number, again, *values))
            end = time.monotonic() + timeout_s
            while time.monotonic() < end:
                for ack in self.acks[before:]:
                    if ack.command == number:
                        return int(ack.result)
                time.sleep(0.002)
        return -1

    def set_origin(self) -> None:
        lat, lon = self.config.home_lat_deg * 1e7, self.config.home_lon_deg * 1e7
        alt = self.config.home_alt_amsl_m * 1e3
        self.send(
            mavlink.MAVLink_set_gps_global_origin_message(
                self.config.system_id, round(lat), round(lon), round(alt)
            )
        )

    def mode(self) -> tuple[int, int]:
        custom = self.latest["HEARTBEAT"].custom_mode
        return custom >> 16 & 255, custom >> 24

    def set_mode(self, main: int, sub: int = 0) -> int:
        return self.command(176, 1, main, sub)

    def wait(self, condition: Any, timeout_s: float) -> bool:
        """Wait simulated seconds for a condition."""
        end = time.monotonic() + timeout_s / self.config.speed
        while time.monotonic() < end:
            if condition(self):
                return True
            time.sleep(0.005)
        return False

    def sleep(self, seconds: float) -> None:
        """Let simulated seconds pass."""
        time.sleep(seconds / self.config.speed)

    def get_ready(self) -> bool:
        """Origin, vision, and a prearm check that has been good for a while."""
        self.wait(lambda c: "ATTITUDE" in c.latest, 20.0)
        self.set_origin()
        self.wait(lambda c: "GPS_GLOBAL_ORIGIN" in c.latest, 5.0)
        self.vision = True
        self.sleep(14.0)
        return self.wait(lambda c: c.armable, 10.0)

    @property
    def armable(self) -> bool:
        status = self.latest.get("SYS_STATUS")
        return status is not None and bool(status.onboard_control_sensors_health & 0x10000000)

    @property
    def armed(self) -> bool:
        return bool(self.latest["HEARTBEAT"].base_mode & 128)

    def take_off(self, height_m: float = 10.0) -> bool:
        """Ready, arm, take off, hold."""
        self.get_ready()
        self.set_parameter("MIS_TAKEOFF_ALT", height_m)
        return (
            self.command(400, 1) == 0
            and self.command(22) == 0
            and self.wait(lambda c: c.mode() == (4, 2), 5.0)
            and self.wait(lambda c: c.mode() == (4, 3), 30.0)
        )

    def fly_offboard(self, velocity: tuple[float, float, float]) -> int:
        """Stream a setpoint and ask for Offboard."""
        self.setpoint = (*velocity, 0.0)
        self.sleep(1.0)
        return self.set_mode(6)

    def set_parameter(self, name: str, value: float) -> None:
        self.send(
            mavlink.MAVLink_param_set_message(self.config.system_id, 1, name.encode(), value, 9)
        )
        self.sleep(0.2)

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.truth.close()
        self._socket.close()


class Flight:
    """A vehicle and its companion, both stopped at the end."""

    def __init__(self, mav_type: int = 18, **changes: Any) -> None:
        self.config = make_config(**changes)
        self._mav_type = mav_type

    def __enter__(self) -> Companion:
        self._vehicle: VehicleProcess = start_vehicle(self.config)
        self._companion = Companion(self.config, self._mav_type)
        return self._companion

    def __exit__(self, *_: object) -> None:
        self._companion.close()
        self._vehicle.stop()
