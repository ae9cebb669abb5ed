"""How a multirotor's velocity is led: slowed down to a stop and a stay, or towards a point."""

import math

from vwnav.sim.multirotor.inertial_filter import InertialFilter
from vwnav.sim.multirotor.setpoint import Setpoint

_STOPPED_M_S = 0.5
_TURNS_BEYOND_M = 5.0


class VelocitySmoother:
    """The velocity asked for, and where it stays once it has stopped.

    Attributes:
        vn_m_s, ve_m_s, vd_m_s: asked for now.
        anchor: north and east (m) of where it stays, None while it moves.
        anchor_down_m: the same of the height.
        yaw_rad: None leaves the heading alone.
    """

    def __init__(self) -> None:
        self.vn_m_s = self.ve_m_s = self.vd_m_s = 0.0
        self.anchor: tuple[float, float] | None = None
        self.anchor_down_m: float | None = None
        self.yaw_rad: float | None = None

    def begin(self, estimate: InertialFilter) -> None:
        """Go on as the vehicle goes now."""
        self.anchor = self.anchor_down_m = None
        self.yaw_rad = estimate.attitude.yaw_rad
        self.vn_m_s, self.ve_m_s = estimate.north.v, estimate.east.v
        self.vd_m_s = estimate.down.v

    def stop_and_stay(self, estimate: InertialFilter, step_m_s: float) -> Setpoint:
        """Slow down by `step_m_s`, then keep the place."""
        if self.anchor is None:
            speed = math.hypot(self.vn_m_s, self.ve_m_s)
            if speed > step_m_s:
                share = 1.0 - step_m_s / speed
                self.vn_m_s, self.ve_m_s = share * self.vn_m_s, share * self.ve_m_s
            else:
                self.vn_m_s = self.ve_m_s = 0.0
                if math.hypot(estimate.north.v, estimate.east.v) < _STOPPED_M_S:
                    self.anchor = (estimate.north.x, estimate.east.x)
        if self.anchor_down_m is None:
            self.vd_m_s -= math.copysign(min(abs(self.vd_m_s), step_m_s), self.vd_m_s)
            if self.vd_m_s == 0.0:
                self.anchor_down_m = estimate.down.x
        return self._setpoint()

    def _setpoint(self) -> Setpoint:
        sp = Setpoint(yaw_rad=self.yaw_rad)
        if self.anchor is None:
            sp.vn_m_s, sp.ve_m_s = self.vn_m_s, self.ve_m_s
        else:
            sp.north_m, sp.east_m = self.anchor
        if self.anchor_down_m is None:
            sp.vd_m_s = self.vd_m_s
        else:
            sp.down_m = self.anchor_down_m
        return sp

    def steer(
        self, dn_m: float, de_m: float, cruise_m_s: float, acceleration_m_s2: float, dt_s: float
    ) -> None:
        """Towards a point that lies so far north and east, slowing down in time to stop there."""
        distance = math.hypot(dn_m, de_m)
        acceleration = max(0.0, acceleration_m_s2)
        speed = min(cruise_m_s, math.sqrt(acceleration * distance), distance)
        wanted_n = speed * dn_m / max(distance, 1e-6)
        wanted_e = speed * de_m / max(distance, 1e-6)
        self.slew(wanted_n, wanted_e, acceleration * dt_s)
        self.yaw_rad = math.atan2(de_m, dn_m) if distance > _TURNS_BEYOND_M else self.yaw_rad

    def slew(self, vn_m_s: float, ve_m_s: float, step_m_s: float) -> None:
        """Change the horizontal velocity towards another one, by `step_m_s` at most."""
        change = math.hypot(vn_m_s - self.vn_m_s, ve_m_s - self.ve_m_s)
        share = min(1.0, step_m_s / max(change, 1e-6))
        self.vn_m_s += share * (vn_m_s - self.vn_m_s)
        self.ve_m_s += share * (ve_m_s - self.ve_m_s)
