"""The vehicle's own estimator as EKF3 behaves on external navigation.

Recorded on ArduCopter 4.7: vision is used as soon as the heading is aligned, 6 s after boot;
without it, or while it is refused, the filter reckons on for 7 s, then it has no position any more;
the first vision after that is taken as it is, and so is one whose reset_counter has changed.
"""

import math
from collections.abc import Sequence

from vwnav.geometry.geodesy import LocalFrame
from vwnav.sim.copter.parameters import CopterParameters
from vwnav.sim.multirotor.inertial_filter import InertialFilter

INITIALISED_S, ALIGNED_S = 4.7, 6.1  # after boot
EXTERNAL_NAV = 6  # EK3_SRC1_POSXY, EK3_SRC1_VELXY
_NO_AID_S = 7.0
_VISION_HEALTHY_S = 0.3
_TILT_TIME_S = 10.0
_LEAST_SIGMA = 0.01
# EKF_STATUS_FLAGS, as recorded
_UNINITIALISED, _STARTING = 0x400, 0x000
_NO_POSITION_ON_GROUND, _NO_POSITION, _AIDED = 0x0A7, 0x025, 0x33F

Vector = tuple[float, float, float]


class CopterEstimator(InertialFilter):
    """As EKF3.

    Attributes:
        reset_ne_m: how far the position jumped last, north and east.
    """

    def __init__(self, heading_rad: float, alt_amsl_m: float, parameters: CopterParameters) -> None:
        super().__init__(heading_rad, alt_amsl_m)
        self._parameters = parameters
        self.ever_aided = False
        self.reset_ne_m = (0.0, 0.0)
        self._aligned_s = ALIGNED_S
        self._on_ground = True
        self._heard_s = self._position_s = -math.inf
        self._reset_counter: int | None = None
        self._velocity_s = -math.inf  # when one was fused last
        self._velocity_is_new = False  # the next one is taken as it is

    @property
    def position_ok(self) -> bool:
        """A position that was aided lately."""
        return self.t_s - self._position_s < _NO_AID_S

    @property
    def is_aligned(self) -> bool:
        """It knows its attitude."""
        return self.t_s >= self._aligned_s

    @property
    def vision_ok(self) -> bool:
        """Vision is heard."""
        return self.t_s - self._heard_s < _VISION_HEALTHY_S

    @property
    def flags(self) -> int:
        """EKF_STATUS_REPORT's."""
        if self.t_s < self._aligned_s:
            is_starting = self.t_s >= self._aligned_s - (ALIGNED_S - INITIALISED_S)
            return _STARTING if is_starting else _UNINITIALISED
        if self.position_ok:
            return _AIDED
        return _NO_POSITION_ON_GROUND if self._on_ground else _NO_POSITION

    def align(
        self,
        place_ned_m: Vector,
        velocity_ned_m_s: Vector,
        quat_wxyz: tuple[float, float, float, float],
        gyro_bias_rad_s: Sequence[float],
    ) -> None:
        """Know where it is, as after a flight on vision that came until now."""
        super().align(place_ned_m, velocity_ned_m_s, quat_wxyz, gyro_bias_rad_s)
        self._aligned_s = min(self._aligned_s, self.t_s)
        self.ever_aided, self._on_ground = True, False
        self._heard_s = self._position_s = self._velocity_s = self.t_s

    def _maintain(self, dt_s: float, on_ground: bool) -> None:
        self._on_ground = on_ground
        self.fusing = self.position_ok
        if on_ground:
            self._stand()
            if not self.position_ok:
                self.north.fuse_position(-self.north.x, 0.5**2)
                self.east.fuse_position(-self.east.x, 0.5**2)
        elif self.position_ok:
            self._level(dt_s, _TILT_TIME_S)

    def handle_baro(self, height_m: float) -> None:
        """Fuse a barometric height over the start place."""
        down_m = self.alt_amsl_m - self.start_alt_amsl_m - height_m
        self.down.fuse_position(down_m - self.down.x, _variance(self._parameters["EK3_ALT_M_NSE"]))

    def set_origin(self, lat_deg: float, lon_deg: float, alt_amsl_m: float) -> bool:
        """Place the local frame on the earth; False when it has its place already."""
        if self.origin is not None:
            return False
        self.origin = LocalFrame(lat_deg, lon_deg, alt_amsl_m)
        self.down.x += alt_amsl_m - self.alt_amsl_m
        self.alt_amsl_m = alt_amsl_m
        self.origin_t_s = self.t_s
        self._history.clear()
        return True

    def handle_position(
        self, north_m: float, east_m: float, variance_m2: float, reset_counter: int
    ) -> None:
        """Fuse VISION_POSITION_ESTIMATE, which is taken to be VISO_DELAY_MS old."""
        get = self._parameters
        if int(get["VISO_TYPE"]) != 1:
            return
        self._heard_s = self.t_s
        if int(get["EK3_SRC1_POSXY"]) != EXTERNAL_NAV or self.t_s < self._aligned_s:
            return
        moved_n, moved_e, _ = self._moved_since(self.t_s - 1e-3 * get["VISO_DELAY_MS"])
        dn, de = north_m + moved_n - self.north.x, east_m + moved_e - self.east.x
        variance = max(variance_m2, _variance(get["VISO_POS_M_NSE"]))
        jumped = self._reset_counter not in (None, reset_counter)
        self._reset_counter = reset_counter
        if jumped or not self.position_ok:
            self._reset_to(self.north.x + dn, self.east.x + de, variance)
        elif self._is_refused(dn, de, variance):
            return
        else:
            self.north.fuse_position(dn, variance)
            self.east.fuse_position(de, variance)
        self._position_s = self.t_s
        self.ever_aided = True

    def handle_velocity(self, velocity_ned_m_s: Vector, variance_m2_s2: float) -> None:
        """Fuse VISION_SPEED_ESTIMATE."""
        get = self._parameters
        if int(get["VISO_TYPE"]) != 1 or int(get["EK3_SRC1_VELXY"]) != EXTERNAL_NAV:
            return
        if not self.position_ok:
            return
        variance = max(variance_m2_s2, _variance(get["VISO_VEL_M_NSE"]))
        gate = 0.01 * get["EK3_VEL_I_GATE"]
        is_lost = self.t_s - self._velocity_s > _NO_AID_S
        for axis, speed in zip((self.north, self.east), velocity_ned_m_s[:2], strict=True):
            innovation = speed - axis.v
            if self._velocity_is_new or is_lost:
                axis.v = speed
            elif innovation**2 > gate**2 * (axis.p11 + variance):
                continue
            else:
                axis.fuse_velocity(innovation, variance)
            self._velocity_s = self.t_s
        self._velocity_is_new = False

    def _is_refused(self, dn: float, de: float, variance_m2: float) -> bool:
        """The innovation of the position is beyond its gate, both axes together."""
        gate = 0.01 * self._parameters["EK3_POS_I_GATE"]
        expected = self.north.p00 + self.east.p00 + 2.0 * variance_m2
        return dn * dn + de * de > gate**2 * expected

    def _reset_to(self, north_m: float, east_m: float, variance_m2: float) -> None:
        """Jump, to the velocity too that comes with the position."""
        self.reset_ne_m = (north_m - self.north.x, east_m - self.east.x)
        super()._reset_to(north_m, east_m, variance_m2)
        self._velocity_is_new = True


def _variance(sigma: float) -> float:
    """Of a parameter's sigma, never nothing."""
    return max(sigma, _LEAST_SIGMA) ** 2
