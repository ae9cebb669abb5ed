"""What is asked of the autopilot's velocity control: standing still, or over a place."""

import math

import numpy as np

from vwnav.guidance.limits import LimitsConfig, vertical_speed_m_s
from vwnav.mission.config import FlightConfig
from vwnav.types import Array, Estimate
from vwnav.vehicle import Autopilot, VelocitySetpoint

_STILL = VelocitySetpoint(0.0, 0.0, 0.0)


class Steering:
    """Velocity setpoints, and the place that is held.

    Attributes:
        setpoint: the one that is flown; None while nothing is asked for.
        held_ne_m: (2,) the place that `hold` stays over.
    """

    def __init__(
        self, autopilot: Autopilot, config: FlightConfig, limits: LimitsConfig, height_m: float
    ) -> None:
        """`height_m` is the route's, above the origin."""
        self._autopilot = autopilot
        self._config = config
        self._limits = limits
        self._height_m = height_m
        self.setpoint: VelocitySetpoint | None = None
        self.held_ne_m: Array = np.zeros(2)

    def steer(self, setpoint: VelocitySetpoint) -> None:
        """Ask for a velocity.

        Raises:
            ValueError: it is not finite.
        """
        values = (setpoint.north_m_s, setpoint.east_m_s, setpoint.down_m_s)
        if not all(math.isfinite(v) for v in values):
            raise ValueError(f"setpoint is not finite: {setpoint}")
        self.setpoint = setpoint
        self._autopilot.send_velocity(setpoint)

    def still(self) -> None:
        """Ask for no motion."""
        self.steer(_STILL)

    def descend_blind(self) -> None:
        """Straight down: there is nothing to hold a place by."""
        self.steer(VelocitySetpoint(0.0, 0.0, self._limits.descend_m_s))

    def stop(self) -> None:
        """Ask for nothing more."""
        self.setpoint = None

    def hold(self, estimate: Estimate, down_m_s: float) -> None:
        """Stay over the held place while moving vertically, down positive."""
        wanted = (self.held_ne_m - estimate.position_ned_m[:2]) * self._config.hold_gain_per_s
        speed = float(np.hypot(*wanted))
        wanted *= min(1.0, self._config.hold_speed_m_s / max(speed, 1e-9))
        self.steer(VelocitySetpoint(float(wanted[0]), float(wanted[1]), down_m_s))

    def hold_at_height(self, estimate: Estimate) -> None:
        """Stay over the held place, at the route's height."""
        self.rise(estimate, self.missing_m(estimate))

    def climb(self, estimate: Estimate) -> None:
        """Up to the route's height over the held place."""
        self.rise(estimate, max(self.missing_m(estimate), 0.0))

    def rise(self, estimate: Estimate, missing_m: float) -> None:
        """Up by so much, or down where it is negative, over the held place."""
        self.hold(estimate, vertical_speed_m_s(-missing_m, 0.0, self._limits))

    def search_upwards(self, estimate: Estimate, highest_m: float) -> None:
        """Straight up to where the map shows more, no higher than that above the origin."""
        missing_m = highest_m + float(estimate.position_ned_m[2])
        up_m_s = float(np.clip(0.5 * missing_m, 0.0, self._limits.climb_m_s))
        self.steer(VelocitySetpoint(0.0, 0.0, -up_m_s))

    def descend(self, estimate: Estimate) -> None:
        """Down over the held place."""
        self.hold(estimate, self._limits.descend_m_s)

    def missing_m(self, estimate: Estimate) -> float:
        """Height that is missing to the route's."""
        return self._height_m + float(estimate.position_ned_m[2])
