"""A simulated PX4 without sockets and without waiting: steps as fast as they go."""

import random
from typing import Any

from vwnav.sim.config import VehicleConfig
from vwnav.sim.mavlink.command import Result
from vwnav.sim.multirotor.setpoint import Setpoint
from vwnav.sim.multirotor.simulated import STEP_S
from vwnav.sim.px4.estimator import VisionSample
from vwnav.sim.px4.modes import NavState
from vwnav.sim.px4.px4 import SimulatedPx4


class Bench:
    """The vehicle with a perfect companion: vision from the truth, setpoints, a pilot's sticks."""

    def __init__(self, **config: Any) -> None:
        self.vehicle = SimulatedPx4(VehicleConfig(**config))
        self.vision = False
        self.vision_jump_m = 0.0
        self.vision_noise_m = 0.1
        self.vision_yaw_rad: float | None = None
        self.reset_counter = 0
        self.vision_every = 8
        self.vision_sigma_m: float | None = 0.5  # None tells no position
        self.vision_tells_velocity = False
        self.velocity: tuple[float, float, float] | None = None
        self.sticks: tuple[int, int, int, int] | None = None
        self._rng = random.Random(5)

    def run(self, seconds: float) -> None:
        for i in range(round(seconds / STEP_S)):
            self.vehicle.step()
            if self.vision and i % self.vision_every == 0:
                self.see()
            if self.velocity is not None and i % 12 == 0:
                self.vehicle.set_target(Setpoint(None, None, None, *self.velocity, yaw_rad=0.0))
            if self.sticks is not None and i % 10 == 0:
                self.vehicle.manual.handle_joystick(*self.sticks, self.vehicle.t_s)

    def see(self) -> None:
        self.vehicle.estimator.handle_vision(self.sample())

    def sample(self) -> VisionSample:
        body, noise = self.vehicle.body, self._rng.gauss
        place = (
            body.n + self.vision_jump_m + noise(0.0, self.vision_noise_m),
            body.e + noise(0.0, self.vision_noise_m),
            body.d,
        )
        sigma_m = self.vision_sigma_m
        return VisionSample(
            t_s=self.vehicle.t_s,
            position_ned_m=None if sigma_m is None else place,
            variance_m2=0.0 if sigma_m is None else sigma_m**2,
            yaw_rad=self.vision_yaw_rad,
            velocity_ned_m_s=(body.vn, body.ve, body.vd) if self.vision_tells_velocity else None,
            velocity_variance=0.25,
            reset_counter=self.reset_counter,
            turned_frame=False,
        )

    def ask(self, state: NavState) -> Result:
        return self.vehicle.commander.ask(state, self.vehicle.health)

    def arm(self) -> Result:
        vehicle = self.vehicle
        return vehicle.commander.arm(vehicle.health, False, vehicle.t_s)

    @property
    def state(self) -> NavState:
        return self.vehicle.commander.state

    @property
    def position_error_m(self) -> float:
        estimator, body = self.vehicle.estimator, self.vehicle.body
        return float(((estimator.north.x - body.n) ** 2 + (estimator.east.x - body.e) ** 2) ** 0.5)

    @property
    def texts(self) -> list[str]:
        return [text.strip() for _, _, text in self.vehicle.texts]

    def get_ready(self) -> None:
        self.run(0.5)
        config = self.vehicle.config
        self.vehicle.estimator.set_origin(
            config.home_lat_deg, config.home_lon_deg, config.home_alt_amsl_m
        )
        self.vision = True
        self.run(14.0)

    def hover(self, height_m: float = 10.0) -> "Bench":
        """Ready, armed, taken off."""
        self.get_ready()
        assert self.arm() is Result.ACCEPTED
        self.vehicle.parameters.set_wire("MIS_TAKEOFF_ALT", height_m, 9)
        self.vehicle.plan_takeoff(None)
        assert self.ask(NavState.TAKEOFF) is Result.ACCEPTED
        self.run(8.0 + height_m)
        assert self.state is NavState.HOLD
        return self

    def offboard(self, velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> "Bench":
        """Offboard with a velocity, streaming."""
        self.velocity = velocity
        self.run(1.0)
        assert self.ask(NavState.OFFBOARD) is Result.ACCEPTED
        self.run(0.1)
        return self

    def run_until_state(self, wanted: NavState, limit_s: float) -> float:
        """Seconds until a state is flown, `limit_s` when it is not."""
        start_s = self.vehicle.t_s
        while self.state is not wanted and self.vehicle.t_s - start_s < limit_s:
            self.run(0.02)
        return self.vehicle.t_s - start_s
