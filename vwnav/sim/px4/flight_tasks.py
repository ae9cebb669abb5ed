"""What each navigation state asks of the controller: PX4's flight tasks, with its speeds."""

import math

from vwnav.sim.multirotor.airframe import GRAVITY_M_S2
from vwnav.sim.multirotor.motion import VelocitySmoother
from vwnav.sim.multirotor.setpoint import Setpoint
from vwnav.sim.px4.estimator import Px4Estimator
from vwnav.sim.px4.modes import NavState
from vwnav.sim.px4.parameters import Px4Parameters
from vwnav.sim.scripted_pilot import Sticks

_STICK_DEADZONE = 0.05
_REACHED_M = 0.4  # vertical: the take-off is over
_HOME_RADIUS_M = 1.0


class FlightTasks:
    """Makes the Setpoint of the present state; `enter` when the state changes.

    Attributes:
        finished: the take-off has reached its height.
        landing: it is descending to land, for EXTENDED_SYS_STATE.
        home: north, east, down (m) of home in the local frame, None before it is known.
    """

    def __init__(self, parameters: Px4Parameters) -> None:
        self._parameters = parameters
        self.home: tuple[float, float, float] | None = None
        self.takeoff_down_m: float | None = None
        self.finished = False
        self.landing = False
        self._state = NavState.HOLD
        self._motion = VelocitySmoother()
        self._since_s = 0.0
        self._climbed = False

    def enter(self, state: NavState, estimate: Px4Estimator) -> None:
        """Start a state where the vehicle is, with the velocity it has."""
        self._state = state
        self.finished = self._climbed = False
        self.landing = state in (NavState.LAND, NavState.DESCEND)
        self._motion.begin(estimate)
        self._since_s = 0.0

    def step(
        self,
        estimate: Px4Estimator,
        sticks: Sticks,
        offboard: Setpoint | None,
        landed: bool,
        dt_s: float,
    ) -> Setpoint:
        """The setpoint for the next `dt_s` (s)."""
        self._since_s += dt_s
        if landed and self.landing:
            return Setpoint(idle=True)
        match self._state:
            case NavState.OFFBOARD:
                return self._on_ground_idle(offboard or Setpoint(idle=True), estimate, landed)
            case NavState.TAKEOFF:
                return self._takeoff(estimate, landed, dt_s)
            case NavState.RETURN:
                return self._return(estimate, landed, dt_s)
            case NavState.LAND:
                return self._land(estimate, dt_s)
            case NavState.DESCEND:
                speed = self._parameters["MPC_LAND_SPEED"]
                return Setpoint(
                    vd_m_s=speed, an_m_s2=0.0, ae_m_s2=0.0, yaw_rad=self._motion.yaw_rad
                )
            case NavState.POSITION:
                return self._position(estimate, sticks, landed, dt_s)
            case NavState.ALTITUDE | NavState.STABILIZED | NavState.MANUAL:
                return self._tilt(estimate, sticks, landed)
            case _:
                return self._hold(estimate, landed, dt_s)

    def _on_ground_idle(self, sp: Setpoint, estimate: Px4Estimator, landed: bool) -> Setpoint:
        """On the ground only a climb starts the rotors."""
        climbs = (sp.vd_m_s or 0.0) < -0.3
        if sp.down_m is not None:
            climbs = climbs or sp.down_m < estimate.down.x - 0.3
        return Setpoint(idle=True) if landed and not climbs else sp

    def _takeoff(self, estimate: Px4Estimator, landed: bool, dt_s: float) -> Setpoint:
        ready_s = self._since_s - self._parameters["COM_SPOOLUP_TIME"]
        target = self.takeoff_down_m
        if ready_s < 0.0 or target is None:
            return Setpoint(idle=True)
        if landed or self._motion.anchor is None:
            self._motion.anchor = (estimate.north.x, estimate.east.x)
        ramp = min(1.0, ready_s / max(0.1, self._parameters["MPC_TKO_RAMP_T"]))
        # PX4's TakeoffHandling: from the speed error at which the thrust is zero
        start = -GRAVITY_M_S2 / max(0.1, self._parameters["MPC_Z_VEL_P_ACC"])
        climb = start + ramp * (self._parameters["MPC_TKO_SPEED"] - start)
        left_m = estimate.down.x - target
        self.finished = left_m < _REACHED_M
        if left_m < 2.0:
            climb = min(climb, max(0.3, left_m))
        return Setpoint(
            north_m=self._motion.anchor[0],
            east_m=self._motion.anchor[1],
            vd_m_s=-climb,
            yaw_rad=self._motion.yaw_rad,
        )

    def _hold(self, estimate: Px4Estimator, landed: bool, dt_s: float) -> Setpoint:
        if landed:
            return Setpoint(idle=True)
        return self._brake_and_stay(estimate, dt_s)

    def _brake_and_stay(self, estimate: Px4Estimator, dt_s: float) -> Setpoint:
        """Slow down with MPC_ACC_HOR, then keep the place."""
        return self._motion.stop_and_stay(estimate, self._parameters["MPC_ACC_HOR"] * dt_s)

    def _return(self, estimate: Px4Estimator, landed: bool, dt_s: float) -> Setpoint:
        """Climb over the cone about home, fly there, land (RTL_TYPE 0)."""
        if landed or self.home is None:
            return self._hold(estimate, landed, dt_s)
        dn, de = self.home[0] - estimate.north.x, self.home[1] - estimate.east.x
        distance = math.hypot(dn, de)
        top_m = self.home[2] - self.return_height_m(distance)
        self._climbed = self._climbed or estimate.down.x < top_m + _REACHED_M
        if self.landing:
            return self._land(estimate, dt_s)
        if distance < _HOME_RADIUS_M and self._climbed:
            self.landing, self._motion.anchor = True, (self.home[0], self.home[1])
            self._motion.anchor_down_m = None
        if not self._climbed:
            sp = self._brake_and_stay(estimate, dt_s)
            sp.down_m, sp.vd_m_s = None, -self._parameters["MPC_Z_V_AUTO_UP"]
            self._motion.anchor_down_m = min(estimate.down.x, top_m)
            return sp
        get = self._parameters
        self._motion.steer(dn, de, get["MPC_XY_CRUISE"], get["MPC_ACC_HOR"], dt_s)
        down_m = (
            self._motion.anchor_down_m
            if self._motion.anchor_down_m is not None
            else estimate.down.x
        )
        self._motion.anchor_down_m = down_m
        return Setpoint(
            vn_m_s=self._motion.vn_m_s,
            ve_m_s=self._motion.ve_m_s,
            down_m=down_m,
            yaw_rad=self._motion.yaw_rad,
        )

    def return_height_m(self, distance_m: float) -> float:
        """Height over home to return at: RTL_RETURN_ALT, less inside the cone about home."""
        full = self._parameters["RTL_RETURN_ALT"]
        cone_rad = math.radians(self._parameters["RTL_CONE_ANG"])
        cone = 0.0 < cone_rad < 0.5 * math.pi
        return min(full, distance_m / math.tan(cone_rad)) if cone else full

    def _land(self, estimate: Px4Estimator, dt_s: float) -> Setpoint:
        """Hold the place and come down, slower below MPC_LAND_ALT1."""
        sp = self._brake_and_stay(estimate, dt_s)
        get = self._parameters
        ground_m = self.home[2] if self.home is not None else 0.0
        height = ground_m - estimate.down.x
        high, low = get["MPC_LAND_ALT1"], get["MPC_LAND_ALT2"]
        fast, slow = get["MPC_Z_V_AUTO_DN"], get["MPC_LAND_SPEED"]
        share = min(1.0, max(0.0, (height - low) / max(high - low, 0.1)))
        sp.down_m, sp.vd_m_s = None, slow + share * (fast - slow)
        return sp

    def _position(
        self, estimate: Px4Estimator, sticks: Sticks, landed: bool, dt_s: float
    ) -> Setpoint:
        """Sticks are velocities; centred they hold the place."""
        climb = 2.0 * _dead(2.0 * (sticks.throttle - 0.5))
        if landed and climb <= 0.0:
            return Setpoint(idle=True)
        sp = self._brake_and_stay(estimate, dt_s)
        forward, right = _dead(sticks.pitch), _dead(sticks.roll)
        if forward or right:
            speed = self._parameters["MPC_VEL_MANUAL"]
            yaw = estimate.attitude.yaw_rad
            cos, sin = math.cos(yaw), math.sin(yaw)
            self._motion.vn_m_s = speed * (cos * forward - sin * right)
            self._motion.ve_m_s = speed * (sin * forward + cos * right)
            sp.north_m = sp.east_m = self._motion.anchor = None
            sp.vn_m_s, sp.ve_m_s = self._motion.vn_m_s, self._motion.ve_m_s
        self._vertical_and_yaw(sp, sticks, climb)
        return sp

    def _vertical_and_yaw(self, sp: Setpoint, sticks: Sticks, climb: float) -> None:
        get = self._parameters
        if climb:
            limit = get["MPC_Z_VEL_MAX_UP"] if climb > 0.0 else get["MPC_Z_VEL_MAX_DN"]
            self._motion.vd_m_s = -climb * limit / 2.0
            sp.down_m = self._motion.anchor_down_m = None
            sp.vd_m_s = self._motion.vd_m_s
        turn = _dead(sticks.yaw)
        if turn:
            sp.yaw_rad = self._motion.yaw_rad = None
            sp.yaw_rate_rad_s = turn * math.radians(get["MPC_MAN_Y_MAX"])

    def _tilt(self, estimate: Px4Estimator, sticks: Sticks, landed: bool) -> Setpoint:
        """Altitude and Stabilized: sticks are tilt; the throttle climbs or is thrust itself."""
        get = self._parameters
        slope = GRAVITY_M_S2 * math.tan(math.radians(get["MPC_MAN_TILT_MAX"]))
        forward, right = slope * _dead(sticks.pitch), slope * _dead(sticks.roll)
        yaw = estimate.attitude.yaw_rad
        cos, sin = math.cos(yaw), math.sin(yaw)
        sp = Setpoint(
            an_m_s2=cos * forward - sin * right,
            ae_m_s2=sin * forward + cos * right,
            yaw_rad=self._motion.yaw_rad,
        )
        climb = 2.0 * _dead(2.0 * (sticks.throttle - 0.5))
        if self._state is not NavState.ALTITUDE:
            sp.thrust, climb = sticks.throttle, 0.0
        elif landed and climb <= 0.0:
            return Setpoint(idle=True)
        elif not climb:
            if self._motion.anchor_down_m is None:
                self._motion.anchor_down_m = estimate.down.x
            sp.down_m = self._motion.anchor_down_m
        self._vertical_and_yaw(sp, sticks, climb)
        if sp.yaw_rad is None and not sp.yaw_rate_rad_s:
            self._motion.yaw_rad = yaw
        return sp


def _dead(stick: float) -> float:
    """A stick without its dead zone, -1..1."""
    past = max(0.0, abs(stick) - _STICK_DEADZONE) / (1.0 - _STICK_DEADZONE)
    return math.copysign(min(1.0, past), stick)
