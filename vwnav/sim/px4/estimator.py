"""The vehicle's own estimator: inertial, barometer, compass and external vision, as EKF2 behaves.

What is EKF2's (and measured, see docs/simulation.md) is kept: vision must come faster than 5 Hz to
be fused, the position dies after EKF2_NOAID_TOUT without it, a changed reset_counter resets, a
steady disagreement resets after 2.5 s, and an origin set while vision is fused wrecks the position.
Velocity is fused as EKF2's source has it (`ev_vel_control.cpp`): it aids as a position does.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from vwnav.geometry.geodesy import LocalFrame
from vwnav.sim.multirotor.inertial_filter import InertialFilter
from vwnav.sim.px4.parameters import Px4Parameters

EV_HORIZONTAL, EV_HEIGHT, EV_VELOCITY, EV_YAW = 1, 2, 4, 8
HEIGHT_FROM_VISION = 3
_MAX_GAP_S = 0.2  # EKF2's EV_MAX_INTERVAL
_RESTART_S = 0.2  # of steady vision after the position was lost: recorded 0.25 to 0.3 s
_RESET_AFTER_S = 2.5  # of refused vision: a silent 5 m jump was followed in 3 s
_TILT_TIME_S = 10.0
_SPHERE_RADIUS_M = 6371000.0


@dataclass(frozen=True, slots=True)
class VisionSample:
    """External vision in NED about the estimator's origin; None is not measured.

    `t_s` is the vehicle's time of the measurement, variances in m^2 and (m/s)^2.
    """

    t_s: float
    position_ned_m: tuple[float, float, float] | None
    variance_m2: float
    yaw_rad: float | None
    velocity_ned_m_s: tuple[float, float, float] | None
    velocity_variance: float
    reset_counter: int
    turned_frame: bool  # LOCAL_FRD: its north is the vehicle's nose at start, not north


class Px4Estimator(InertialFilter):
    """As EKF2."""

    def __init__(self, heading_rad: float, alt_amsl_m: float, parameters: Px4Parameters) -> None:
        super().__init__(heading_rad, alt_amsl_m)
        self._parameters = parameters
        self._wrecked_m = (0.0, 0.0)
        self.test_ratio = 0.0
        self._last_fused_s = self._last_velocity_s = -math.inf
        self._fuses_velocity = False
        self._last_sample_s = -math.inf
        self._steady_since_s = 0.0
        self._last_vision_yaw_s = -math.inf
        self._refused_since_s: float | None = None
        self._vision_reset_counter: int | None = None
        self._baro_bias_m = 0.0

    @property
    def local_position_ok(self) -> bool:
        """Horizontal position is valid: aided within EKF2_NOAID_TOUT, be it by velocity alone."""
        return self._is_recent(max(self._last_fused_s, self._last_velocity_s))

    def _is_recent(self, t_s: float) -> bool:
        return self.t_s - t_s < self._parameters["EKF2_NOAID_TOUT"] * 1e-6

    @property
    def lost_in_flight(self) -> bool:
        """There was a position, and it is gone."""
        return self.ever_aided and not self.local_position_ok

    @property
    def ever_aided(self) -> bool:
        """A horizontal position or velocity was fused at some time."""
        return max(self._last_fused_s, self._last_velocity_s) > -math.inf

    @property
    def global_position_ok(self) -> bool:
        """A valid position and an origin to place it by."""
        return self.origin is not None and self.local_position_ok

    @property
    def origin_broken(self) -> bool:
        """The origin came while vision was fused: the position is thousands of km off."""
        return self._wrecked_m != (0.0, 0.0)

    def align(
        self,
        place_ned_m: tuple[float, float, float],
        velocity_ned_m_s: tuple[float, float, float],
        quat_wxyz: tuple[float, float, float, float],
        gyro_bias_rad_s: Sequence[float],
    ) -> None:
        """Know where it is, as after a flight on vision that came until now."""
        super().align(place_ned_m, velocity_ned_m_s, quat_wxyz, gyro_bias_rad_s)
        self._last_fused_s = self._last_sample_s = self.t_s
        self._refused_since_s = None

    def _maintain(self, dt_s: float, on_ground: bool) -> None:
        north, east = self.north, self.east
        if self.t_s - self._last_sample_s > _MAX_GAP_S:
            self.fusing = self._fuses_velocity = False
        if on_ground:
            self._stand()
            if not self.local_position_ok:
                north.fuse_position(-north.x, 0.5**2)  # EKF2's fake position
                east.fuse_position(-east.x, 0.5**2)
        elif self.local_position_ok:
            self._level(dt_s, _TILT_TIME_S)
        else:
            north.fuse_velocity(-north.v, 3.0**2)
            east.fuse_velocity(-east.v, 3.0**2)

    def handle_baro(self, height_m: float) -> None:
        """Fuse a barometric height over the start place."""
        down_m = self.alt_amsl_m - self.start_alt_amsl_m - height_m
        innovation_m = down_m - self._baro_bias_m - self.down.x
        if self._vision_height:
            self._baro_bias_m += 0.01 * innovation_m
        else:
            noise_m = max(0.01, self._parameters["EKF2_BARO_NOISE"])
            self.down.fuse_position(innovation_m, noise_m**2)

    @property
    def _vision_height(self) -> bool:
        wanted = int(self._parameters["EKF2_EV_CTRL"]) & EV_HEIGHT
        return (
            bool(wanted)
            and self.fusing
            and int(self._parameters["EKF2_HGT_REF"]) == HEIGHT_FROM_VISION
        )

    def handle_compass(self, heading_rad: float, dt_s: float) -> None:
        """Fuse a compass heading, unless vision gives one."""
        if self.t_s - self._last_vision_yaw_s > 1.0:
            super().handle_compass(heading_rad, dt_s)

    def set_origin(self, lat_deg: float, lon_deg: float, alt_amsl_m: float) -> None:
        """Place the local frame on the earth; too late, while vision is fused, it goes wrong."""
        late = self.origin is None and self.fusing
        if self.origin is not None and self.local_position_ok:
            self._keep_place(LocalFrame(lat_deg, lon_deg, alt_amsl_m))
        elif late:
            self._wrecked_m = _from_zero_island(lat_deg, lon_deg)
            self.north.x += self._wrecked_m[0]
            self.east.x += self._wrecked_m[1]
            self.reset_counter += 1
        self.origin = LocalFrame(lat_deg, lon_deg, alt_amsl_m)
        self.down.x += alt_amsl_m - self.alt_amsl_m
        self.alt_amsl_m = alt_amsl_m
        self.origin_t_s = self.t_s
        self._history.clear()

    def _keep_place(self, new: LocalFrame) -> None:
        """A second origin moves the numbers, not the place."""
        old = self.origin
        if old is not None:
            lat, lon, alt = old.to_geodetic([self.north.x, self.east.x, self.down.x])
            self.north.x, self.east.x, _ = (float(v) for v in new.to_ned(lat, lon, alt))

    def handle_vision(self, sample: VisionSample) -> None:
        """Fuse external vision as EKF2_EV_CTRL tells; called when it arrives."""
        control = int(self._parameters["EKF2_EV_CTRL"])
        gap_s = self.t_s - self._last_sample_s
        self._last_sample_s = self.t_s
        delay_s = max(0.0, self.t_s - sample.t_s) + self._parameters["EKF2_EV_DELAY"] * 1e-3
        if control == 0 or delay_s > self._parameters["EKF2_DELAY_MAX"] * 1e-3 + 0.1:
            return
        if control & EV_YAW and sample.yaw_rad is not None:
            self._last_vision_yaw_s = self.t_s
            self.attitude.correct_heading(sample.yaw_rad, True, min(gap_s, 0.1))
        if gap_s > _MAX_GAP_S:
            self.fusing = self._fuses_velocity = False
            self._steady_since_s = self.t_s
        jumped = self._vision_reset_counter not in (None, sample.reset_counter)
        if sample.velocity_ned_m_s is None or not control & EV_VELOCITY:
            self._fuses_velocity = False
        elif self._is_steady(gap_s):
            self._handle_velocity(sample.velocity_ned_m_s, sample.velocity_variance, jumped)
        if sample.position_ned_m is None or not control & EV_HORIZONTAL:
            self.fusing = False
        else:
            self._handle_position(self._in_north(sample, control), sample, delay_s, gap_s, jumped)

    def _is_steady(self, gap_s: float) -> bool:
        """Vision comes often enough, and after a loss for long enough, to be begun with."""
        waits = self.lost_in_flight and self.t_s - self._steady_since_s < _RESTART_S
        return gap_s <= _MAX_GAP_S and not waits

    def _handle_velocity(
        self, velocity_ned_m_s: tuple[float, float, float], variance: float, jumped: bool
    ) -> None:
        """One that begins where nothing aids, or is renewed as the only aid, resets.

        Beside a position it begins only where it agrees well.
        """
        axes = (self.north, self.east, self.down)
        off = [v - axis.v for axis, v in zip(axes, velocity_ned_m_s, strict=True)]
        begins = not self._fuses_velocity and not self.fusing
        gate = max(self._parameters["EKF2_EVV_GATE"], 1.0)
        ratios = [axis.velocity_ratio(d, variance, gate) for axis, d in zip(axes, off, strict=True)]
        if begins or (jumped and not self.fusing):
            for axis, v in zip(axes, velocity_ned_m_s, strict=True):
                axis.reset_velocity(v, variance)
        elif max(ratios) < (1.0 if self._fuses_velocity else 0.1):
            for axis, d in zip(axes, off, strict=True):
                axis.fuse_velocity(d, variance)
        else:
            return
        self._fuses_velocity = True
        self._last_velocity_s = self.t_s

    def _in_north(self, sample: VisionSample, control: int) -> tuple[float, float, float]:
        """Turn a LOCAL_FRD position to north, when its yaw is measured but not fused."""
        assert sample.position_ned_m is not None
        north_m, east_m, down_m = sample.position_ned_m
        if not sample.turned_frame or sample.yaw_rad is None or control & EV_YAW:
            return north_m, east_m, down_m
        turn_rad = self.attitude.yaw_rad - sample.yaw_rad
        cos, sin = math.cos(turn_rad), math.sin(turn_rad)
        return cos * north_m - sin * east_m, sin * north_m + cos * east_m, down_m

    def _handle_position(
        self,
        position_ned_m: tuple[float, float, float],
        sample: VisionSample,
        delay_s: float,
        gap_s: float,
        jumped: bool,
    ) -> None:
        north_m, east_m, down_m = position_ned_m
        moved_n, moved_e, moved_d = self._moved_since(self.t_s - delay_s)
        dn = north_m + self._wrecked_m[0] + moved_n - self.north.x
        de = east_m + self._wrecked_m[1] + moved_e - self.east.x
        gate = self._parameters["EKF2_EVP_GATE"]
        ratio_n = self.north.test_ratio(dn, sample.variance_m2, gate)
        self.test_ratio = max(ratio_n, self.east.test_ratio(de, sample.variance_m2, gate))
        if not self._is_steady(gap_s):
            return
        self._vision_reset_counter = sample.reset_counter
        if jumped or not self._is_recent(self._last_fused_s) or self._refused_too_long():
            self._reset_to(self.north.x + dn, self.east.x + de, sample.variance_m2)
        elif self.test_ratio < 1.0:
            self._refused_since_s = None
            self.north.fuse_position(dn, sample.variance_m2)
            self.east.fuse_position(de, sample.variance_m2)
        else:
            self._refused_since_s = self._refused_since_s or self.t_s
            return
        self.fusing = True
        self._last_fused_s = self.t_s
        if self._vision_height:
            self.down.fuse_position(down_m + moved_d - self.down.x, sample.variance_m2)

    def _refused_too_long(self) -> bool:
        since_s = self._refused_since_s
        return since_s is not None and self.t_s - since_s > _RESET_AFTER_S

    def _reset_to(self, north_m: float, east_m: float, variance_m2: float) -> None:
        super()._reset_to(north_m, east_m, variance_m2)
        self._refused_since_s = None


def _from_zero_island(lat_deg: float, lon_deg: float) -> tuple[float, float]:
    """Metres north and east from (0, 0) to an origin, azimuthal equidistant about the origin.

    Setting the origin while the filter runs about latitude 0, longitude 0 moves PX4 1.18's local
    position by this (recorded: 6310841, 3000509 for 60.403 N 22.461 E).
    """
    lat, lon = math.radians(lat_deg), math.radians(lon_deg)
    angle = math.acos(math.cos(lat) * math.cos(lon))
    scale = angle / math.sin(angle) if angle > 1e-9 else 1.0
    north = scale * math.sin(lat) * math.cos(lon)
    east = scale * math.sin(lon)
    return _SPHERE_RADIUS_M * north, _SPHERE_RADIUS_M * east
