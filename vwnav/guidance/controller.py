"""Velocity control along a route: straight legs between waypoints, slow at the corners.

The autopilot's velocity loop carries the aircraft; this closes position about it. The gains suit a
velocity loop of some 0.4 s behind estimates that are up to 0.3 s late: position is corrected as it
will be when the setpoint takes effect, with a time constant of 1.7 s, far slower than both.
"""

import math
from dataclasses import dataclass

import numpy as np

from vwnav.geometry.rotations import euler_from_rotation, rotation_from_quat, wrap_pi
from vwnav.guidance.limits import LimitsConfig, vertical_speed_m_s
from vwnav.guidance.route_legs import Leg, legs_of, waypoint_speeds_m_s
from vwnav.types import Array, Estimate
from vwnav.vehicle import VelocitySetpoint

_HOLD_STILL = VelocitySetpoint(0.0, 0.0, 0.0)
_LONGEST_STEP_S = 0.5
_ABSURD = 1e12


def stops_at_ned_m(estimate: Estimate, limits: LimitsConfig) -> Array:
    """(3,) where the aircraft, braking from now on, will stand, at the height where it is."""
    velocity_ne_m_s = estimate.velocity_ned_m_s[:2]
    speed_m_s = float(np.hypot(*velocity_ne_m_s))
    reach_s = limits.latency_s + 0.5 * speed_m_s / limits.braking_m_s2
    return np.add(estimate.position_ned_m, [*(reach_s * velocity_ne_m_s), 0.0])


@dataclass(frozen=True, slots=True)
class Guidance:
    """What to fly now.

    Attributes:
        setpoint: never faster than the limits, never NaN.
        done: the last waypoint is reached and the aircraft is nearly still there.
        target_index: the waypoint flown to, from 0; stays at the last one.
        cross_track_m: distance to the right of the leg, negative to the left.
    """

    setpoint: VelocitySetpoint
    done: bool
    target_index: int
    cross_track_m: float


class RouteFollower:
    """Flies through waypoints in order; the first leg starts where the aircraft is at first.

    Args:
        route_ned_m: (n, 3) waypoints, n >= 1, in the frame of the estimates.
        limits: speeds, accelerations and radii.

    Raises:
        ValueError: no waypoints, or one that is not finite.
    """

    def __init__(self, route_ned_m: Array, limits: LimitsConfig) -> None:
        route = np.array(route_ned_m, dtype=np.float64)
        if route.ndim != 2 or route.shape[1] != 3 or len(route) == 0:
            raise ValueError(f"expected a route (n, 3) with n >= 1, got {route.shape}")
        if not np.all(np.isfinite(route)):
            raise ValueError("expected finite waypoints")
        self._route_ned_m = route
        self._limits = limits
        self._legs: tuple[Leg, ...] = ()
        self._end_speeds_m_s: tuple[float, ...] = ()
        self._target = 0
        self._arrived = False
        self._done = False
        self._t_s: float | None = None
        self._velocity_ne_m_s = np.zeros(2)
        self._bias_ne_m_s = np.zeros(2)
        self._yaw_rad: float | None = None
        self._pace = 1.0

    def step(self, estimate: Estimate, pace: float = 1.0) -> Guidance:
        """The setpoint for the newest estimate; zero velocity when that is absurd.

        `pace` is a share of the cruising speed.
        """
        if not _is_usable(estimate):
            return Guidance(_HOLD_STILL, False, self._target, 0.0)
        self._pace = pace
        position = estimate.position_ned_m
        if not self._legs:
            self._begin(estimate)
        step_s = self._step_s(estimate)
        self._advance(estimate)
        leg = self._legs[self._target]
        cross_m = leg.cross_track_m(position)
        wanted_ne = self._wanted_velocity(leg, estimate, step_s)
        self._velocity_ne_m_s = self._within_acceleration(leg, wanted_ne, step_s)
        north_m_s, east_m_s = self._velocity_ne_m_s.tolist()
        setpoint = VelocitySetpoint(
            north_m_s, east_m_s, self._down_speed(leg, position), self._yaw(leg, estimate, step_s)
        )
        return Guidance(setpoint, self._done, self._target, cross_m)

    def below_m(self, estimate: Estimate) -> float:
        """How far it is below the leg that it flies; 0 before the first step."""
        if not self._legs:
            return 0.0
        return self._legs[self._target].below_m(estimate.position_ned_m)

    def _begin(self, estimate: Estimate) -> None:
        self._legs = legs_of(np.vstack([estimate.position_ned_m, self._route_ned_m]))
        self._end_speeds_m_s = waypoint_speeds_m_s(self._legs, self._limits)
        self._velocity_ne_m_s = estimate.velocity_ned_m_s[:2].copy()

    def _step_s(self, estimate: Estimate) -> float:
        """Time since the last step, 0 when the clock of the estimates stands or goes back.

        After a pause somebody else has flown: speed and heading then start from what they are.
        """
        step_s = 0.0 if self._t_s is None else max(estimate.t_s - self._t_s, 0.0)
        self._t_s = estimate.t_s
        if step_s <= _LONGEST_STEP_S:
            return step_s
        self._velocity_ne_m_s = _shortened(
            estimate.velocity_ned_m_s[:2].copy(), self._limits.speed_max_m_s
        )
        self._yaw_rad = None
        return 0.0

    def _advance(self, estimate: Estimate) -> None:
        """On to the next waypoint as long as one is reached; done when slow at the last."""
        last = len(self._legs) - 1
        while self._target < last and self._reached(self._legs[self._target], estimate):
            self._target += 1
        if self._target == last:
            self._arrived = self._arrived or self._reached(self._legs[last], estimate)
            speed_m_s = float(np.linalg.norm(estimate.velocity_ned_m_s))
            if self._arrived and speed_m_s < self._limits.arrival_speed_m_s:
                self._done = True

    def _reached(self, leg: Leg, estimate: Estimate) -> bool:
        """Near the waypoint, or past it without being far aside.

        A waypoint cannot be hit better than the position is known, so the radius grows with sigma.
        """
        limits, position = self._limits, estimate.position_ned_m
        if abs(float(position[2] - leg.end_ned_m[2])) > limits.height_acceptance_m:
            return False
        radius_m = max(limits.acceptance_m, estimate.sigma_horizontal_m)
        radius_m = min(radius_m, limits.acceptance_max_m)
        ahead_m = leg.length_m - leg.along_track_m(position)
        if math.hypot(ahead_m, leg.cross_track_m(position)) <= radius_m:
            return True
        is_last = self._target == len(self._legs) - 1
        early_m = self._end_speeds_m_s[self._target] * limits.latency_s
        passed = not is_last and leg.length_m > 0.0 and ahead_m <= early_m
        return passed and abs(leg.cross_track_m(position)) <= 2.0 * radius_m

    def _wanted_velocity(self, leg: Leg, estimate: Estimate, step_s: float) -> Array:
        """Along the leg as fast as the next waypoint allows, across it back to the line."""
        limits, position = self._limits, estimate.position_ned_m
        cross_m = leg.cross_track_m(position)
        along_m_s = self._along_speed(leg, leg.to_go_m(position))
        drift_m_s = float(estimate.velocity_ned_m_s[:2] @ leg.right_ne)
        # Where it will be when this setpoint takes effect; else the gain would have to be low.
        back_m_s = -limits.position_gain_per_s * (cross_m + limits.latency_s * drift_m_s)
        if abs(back_m_s) < limits.cross_speed_m_s:
            # What position control alone leaves over, wind above all. Kept in the world's axes, for
            # the wind does not turn with the route.
            step_m_s = -limits.bias_gain_per_s2 * cross_m * step_s
            self._bias_ne_m_s = _shortened(
                self._bias_ne_m_s + leg.right_ne * step_m_s, limits.bias_max_m_s
            )
        across_m_s = back_m_s + float(self._bias_ne_m_s @ leg.right_ne)
        across_m_s = min(max(across_m_s, -limits.cross_speed_m_s), limits.cross_speed_m_s)
        # Far off the line there is no hurry along it.
        along_m_s /= 1.0 + (cross_m / limits.cross_slow_m) ** 2
        wanted = leg.along_ne * along_m_s + leg.right_ne * across_m_s
        return _shortened(wanted, limits.speed_max_m_s)

    def _along_speed(self, leg: Leg, ahead_m: float) -> float:
        """Speed from which the aircraft can still brake to the speed of the waypoint, signed."""
        limits = self._limits
        end_m_s = self._end_speeds_m_s[self._target]
        if ahead_m <= 0.0:
            return max(limits.position_gain_per_s * ahead_m, -limits.cross_speed_m_s)
        cruise_m_s = min(self._pace * limits.cruise_m_s, leg.speed_for_slope_m_s(limits))
        speed_m_s = float(np.hypot(*self._velocity_ne_m_s))
        braking_m = max(ahead_m - speed_m_s * limits.latency_s, 0.0)
        braked_m_s = math.sqrt(end_m_s**2 + 2.0 * limits.braking_m_s2 * braking_m)
        return min(cruise_m_s, braked_m_s, end_m_s + limits.position_gain_per_s * ahead_m)

    def _within_acceleration(self, leg: Leg, wanted_ne_m_s: Array, step_s: float) -> Array:
        """The wanted velocity as far as it can be had by now.

        Back to the line comes first, with four fifths of the acceleration at most: the three fifths
        at right angles to them are kept for the brakes, whatever noise does across.
        """
        change = wanted_ne_m_s - self._velocity_ne_m_s
        most_m_s = self._limits.acceleration_m_s2 * step_s
        most_across_m_s = 0.8 * most_m_s
        across_m_s = min(max(float(change @ leg.right_ne), -most_across_m_s), most_across_m_s)
        rest_m_s = math.sqrt(most_m_s**2 - across_m_s**2)
        # Braking may be harder than planned, or a gust from behind would carry it past a corner.
        faster_m_s = min(rest_m_s, self._limits.braking_m_s2 * step_s)
        along_m_s = min(max(float(change @ leg.along_ne), -rest_m_s), faster_m_s)
        change = leg.right_ne * across_m_s + leg.along_ne * along_m_s
        return _shortened(self._velocity_ne_m_s + change, self._limits.speed_max_m_s)

    def _down_speed(self, leg: Leg, position_ned_m: Array) -> float:
        """Vertical speed that follows the slope of the leg."""
        along_m_s = float(self._velocity_ne_m_s @ leg.along_ne)
        error_m = float(leg.down_at_m(position_ned_m) - position_ned_m[2])
        return vertical_speed_m_s(error_m, leg.slope_at(position_ned_m) * along_m_s, self._limits)

    def _yaw(self, leg: Leg, estimate: Estimate, step_s: float) -> float:
        """Heading along the leg, turned to at the limit of the yaw rate."""
        if self._yaw_rad is None:
            self._yaw_rad = euler_from_rotation(rotation_from_quat(estimate.quat_wxyz))[2]
        if leg.length_m > self._limits.acceptance_m:
            turn_rad = wrap_pi(leg.heading_rad - self._yaw_rad)
            most_rad = self._limits.yaw_rate_rad_s * step_s
            self._yaw_rad = wrap_pi(self._yaw_rad + min(max(turn_rad, -most_rad), most_rad))
        return self._yaw_rad


def _is_usable(estimate: Estimate) -> bool:
    """Finite, and of a size at which nothing computed from it overflows."""
    arrays = (
        estimate.position_ned_m,
        estimate.velocity_ned_m_s,
        estimate.covariance,
        estimate.quat_wxyz,
    )
    small = all(bool(np.all(np.abs(array) < _ABSURD)) for array in arrays)
    return math.isfinite(estimate.t_s) and small


def _shortened(vector: Array, longest: float) -> Array:
    length = math.hypot(*vector.tolist())
    return vector if length <= longest else np.asarray(vector * (longest / length))
