"""What all simulated autopilots share: an airframe in the wind, its sensors, and who hears it."""

import math
import random
from abc import ABC, abstractmethod
from collections import deque
from typing import Protocol

from vwnav.geometry.geodesy import LocalFrame
from vwnav.sim.config import VehicleConfig
from vwnav.sim.home import HomePosition
from vwnav.sim.mavlink.command import Severity
from vwnav.sim.multirotor.airframe import Airframe
from vwnav.sim.multirotor.controller import Controller, attitude_of_force
from vwnav.sim.multirotor.inertial_filter import InertialFilter
from vwnav.sim.multirotor.sensors import OF_SIH_1_16, QUIET, Imu, Sensors
from vwnav.sim.multirotor.wind import Wind
from vwnav.sim.scripted_pilot import ScriptedPilot

STEP_S = 0.004
_SLOW_EVERY = 5  # 50 Hz: what decides, barometer, compass, wind
_AGES_S = 1e4  # after which gusts are what they are, whatever they were


class Charge(Protocol):
    """A battery: what is left in it, 0 to 1."""

    remaining: float


class SimulatedMultirotor(ABC):
    """State of the vehicle; `step` advances it by 4 ms, MAVLink reads and commands it.

    Args:
        config: where it stands and what goes wrong.
        drag_per_s: of its airframe.
        texts: so many are kept.

    Attributes:
        refuses: numbers of commands that it does not take, whatever the reason.
        gcs_heard_s: when a ground station was, None before.
    """

    estimator: InertialFilter
    controller: Controller
    pilot: ScriptedPilot
    battery: Charge

    def __init__(self, config: VehicleConfig, drag_per_s: float, texts: int) -> None:
        self.config = config
        rng = random.Random(config.seed)
        heading_rad = math.radians(config.heading_deg)
        bias_rad = math.radians(config.heading_bias_deg)
        self.t_s = 0.0
        self.start_frame = LocalFrame(
            config.home_lat_deg, config.home_lon_deg, config.home_alt_amsl_m
        )
        self.body = Airframe(heading_rad, drag_per_s, config.relief.height_m)
        self.wind = Wind(config.wind_m_s, config.wind_from_deg, config.gust_sigma_m_s, rng)
        in_flight = OF_SIH_1_16 if config.manners == "px4-1.16" else QUIET
        noise, drift_m = config.imu_noise, config.baro_drift_m
        self.sensors = Sensors(rng, in_flight, noise, drift_m, bias_rad)
        self.texts: deque[tuple[int, Severity, str]] = deque(maxlen=texts)
        self._texts_said = 0
        self.home: HomePosition | None = None
        self.imu = Imu(0.0, 0.0, 0.0, 0.0, 0.0, -9.8)
        self.baro_height_m = 0.0
        self.landed = True
        self.gcs_heard_s: float | None = None
        self.refuses: set[int] = set()
        self._contact_s = math.inf  # on the ground
        self._count = 0
        self._compass_heading_rad = heading_rad + bias_rad

    @property
    @abstractmethod
    def _motors_turn(self) -> bool: ...

    @abstractmethod
    def stop_motors(self) -> None:
        """By the pilot's kill switch, wherever it is."""

    @abstractmethod
    def _decide_all(self, dt_s: float) -> None:
        """50 times a second: the pilot, the landing, the mode and what is flown in it."""

    def say(self, severity: Severity, text: str) -> None:
        """Queue a STATUSTEXT."""
        self._texts_said += 1
        self.texts.append((self._texts_said, severity, text))

    def step(self) -> None:
        """Advance by STEP_S."""
        self.t_s = self._count * STEP_S
        self._count += 1
        if self._count % _SLOW_EVERY == 0:
            dt_s = STEP_S * _SLOW_EVERY
            self._feel(dt_s)
            self._decide_all(dt_s)
        if self._count % 2 == 0:
            self.controller.step_position(self.estimator, 2.0 * STEP_S, self.landed)
        commands = self.controller.step_attitude(self.estimator, STEP_S)
        if not self._motors_turn:
            commands = (0.0, 0.0, 0.0, 0.0)
        wind = self.wind
        self.body.step(commands, (wind.n_m_s, wind.e_m_s, wind.d_m_s), STEP_S)
        self.imu = self.sensors.imu(self.body)
        self.estimator.propagate(self.imu, self.t_s, STEP_S, self.landed)

    def _feel(self, dt_s: float) -> None:
        """Air pressure and compass, in the wind of now."""
        body, estimator, wind = self.body, self.estimator, self.wind
        wind.step(body.agl_m, math.hypot(body.vn - wind.n_m_s, body.ve - wind.e_m_s), dt_s)
        self.baro_height_m = self.sensors.baro_height_m(body, dt_s)
        estimator.handle_baro(self.baro_height_m)
        estimator.handle_compass(self.sensors.compass_rad(body), dt_s)

    def _stands(self, dt_s: float, after_s: float, moving: bool = False) -> bool:
        """Whether it has been on the ground for so long, without a push to leave."""
        controller = self.controller
        leaving = not controller.setpoint.idle and controller.velocity_sp[2] < -0.1
        if not self.body.on_ground or moving:
            self._contact_s = 0.0
        elif not leaving:
            self._contact_s += dt_s
        return self.body.on_ground and self._contact_s >= after_s

    def _fly_at(
        self,
        place_ned_m: tuple[float, float, float],
        velocity_ned_m_s: tuple[float, float, float],
        heading_rad: float,
    ) -> None:
        """The airframe flies steadily, as its estimator believes but for the compass' error."""
        body, wind = self.body, self.wind
        wind.step(-place_ned_m[2], math.hypot(*velocity_ned_m_s), _AGES_S)
        vn, ve, vd = velocity_ned_m_s
        lift = body.hover_force(vn - wind.n_m_s, ve - wind.e_m_s, vd - wind.d_m_s)
        quat_wxyz = attitude_of_force(*lift, heading_rad)
        body.fly_at(place_ned_m, velocity_ned_m_s, quat_wxyz, math.hypot(*lift))
        believed = attitude_of_force(
            *lift, heading_rad + math.radians(self.config.heading_bias_deg)
        )
        gyro_bias_rad_s = self.sensors.gyro_bias_rad_s
        self.estimator.align(place_ned_m, velocity_ned_m_s, believed, gyro_bias_rad_s)
        self.landed, self._contact_s = False, 0.0
