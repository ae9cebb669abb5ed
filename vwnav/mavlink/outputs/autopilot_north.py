"""The north of an autopilot whose compass is far off: what it is told is turned to that.

An autopilot turns a velocity that it lacks into a lean by its own heading. One that is wrong by 60
degrees and more leans so far beside that it never gets there: it flies a spiral, ever faster. In
terms of its own north it flies as any other.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from vwnav.geometry.rotations import quat_from_rotation, rotation_from_euler, rotation_from_quat
from vwnav.types import Array, Estimate
from vwnav.vehicle import VelocitySetpoint


@dataclass(frozen=True, slots=True, eq=False)
class AutopilotNorth:
    """A turn about down by `turn_rad` around a place: true NED to the autopilot's.

    Attributes:
        place_ned_m: (3,) the place, in true NED about the run's origin; told_ned_m: (3,) the same
            as the autopilot has been told it.
    """

    turn_rad: float = 0.0
    place_ned_m: Array = field(default_factory=lambda: np.zeros(3))
    told_ned_m: Array = field(default_factory=lambda: np.zeros(3))

    def turned_to(self, turn_rad: float, estimate: Estimate) -> "AutopilotNorth":
        """Another turn from here on: what was told of the place stays true."""
        place_ned_m = estimate.position_ned_m
        return AutopilotNorth(turn_rad, place_ned_m, self.told(estimate).position_ned_m)

    def told(self, estimate: Estimate) -> Estimate:
        """An estimate in the autopilot's terms."""
        if self.turn_rad == 0.0 and np.array_equal(self.place_ned_m, self.told_ned_m):
            return estimate
        R = rotation_from_euler(0.0, 0.0, self.turn_rad)
        both = np.kron(np.eye(2), R)
        return replace(
            estimate,
            position_ned_m=self.told_ned_m + R @ (estimate.position_ned_m - self.place_ned_m),
            velocity_ned_m_s=R @ estimate.velocity_ned_m_s,
            covariance=both @ estimate.covariance @ both.T,
            quat_wxyz=quat_from_rotation(R @ rotation_from_quat(estimate.quat_wxyz)),
        )

    def asked(self, setpoint: VelocitySetpoint) -> VelocitySetpoint:
        """A velocity in the autopilot's terms; its heading is told by the compass anyway."""
        c, s = math.cos(self.turn_rad), math.sin(self.turn_rad)
        north_m_s = c * setpoint.north_m_s - s * setpoint.east_m_s
        east_m_s = s * setpoint.north_m_s + c * setpoint.east_m_s
        return replace(setpoint, north_m_s=north_m_s, east_m_s=east_m_s)

    def true_ned_m(self, told_ned_m: Array) -> Array:
        """(3,) where a place of the autopilot's is in truth."""
        return self.place_ned_m + self.true_velocity(told_ned_m - self.told_ned_m)

    def true_velocity(self, told_ned: Array) -> Array:
        """(3,) a velocity of the autopilot's, or any other vector, in truth."""
        return rotation_from_euler(0.0, 0.0, self.turn_rad).T @ told_ned
