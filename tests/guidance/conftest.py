"""A point mass with a velocity loop, wind, and late, noisy estimates of where it is."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import settings

from vwnav.geometry.rotations import quat_from_rotation, rotation_from_euler
from vwnav.types import Array, Estimate
from vwnav.vehicle import VelocitySetpoint

# A machine busy with other work is no failure of a law.
settings.register_profile("unhurried", deadline=None)
settings.load_profile("unhurried")

STEP_S = 0.05
CONTROL_EVERY = 2  # 10 Hz
LOOP_S = 0.4  # time constant of the velocity loop
LATE_S = 0.2


def estimate_at(
    position_ned_m: Array,
    velocity_ned_m_s: Array | None = None,
    *,
    t_s: float = 0.0,
    sigma_m: float = 0.5,
    yaw_rad: float = 0.0,
    **changes: object,
) -> Estimate:
    """An estimate with everything about it in order."""
    values: dict[str, object] = {
        "t_s": t_s,
        "position_ned_m": np.array(position_ned_m, dtype=float),
        "velocity_ned_m_s": np.zeros(3) if velocity_ned_m_s is None else velocity_ned_m_s,
        "covariance": np.eye(6) * sigma_m**2,
        "quat_wxyz": quat_from_rotation(rotation_from_euler(0.0, 0.0, yaw_rad)),
        "sigma_yaw_rad": 0.03,
        "agl_m": 50.0,
        "sigma_agl_m": 2.0,
        "t_last_fix_s": t_s,
        "reset_counter": 0,
    }
    return Estimate(**(values | changes))


@dataclass
class PointMass:
    """Second-order velocity loop, gusts (Ornstein-Uhlenbeck) and a steady push by the wind.

    Drag of 0.25 per second, gusts of 1.5 m/s for 2 s; of the push of a steady 5 m/s the velocity
    loop leaves a fifth.
    """

    rng: np.random.Generator
    position_m: Array = field(default_factory=lambda: np.array([0.0, 0.0, -50.0]))
    noise_m: float = 0.15
    wind_m_s2: Array = field(default_factory=lambda: np.array([0.15, -0.2, 0.0]))
    gust_m_s2: float = 0.38

    def __post_init__(self) -> None:
        self.velocity_m_s = np.zeros(3)
        self._acceleration_m_s2 = np.zeros(3)
        self._gust_m_s2 = np.zeros(3)
        self._noise_m = np.zeros(3)
        self._past: deque[tuple[Array, Array]] = deque(maxlen=round(LATE_S / STEP_S) + 1)

    def move(self, setpoint: VelocitySetpoint) -> None:
        """One step of time under a setpoint."""
        wanted = np.array([setpoint.north_m_s, setpoint.east_m_s, setpoint.down_m_s])
        rate = 2.0 / LOOP_S
        jerk = rate**2 * (wanted - self.velocity_m_s) - 2.0 * rate * self._acceleration_m_s2
        self._acceleration_m_s2 = self._acceleration_m_s2 + jerk * STEP_S
        decay = np.exp(-STEP_S / 2.0)
        kick = self.gust_m_s2 * np.sqrt(1.0 - decay**2)
        self._gust_m_s2 = decay * self._gust_m_s2 + self.rng.normal(0.0, kick, 3)
        push = self.wind_m_s2 + self._gust_m_s2
        self.velocity_m_s = self.velocity_m_s + self._acceleration_m_s2 * STEP_S
        self.position_m = self.position_m + (self.velocity_m_s + push * LOOP_S) * STEP_S
        noise_decay = np.exp(-STEP_S / 1.0)
        self._noise_m = noise_decay * self._noise_m + self.rng.normal(
            0.0, self.noise_m * np.sqrt(1.0 - noise_decay**2), 3
        )
        self._past.append((self.position_m + self._noise_m, self.velocity_m_s))

    def estimate(self, t_s: float) -> Estimate:
        """Where it was a fifth of a second ago, with the error of a filter."""
        position, velocity = self._past[0] if self._past else (self.position_m, self.velocity_m_s)
        return estimate_at(position, velocity, t_s=t_s)


@pytest.fixture(scope="session")
def make_estimate() -> Callable[..., Estimate]:
    """The function that makes an estimate."""
    return estimate_at


@pytest.fixture
def make_drone() -> Callable[[int], PointMass]:
    """The function that makes a point mass from a seed."""
    return lambda seed, **changes: PointMass(np.random.default_rng(seed), **changes)


@pytest.fixture
def fly() -> Callable[..., Array]:
    """Flies a drone with a follower to the end; gives true positions and speeds (k, 6)."""

    def flight(drone: PointMass, step: Callable[[Estimate], object], limit_s: float) -> Array:
        track = []
        for i in range(round(limit_s / STEP_S)):
            if i % CONTROL_EVERY == 0:
                guidance = step(drone.estimate(i * STEP_S))
            drone.move(guidance.setpoint)
            track.append([*drone.position_m, *drone.velocity_m_s])
            if guidance.done:
                return np.array(track)
        raise AssertionError(f"not done after {limit_s} s, at waypoint {guidance.target_index}")

    return flight
