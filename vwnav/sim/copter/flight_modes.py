"""What each flight mode asks of the controller, with ArduCopter's speeds and accelerations."""

import math
from enum import Enum

from vwnav.sim.copter.estimator import CopterEstimator
from vwnav.sim.copter.modes import NEEDS_POSITION, STICK_MODES, Mode
from vwnav.sim.copter.parameters import CopterParameters
from vwnav.sim.multirotor.airframe import GRAVITY_M_S2
from vwnav.sim.multirotor.motion import VelocitySmoother
from vwnav.sim.multirotor.setpoint import Setpoint
from vwnav.sim.scripted_pilot import Sticks

SPOOL_UP_S = 3.2  # from arming to the first thrust
_REACHED_M = 0.3
_HOME_RADIUS_M = 1.0
_BRAKE_M_S2 = 5.0
_LEAST_M_S2 = 0.1
_LOITER_BRAKE_M_S2, _LOITER_STICK_M_S2 = 2.5, 3.0
_STICK_DEADZONE = 0.05
_STICK_CLIMB_M_S = 2.5  # PILOT_SPEED_UP


class RtlState(Enum):
    """Of RTL."""

    CLIMB = "climb"
    RETURN = "return"
    LOITER = "loiter"
    LAND = "land"


class FlightModes:
    """Makes the Setpoint of the present mode; `enter` when the mode changes.

    Attributes:
        takeoff_down_m: where a take-off ends, None while there is none.
        holds_position: the horizontal position is controlled.
        home: north, east, down (m) of home in the local frame, None before it is known.
    """

    def __init__(self, parameters: CopterParameters) -> None:
        self._parameters = parameters
        self.home: tuple[float, float, float] | None = None
        self.takeoff_down_m: float | None = None
        self.holds_position = False
        self._mode = Mode.STABILIZE
        self._motion = VelocitySmoother()
        self._target: Setpoint | None = None
        self._target_age_s = 0.0
        self._pause_s = 0.0
        self._rtl_state = RtlState.CLIMB
        self._loitered_s = 0.0
        self._resets = 0

    @property
    def landing(self) -> bool:
        """It comes down to land, for EXTENDED_SYS_STATE."""
        return self._mode is Mode.LAND or (
            self._mode is Mode.RTL and self._rtl_state is RtlState.LAND
        )

    def enter(self, mode: Mode, estimate: CopterEstimator, may_hold: bool, pause_s: float) -> None:
        """Start a mode where the vehicle is; LAND comes down after a pause."""
        self._mode = mode
        self.holds_position = mode in NEEDS_POSITION or (mode is Mode.LAND and may_hold)
        self.takeoff_down_m = self._target = None
        self._pause_s = pause_s
        self._resets = estimate.reset_counter
        self._rtl_state, self._loitered_s = RtlState.CLIMB, 0.0
        self._motion.begin(estimate)

    def lose_position(self) -> None:
        """LAND goes on without."""
        if self._mode is Mode.LAND:
            self.holds_position = False

    def handle_target(self, target: Setpoint) -> None:
        """A setpoint arrived: only GUIDED takes it, and ends a take-off for it."""
        if self._mode is Mode.GUIDED:
            self._target, self._target_age_s = target, 0.0
            self.takeoff_down_m = None

    def step(
        self, estimate: CopterEstimator, sticks: Sticks, armed_s: float, landed: bool, dt_s: float
    ) -> Setpoint:
        """The setpoint for the next `dt_s`; `armed_s` is how long it has been armed."""
        if landed and self._rests(sticks):
            return Setpoint(idle=True)
        self._follow_resets(estimate)
        match self._mode:
            case Mode.GUIDED if self.takeoff_down_m is not None:
                return self._takeoff(estimate, self.takeoff_down_m, armed_s, dt_s)
            case Mode.GUIDED:
                return self._guided(estimate, dt_s)
            case Mode.LOITER:
                return self._loiter(estimate, sticks, dt_s)
            case Mode.RTL:
                return self._return(estimate, dt_s)
            case Mode.LAND:
                return self._land(estimate, dt_s)
            case Mode.STABILIZE | Mode.ALT_HOLD:
                return self._tilt(estimate, sticks)
            case _:
                return self._motion.stop_and_stay(estimate, _BRAKE_M_S2 * dt_s)

    def _follow_resets(self, estimate: CopterEstimator) -> None:
        """Where the estimate jumps, the place to stay at jumps with it."""
        if estimate.reset_counter != self._resets:
            self._resets = estimate.reset_counter
            if self._motion.anchor is not None:
                (north, east), (dn, de) = self._motion.anchor, estimate.reset_ne_m
                self._motion.anchor = (north + dn, east + de)

    def _rests(self, sticks: Sticks) -> bool:
        """On the ground only a take-off or the pilot starts the climb."""
        if self._mode in STICK_MODES:
            return _climb(sticks) <= 0.0
        return self.takeoff_down_m is None

    def _takeoff(
        self, estimate: CopterEstimator, top_m: float, armed_s: float, dt_s: float
    ) -> Setpoint:
        if armed_s < SPOOL_UP_S:
            return Setpoint(idle=True)
        motion, left_m = self._motion, estimate.down.x - top_m
        if left_m < _REACHED_M:  # from now on it stays there
            self.takeoff_down_m, motion.anchor_down_m = None, top_m
        if motion.anchor is None:
            motion.anchor = (estimate.north.x, estimate.east.x)
        acceleration = self._climb_m_s2
        top_speed = min(self._cm("WPNAV_SPEED_UP"), math.sqrt(acceleration * max(0.1, left_m)))
        self._slew_down(-top_speed, dt_s)
        north, east = motion.anchor
        return Setpoint(north_m=north, east_m=east, vd_m_s=motion.vd_m_s, yaw_rad=motion.yaw_rad)

    def _guided(self, estimate: CopterEstimator, dt_s: float) -> Setpoint:
        """Follow; after GUID_TIMEOUT without a setpoint stop and stay."""
        self._target_age_s += dt_s
        target, motion = self._target, self._motion
        step_m_s = self._accelerate_m_s2 * dt_s
        if target is None or self._target_age_s > self._parameters["GUID_TIMEOUT"]:
            return motion.stop_and_stay(estimate, step_m_s)
        motion.anchor = motion.anchor_down_m = None
        if target.yaw_rad is not None:
            motion.yaw_rad = target.yaw_rad
        vn, ve, vd = self._wanted_velocity(target, estimate)
        motion.slew(vn, ve, step_m_s)
        self._slew_down(vd, dt_s)
        return Setpoint(
            vn_m_s=motion.vn_m_s, ve_m_s=motion.ve_m_s, vd_m_s=motion.vd_m_s,
            yaw_rad=motion.yaw_rad, yaw_rate_rad_s=target.yaw_rate_rad_s,
        )  # fmt: skip

    def _wanted_velocity(
        self, target: Setpoint, estimate: CopterEstimator
    ) -> tuple[float, float, float]:
        """Of the setpoint, or towards its position."""
        wanted = []
        for place, speed, axis in (
            (target.north_m, target.vn_m_s, estimate.north),
            (target.east_m, target.ve_m_s, estimate.east),
            (target.down_m, target.vd_m_s, estimate.down),
        ):
            wanted.append((speed or 0.0) if place is None else place - axis.x)
        return wanted[0], wanted[1], wanted[2]

    def _loiter(self, estimate: CopterEstimator, sticks: Sticks, dt_s: float) -> Setpoint:
        """Sticks lead the velocity; centred they brake and hold the place."""
        motion = self._motion
        forward, right = _dead(sticks.pitch), _dead(sticks.roll)
        deflection = math.hypot(forward, right)
        if deflection > 0.0:
            motion.anchor = None
            yaw_rad, speed = estimate.attitude.yaw_rad, self._cm("LOIT_SPEED")
            cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
            vn = speed * (cos * forward - sin * right)
            ve = speed * (sin * forward + cos * right)
            motion.slew(vn, ve, _LOITER_STICK_M_S2 * deflection * dt_s)
            sp = Setpoint(vn_m_s=motion.vn_m_s, ve_m_s=motion.ve_m_s, yaw_rad=motion.yaw_rad)
            motion.anchor_down_m = motion.anchor_down_m or estimate.down.x
            sp.down_m = motion.anchor_down_m
        else:
            sp = motion.stop_and_stay(estimate, _LOITER_BRAKE_M_S2 * dt_s)
        if climb := _climb(sticks):
            sp.down_m = motion.anchor_down_m = None
            sp.vd_m_s = motion.vd_m_s = -_STICK_CLIMB_M_S * climb
        return sp

    def _return(self, estimate: CopterEstimator, dt_s: float) -> Setpoint:
        """Climb to RTL_ALT, fly home, wait, land."""
        motion, home = self._motion, self.home or (0.0, 0.0, 0.0)
        top_m = min(home[2] - self._cm("RTL_ALT"), estimate.down.x)
        dn, de = home[0] - estimate.north.x, home[1] - estimate.east.x
        match self._rtl_state:
            case RtlState.CLIMB:
                sp = motion.stop_and_stay(estimate, self._accelerate_m_s2 * dt_s)
                motion.anchor_down_m = top_m
                is_stopped = motion.anchor is not None
                if is_stopped and estimate.down.x < home[2] - self._cm("RTL_ALT") + _REACHED_M:
                    self._rtl_state = RtlState.RETURN
                sp.down_m, sp.vd_m_s = top_m, None
                return sp
            case RtlState.RETURN:
                motion.steer(dn, de, self._cm("WPNAV_SPEED"), self._accelerate_m_s2, dt_s)
                if math.hypot(dn, de) < _HOME_RADIUS_M:
                    self._rtl_state, motion.anchor = RtlState.LOITER, (home[0], home[1])
                return Setpoint(
                    vn_m_s=motion.vn_m_s, ve_m_s=motion.ve_m_s,
                    down_m=motion.anchor_down_m, yaw_rad=motion.yaw_rad,
                )  # fmt: skip
            case RtlState.LOITER:
                self._loitered_s += dt_s
                if self._loitered_s > 1e-3 * self._parameters["RTL_LOIT_TIME"]:
                    self._rtl_state = RtlState.LAND
                return motion.stop_and_stay(estimate, _BRAKE_M_S2 * dt_s)
            case RtlState.LAND:
                return self._land(estimate, dt_s)

    def _land(self, estimate: CopterEstimator, dt_s: float) -> Setpoint:
        """Come down, slower below LAND_ALT_LOW; level where there is no position to hold."""
        motion = self._motion
        self._pause_s -= dt_s
        down_m_s = 0.0 if self._pause_s > 0.0 else self._landing_speed(estimate)
        self._slew_down(down_m_s, dt_s)
        if not self.holds_position:
            return Setpoint(an_m_s2=0.0, ae_m_s2=0.0, vd_m_s=motion.vd_m_s, yaw_rad=motion.yaw_rad)
        vd_m_s = motion.vd_m_s
        sp = motion.stop_and_stay(estimate, self._accelerate_m_s2 * dt_s)
        motion.vd_m_s = sp.vd_m_s = vd_m_s
        sp.down_m = None
        return sp

    def _landing_speed(self, estimate: CopterEstimator) -> float:
        ground_m = self.home[2] if self.home is not None else 0.0
        above_m = ground_m - estimate.down.x - self._cm("LAND_ALT_LOW")
        slow = self._cm("LAND_SPEED")
        fast = self._cm("LAND_SPEED_HIGH") or self._cm("WPNAV_SPEED_DN")
        return min(fast, max(slow, math.sqrt(2.0 * self._climb_m_s2 * max(0.0, above_m))))

    def _tilt(self, estimate: CopterEstimator, sticks: Sticks) -> Setpoint:
        """STABILIZE and ALT_HOLD: sticks are tilt; the throttle is thrust, or climbs."""
        slope = GRAVITY_M_S2 * math.tan(math.radians(self._cm("ANGLE_MAX")))
        forward, right = slope * _dead(sticks.pitch), slope * _dead(sticks.roll)
        cos, sin = math.cos(estimate.attitude.yaw_rad), math.sin(estimate.attitude.yaw_rad)
        sp = Setpoint(
            an_m_s2=cos * forward - sin * right,
            ae_m_s2=sin * forward + cos * right,
            yaw_rad=self._motion.yaw_rad,
        )
        if self._mode is Mode.STABILIZE:
            sp.thrust = sticks.throttle
        else:
            sp.vd_m_s = -_STICK_CLIMB_M_S * _climb(sticks)
        return sp

    @property
    def _climb_m_s2(self) -> float:
        return max(_LEAST_M_S2, self._cm("WPNAV_ACCEL_Z"))

    @property
    def _accelerate_m_s2(self) -> float:
        return max(_LEAST_M_S2, self._cm("WPNAV_ACCEL"))

    def _slew_down(self, vd_m_s: float, dt_s: float) -> None:
        motion, step = self._motion, self._climb_m_s2 * dt_s
        motion.vd_m_s += min(max(vd_m_s - motion.vd_m_s, -step), step)

    def _cm(self, name: str) -> float:
        """A parameter in hundredths, as a number in whole units."""
        return 0.01 * self._parameters[name]


def _climb(sticks: Sticks) -> float:
    """-1..1."""
    return _dead(2.0 * (sticks.throttle - 0.5))


def _dead(stick: float) -> float:
    """A stick without its dead zone, -1..1."""
    past = max(0.0, abs(stick) - _STICK_DEADZONE) / (1.0 - _STICK_DEADZONE)
    return math.copysign(min(1.0, past), stick)
