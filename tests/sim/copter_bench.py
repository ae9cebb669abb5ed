"""A simulated ArduCopter with a perfect companion, by its link, as fast as it goes."""

import random
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from vwnav.sim.config import VehicleConfig
from vwnav.sim.copter.copter import SimulatedCopter
from vwnav.sim.copter.modes import Mode
from vwnav.sim.core import Peer, Role, VehicleCore
from vwnav.sim.mavlink.link import ByteLink
from vwnav.sim.memory_link import MemoryLink
from vwnav.sim.multirotor.simulated import STEP_S
from vwnav.sim.processor import SimulatedClock
from vwnav.vehicle import FlightMode

ARM, TAKEOFF, SET_MODE, SET_INTERVAL, REQUEST = 400, 22, 176, 511, 512
NOTED = (0, 1, 32, 108, 193, 245)  # messages asked for by `ask_for`


class CopterBench:
    """Vision made from the truth, setpoints, a ground station; `got` is what came back, when."""

    def __init__(self, **config: Any) -> None:
        self.clock = SimulatedClock()
        self._link = MemoryLink(self.clock, random.Random(1))
        peer = Peer(ByteLink(self._link.a, 1), Role.COMPANION)
        settings = {"home_lat_deg": 60.403, "home_lon_deg": 22.461} | config
        vehicle = VehicleConfig(manners="copter", **settings)
        self.core = VehicleCore(vehicle, [peer], self.clock)
        self._companion = mavlink.MAVLink(None, srcSystem=1, srcComponent=191)
        self._ground = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
        self._parser = mavlink.MAVLink(None)
        self.got: list[tuple[float, Any]] = []
        self.vision = False
        self.vision_jump_m = 0.0
        self.vision_wrong_m_s = 0.0
        self.reset_counter = 0
        self.velocity: tuple[float, float, float] | None = None
        self.ground_station = False
        self.channels: tuple[int, ...] | None = None
        self._steps = 0

    @property
    def vehicle(self) -> SimulatedCopter:
        assert isinstance(self.core.vehicle, SimulatedCopter)
        return self.core.vehicle

    @property
    def mode(self) -> Mode:
        return self.vehicle.commander.mode

    @property
    def t_s(self) -> float:
        return self.clock.now_s

    def send(self, message: Any, packer: Any = None) -> None:
        self._link.b.write(message.pack(packer or self._companion))

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / STEP_S)):
            self._steps += 1
            self.clock.now_s = self._steps * STEP_S
            self.core.step_to_now(2)
            while data := self._link.b.read():
                self.got += [(self.t_s, m) for m in self._parser.parse_buffer(data) or []]
            self._speak()

    def _speak(self) -> None:
        if self.vision and self._steps % 12 == 0:
            self.see()
        if self.velocity is not None and self._steps % 12 == 0:
            self.steer(self.velocity)
        if self.channels is not None and self._steps % 12 == 0:
            self.send(mavlink.MAVLink_rc_channels_override_message(1, 1, *self.channels))
        if self.ground_station and self._steps % 250 == 0:
            self.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), self._ground)

    def see(self) -> None:
        body, wrong = self.vehicle.body, self.vision_wrong_m_s
        covariance = [0.0] * 21
        covariance[0] = covariance[6] = covariance[11] = 0.04
        usec, counter = round(1e6 * self.t_s), self.reset_counter
        place = (body.n + self.vision_jump_m + wrong * self.t_s, body.e, body.d)
        self.send(
            mavlink.MAVLink_vision_position_estimate_message(
                usec, *place, 0.0, 0.0, 0.0, covariance, counter
            )
        )
        velocity = (body.vn + wrong, body.ve, body.vd)
        speeds = [0.01, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.01]
        self.send(mavlink.MAVLink_vision_speed_estimate_message(usec, *velocity, speeds, counter))

    def steer(self, velocity: tuple[float, float, float], yaw_rad: float = 0.0) -> None:
        nothing = (0.0, 0.0, 0.0)
        self.send(
            mavlink.MAVLink_set_position_target_local_ned_message(
                0, 1, 1, 1, 2503, *nothing, *velocity, *nothing, yaw_rad, 0.0
            )
        )

    def command(self, number: int, *parameters: float) -> int:
        """Its MAV_RESULT."""
        values = [*parameters, *([0.0] * (7 - len(parameters)))]
        since = len(self.got)
        self.send(mavlink.MAVLink_command_long_message(1, 1, number, 0, *values))
        self.run(0.02)
        acks = [m for _, m in self.got[since:] if m.get_type() == "COMMAND_ACK"]
        return int(acks[0].result)

    def set_mode(self, mode: Mode) -> int:
        return self.command(SET_MODE, 1.0, float(mode))

    def ask_for(self, rate_hz: float, *numbers: int) -> None:
        for number in numbers or NOTED:
            assert self.command(SET_INTERVAL, float(number), 1e6 / rate_hz) == 0

    def set_parameter(self, name: str, value: float) -> None:
        self.send(mavlink.MAVLink_param_set_message(1, 1, name.encode(), value, 9))
        self.run(0.02)

    def set_origin(self) -> None:
        config = self.vehicle.config
        place = (round(config.home_lat_deg * 1e7), round(config.home_lon_deg * 1e7))
        alt = round(1e3 * config.home_alt_amsl_m)
        self.send(mavlink.MAVLink_set_gps_global_origin_message(1, *place, alt))
        self.run(0.02)

    def get_ready(self) -> None:
        self.run(9.0)
        self.vision = True
        self.run(1.0)
        self.set_origin()
        self.run(14.0)

    def hover(self, height_m: float = 10.0) -> "CopterBench":
        """Ready, armed in GUIDED, taken off."""
        self.get_ready()
        assert self.set_mode(Mode.GUIDED) == 0
        self.run(1.1)
        assert self.command(ARM, 1.0) == 0
        assert self.command(TAKEOFF, *[0.0] * 6, height_m) == 0
        self.run(8.0 + height_m / 1.5)
        assert abs(self.vehicle.body.d + height_m) < 1.5
        return self

    def aloft(self, height_m: float = 10.0) -> "CopterBench":
        """In GUIDED in the air, at once."""
        self.run(0.2)
        place = (0.0, 0.0, -height_m)
        self.vehicle.begin_in_flight(place, (0.0, 0.0, 0.0), 0.0, FlightMode.OFFBOARD)
        self.vision = True
        self.run(1.0)
        return self

    def until(self, mode: Mode, limit_s: float) -> float:
        """Seconds until a mode is flown, `limit_s` when it is not."""
        start_s = self.t_s
        while self.mode is not mode and self.t_s - start_s < limit_s:
            self.run(0.02)
        return self.t_s - start_s

    def of(self, kind: str, since_s: float = 0.0) -> list[tuple[float, Any]]:
        return [(t_s, m) for t_s, m in self.got if m.get_type() == kind and t_s >= since_s]

    def texts(self, since_s: float = 0.0) -> list[str]:
        return [m.text for _, m in self.of("STATUSTEXT", since_s)]
