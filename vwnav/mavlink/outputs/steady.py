"""What is sent to an autopilot steadily: estimates about its origin, setpoints by its compass."""

import math
from collections.abc import Callable

from vwnav.geometry.rotations import euler_from_rotation, rotation_from_quat, wrap_pi
from vwnav.mavlink.link_budget import LinkBudget
from vwnav.mavlink.modes import AutopilotKind
from vwnav.mavlink.outputs.autopilot_north import AutopilotNorth
from vwnav.mavlink.outputs.vision_messages import (
    odometry,
    velocity_target,
    vision_position,
    vision_speed,
)
from vwnav.mavlink.ports.port import Port
from vwnav.mavlink.telemetry.telemetry_state import TelemetryState
from vwnav.types import Array, Estimate
from vwnav.vehicle import VelocitySetpoint

_ON_TIME_S = 0.005  # an estimate may leave so much before its turn
# From so wide a position, such as one that fixes have yet to prove, PX4 finds no velocity within
# seconds: it is told that too.
_WIDE_M = 30.0
_NORTH_OFF_RAD, _NORTH_OFF_S = math.radians(40.0), 0.5  # by more for longer it is turned to
_LEAST_OFF_DEG = 20.0
_NORTH = "the autopilot's north is {:.0f} degrees off: it is told its own, calibrate its compass"
_NORTH_FITS = "the autopilot's north is right again"


class Outputs:
    """Sends, and knows by how much the autopilot's compass differs from the estimate's heading.

    Args:
        clock: monotonic clock, in seconds.

    Attributes:
        north: in which estimates and velocities are told.
    """

    def __init__(self, port: Port, telemetry: TelemetryState, clock: Callable[[], float]) -> None:
        self._port = port
        self._telemetry = telemetry
        self._clock = clock
        self._next_estimate_s = -math.inf
        self._heading_bias_rad = 0.0
        self._held_yaw_rad: float | None = None
        self.north = AutopilotNorth()
        self._north_fits_s = math.inf  # when it last did
        self._notices: list[str] = []

    def estimate(self, estimate: Estimate, budget: LinkBudget) -> None:
        """Send an estimate, unless it comes before its turn or no origin is agreed upon."""
        is_px4 = self._telemetry.kind is AutopilotKind.PX4
        as_odometry = is_px4 and estimate.sigma_horizontal_m > _WIDE_M
        rate_hz = budget.odometry_hz if as_odometry else budget.estimate_hz
        offset_ned_m = self._telemetry.origin_offset_ned_m
        if offset_ned_m is None or not self._is_its_turn(rate_hz):
            return
        attitude = self._telemetry.attitude_near(estimate.t_s)
        if attitude is not None:
            bias_rad = _yaw(attitude.quat_wxyz) - _yaw(estimate.quat_wxyz)
            self._heading_bias_rad = wrap_pi(bias_rad)
            self._keep_to_its_north(estimate)
        estimate = self.north.told(estimate)
        if as_odometry:
            self._port.send("ODOMETRY", odometry(estimate, offset_ned_m))
            return
        self._port.send("VISION_POSITION_ESTIMATE", vision_position(estimate, offset_ned_m))
        if not is_px4:  # which does not handle it
            self._port.send("VISION_SPEED_ESTIMATE", vision_speed(estimate))

    def setpoint(self, setpoint: VelocitySetpoint) -> None:
        """Send a velocity."""
        yaw_rad = self._autopilot_yaw(setpoint.yaw_rad)
        asked = self.north.asked(setpoint)
        fields = velocity_target(asked, yaw_rad, self._clock(), self._port.system_id)
        self._port.send("SET_POSITION_TARGET_LOCAL_NED", fields)

    def take_notices(self) -> list[str]:
        """What a person should know of it, in words, once."""
        notices, self._notices = self._notices, []
        return notices

    def release_heading(self) -> None:
        """Forget the heading that was asked for last: the next one held is the present one."""
        self._held_yaw_rad = None

    def _keep_to_its_north(self, estimate: Estimate) -> None:
        off_rad = abs(wrap_pi(self._heading_bias_rad - self.north.turn_rad))
        if off_rad < _NORTH_OFF_RAD or self._north_fits_s > estimate.t_s:
            self._north_fits_s = estimate.t_s
        elif estimate.t_s - self._north_fits_s > _NORTH_OFF_S:
            self.north = self.north.turned_to(self._heading_bias_rad, estimate)
            off_deg = abs(math.degrees(self._heading_bias_rad))
            self._notices.append(
                _NORTH.format(off_deg) if off_deg > _LEAST_OFF_DEG else _NORTH_FITS
            )

    def _is_its_turn(self, rate_hz: float) -> bool:
        now_s, period_s = self._clock(), 1.0 / rate_hz
        if now_s < self._next_estimate_s - _ON_TIME_S:
            return False
        self._next_estimate_s = max(self._next_estimate_s, now_s - period_s) + period_s
        return True

    def _autopilot_yaw(self, yaw_rad: float | None) -> float:
        """A true heading in terms of the autopilot's compass; None holds the last one asked for."""
        if yaw_rad is not None:
            self._held_yaw_rad = wrap_pi(yaw_rad + self._heading_bias_rad)
        elif self._held_yaw_rad is None:
            attitude = self._telemetry.newest_attitude
            self._held_yaw_rad = 0.0 if attitude is None else _yaw(attitude.quat_wxyz)
        return self._held_yaw_rad


def _yaw(quat_wxyz: Array) -> float:
    return euler_from_rotation(rotation_from_quat(quat_wxyz))[2]
