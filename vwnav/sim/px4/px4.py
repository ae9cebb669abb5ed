"""The simulated PX4 as a whole: one `step` is 4 ms of airframe, sensors, estimator and control."""

import math

from vwnav.sim.config import VehicleConfig
from vwnav.sim.home import HomePosition
from vwnav.sim.mavlink.command import Severity
from vwnav.sim.multirotor.controller import Controller, Gains
from vwnav.sim.multirotor.setpoint import Setpoint
from vwnav.sim.multirotor.simulated import SimulatedMultirotor
from vwnav.sim.px4.commander import Px4Commander
from vwnav.sim.px4.estimator import Px4Estimator
from vwnav.sim.px4.failsafe import Px4Battery, Px4Health
from vwnav.sim.px4.flight_tasks import FlightTasks
from vwnav.sim.px4.modes import STATE_OF, STICK_STATES, NavState
from vwnav.sim.px4.parameters import NO_GPS, Px4Parameters
from vwnav.sim.px4.pilot import RADIO_SETUP, SWITCH_US, ManualInput
from vwnav.sim.scripted_pilot import ScriptedPilot
from vwnav.vehicle import FlightMode

_LANDED_AFTER_S = 1.0
_PROBATION_S = 1.0  # of a position that came back: Offboard returns 1 to 2 s after the vision
_TEXTS = 32
# Recorded on PX4's own simulated quadrotor: levelled at 41 m/s it slows down by 0.18 of its speed
# per second, and 45 degrees of tilt carry it to 63 m/s. 6 m/s of wind are held with 5.9 degrees.
_DRAG_PER_S = 0.17
# After an origin the declination is looked up and the heading settles (recorded on PX4 1.18: the
# prearm bit is set 5 s after the origin, gone 2 s later, and steady 13 s after it).
_HEADING_UNSETTLED_S = ((0.0, 5.0), (7.0, 13.0))


class SimulatedPx4(SimulatedMultirotor):
    """State of the vehicle; `step` advances it, MAVLink reads and commands it.

    Args:
        config: where it stands and what goes wrong.
        parameters: kept over a reboot, fresh ones when None.

    Attributes:
        old: as PX4 of the 1.16 era.
    """

    estimator: Px4Estimator
    battery: Px4Battery

    def __init__(self, config: VehicleConfig, parameters: Px4Parameters | None = None) -> None:
        super().__init__(config, _DRAG_PER_S, _TEXTS)
        self.parameters = parameters or _parameters(config)
        heading_rad = self._compass_heading_rad
        self.estimator = Px4Estimator(heading_rad, config.home_alt_amsl_m, self.parameters)
        self.controller = Controller(gains_of(self.parameters), heading_rad)
        self.battery = Px4Battery(config.battery_start, self.parameters)
        self.tasks = FlightTasks(self.parameters)
        self.old = config.manners == "px4-1.16"
        self.commander = Px4Commander(self.parameters, self.say, self.old)
        self.manual = ManualInput(self.parameters, self.old)
        self.pilot = ScriptedPilot(config.pilot, self.manual, SWITCH_US)
        self.offboard: Setpoint | None = None
        self.offboard_s = -math.inf
        self._position_lost_s = 0.0
        self._state = NavState.HOLD
        self.health = self._health()

    @property
    def flight_mode(self) -> FlightMode:
        """The state as a navigator calls it; one of the sticks that nobody chose is no pilot's.

        Unless there are sticks.
        """
        state, has_sticks = self.commander.state, self.manual.available(self.t_s)
        if state in STICK_STATES and not ({self.commander.intended} & STICK_STATES or has_sticks):
            return FlightMode.OTHER
        return next((each for each, same in STATE_OF.items() if same is state), FlightMode.MANUAL)

    def begin_in_flight(
        self,
        place_ned_m: tuple[float, float, float],
        velocity_ned_m_s: tuple[float, float, float],
        heading_rad: float,
        mode: FlightMode,
    ) -> None:
        """Fly steadily, now, as if it had come there on vision; NED about the start place.

        The origin is the start place when none was set. What it is asked to do lasts as long as
        any setpoint.
        """
        estimator = self.estimator
        if estimator.origin is None:
            frame = self.start_frame
            estimator.set_origin(frame.lat_deg, frame.lon_deg, frame.alt_amsl_m)
        estimator.origin_t_s = min(estimator.origin_t_s, self.t_s - _HEADING_UNSETTLED_S[-1][1])
        self._fly_at(place_ned_m, velocity_ned_m_s, heading_rad)
        self._position_lost_s = self.t_s - _PROBATION_S
        home = self.start_frame
        self.set_home(home.lat_deg, home.lon_deg, home.alt_amsl_m)
        state = STATE_OF[mode]
        self.commander.begin_in_flight(state, self.t_s)
        self._state = state
        self.tasks.enter(state, estimator)
        self.controller.reset()
        (vn, ve, vd), yaw_rad = velocity_ned_m_s, estimator.attitude.yaw_rad
        self.set_target(Setpoint(vn_m_s=vn, ve_m_s=ve, vd_m_s=vd, yaw_rad=yaw_rad))
        self.look()

    @property
    def _motors_turn(self) -> bool:
        return self.commander.armed

    def stop_motors(self) -> None:
        """By the pilot's kill switch, wherever it is."""
        self.commander.disarm(self.health, forced=True)

    def _decide_all(self, dt_s: float) -> None:
        self.battery.step(self.commander.armed, dt_s)
        self.pilot.step(self.t_s)
        self._detect_landing(dt_s)
        self.look()
        self._hear_pilot()
        self._decide(dt_s)

    def _hear_pilot(self) -> None:
        manual = self.manual
        if manual.wanted is not None:
            self.commander.ask(manual.wanted, self.health)
        elif manual.took_over:
            self.commander.take_over(self.health)
        manual.clear()

    def _decide(self, dt_s: float) -> None:
        was_armed = self.commander.armed
        state = self.commander.step(self.health, self.t_s)
        if state is not self._state:
            self._state = state
            self.tasks.enter(state, self.estimator)
            self._report_entry(state)
        if not self.commander.armed:
            if was_armed:
                self.tasks.enter(state, self.estimator)
            self._place_home()
            self.controller.setpoint = Setpoint(idle=True)
            return
        self.controller.setpoint = self.tasks.step(
            self.estimator, self.manual.sticks, self.offboard, self.landed, dt_s
        )
        if self.tasks.finished:
            self.commander.finish_takeoff()

    def _report_entry(self, state: NavState) -> None:
        if not self.commander.armed:
            return
        if state is NavState.LAND:
            self.say(Severity.INFO, "Landing at current position\t")
        elif state is NavState.RETURN and self.home is not None:
            here = self.estimator
            away_m = math.hypot(
                here.north.x - self.home.local_m[0], here.east.x - self.home.local_m[1]
            )
            present_m = self.home.local_m[2] - here.down.x
            height_m = max(present_m, self.tasks.return_height_m(away_m))
            top_m = self.home.alt_amsl_m + height_m
            self.say(
                Severity.INFO,
                f"RTL: start return at {top_m:.0f} m ({height_m:.0f} m above destination)\t",
            )

    def look(self) -> None:
        """Take stock now: a command right behind the first setpoint counts on it."""
        self.health = self._health()

    def _health(self) -> Px4Health:
        estimator, t_s = self.estimator, self.t_s
        get = self.parameters
        if not estimator.local_position_ok:
            self._position_lost_s = t_s
        position_ok = t_s - self._position_lost_s >= _PROBATION_S
        fresh = t_s - self.offboard_s < get["COM_OF_LOSS_T"]
        heard = self.gcs_heard_s
        since_origin_s = t_s - estimator.origin_t_s
        settling = any(a <= since_origin_s < b for a, b in _HEADING_UNSETTLED_S)
        return Px4Health(
            local_position_ok=position_ok,
            global_position_ok=position_ok and estimator.origin is not None,
            heading_ok=not settling,
            position_accurate=self._is_accurate(),
            position_stable=not estimator.origin_broken,
            offboard_ok=fresh and position_ok,
            manual_ok=self.manual.available(t_s),
            gcs_lost=heard is None or t_s - heard > get["COM_DL_LOSS_T"],
            battery_warning=self.battery.warning,
            landed=self.landed,
            fence_breached=self._outside_fence(),
        )

    def _is_accurate(self) -> bool:
        """Within COM_POS_FS_EPH, 2.5 times that once it was; on the ground nobody asks here."""
        if not self.commander.armed:
            return True
        limit_m = self.parameters["COM_POS_FS_EPH"] * (2.5 if self.health.position_accurate else 1)
        return self.estimator.sigma_horizontal_m < limit_m

    def _outside_fence(self) -> bool:
        home, estimator = self.home, self.estimator
        reach, top = self.parameters["GF_MAX_HOR_DIST"], self.parameters["GF_MAX_VER_DIST"]
        if home is None or not estimator.local_position_ok:
            return False
        north, east, down = home.local_m
        far = math.hypot(estimator.north.x - north, estimator.east.x - east)
        return 0.0 < reach < far or 0.0 < top < down - estimator.down.x

    def _detect_landing(self, dt_s: float) -> None:
        """Landed after a second on the ground, by its own estimate still, without a push to leave.

        As PX4's land detector: a velocity that it believes in keeps it armed on the ground
        (recorded: 8 s, while estimates of 60 m/s came).
        """
        estimator = self.estimator
        speed_m_s = math.hypot(estimator.north.v, estimator.east.v)
        moving = estimator.local_position_ok and speed_m_s > self.parameters["LNDMC_XY_VEL_MAX"]
        landed = self._stands(dt_s, _LANDED_AFTER_S, moving)
        if landed and not self.landed:
            self.say(Severity.INFO, "Landing detected\t")
        self.landed = landed

    def _place_home(self) -> None:
        """While disarmed, home is where it stands, once a second and as soon as it is known."""
        known = self.home is not None and self.t_s - self.home.t_s < 1.0
        if not known and self.health.global_position_ok and self.landed:
            self.set_home_here()

    def set_home_here(self) -> bool:
        """Home becomes the present position; False without a global one."""
        place = self.estimator.geodetic()
        if place is None or not self.health.global_position_ok:
            return False
        estimator = self.estimator
        local_m = (estimator.north.x, estimator.east.x, estimator.down.x)
        self.home = HomePosition(*place, local_m, self.t_s)
        self.tasks.home = local_m
        return True

    def set_home(self, lat_deg: float, lon_deg: float, alt_amsl_m: float) -> bool:
        """Home becomes a geodetic place; False without an origin."""
        origin = self.estimator.origin
        if origin is None:
            return False
        north, east, down = (float(v) for v in origin.to_ned(lat_deg, lon_deg, alt_amsl_m))
        self.home = HomePosition(lat_deg, lon_deg, alt_amsl_m, (north, east, down), self.t_s)
        self.tasks.home = (north, east, down)
        return True

    def plan_takeoff(self, alt_amsl_m: float | None) -> None:
        """Where a take-off ends: an altitude, or MIS_TAKEOFF_ALT above here."""
        estimator = self.estimator
        if alt_amsl_m is not None:
            self.tasks.takeoff_down_m = estimator.alt_amsl_m - alt_amsl_m
            return
        height_m = self.parameters["MIS_TAKEOFF_ALT"]
        self.tasks.takeoff_down_m = estimator.down.x - height_m
        self.say(Severity.INFO, f"Using default takeoff altitude: {height_m:.1f} m\t")

    def handle_parameter(self) -> None:
        """A parameter was set."""
        self.controller.gains = gains_of(self.parameters)

    def set_target(self, setpoint: Setpoint) -> None:
        """An offboard setpoint arrived."""
        self.offboard, self.offboard_s = setpoint, self.t_s


def _parameters(config: VehicleConfig) -> Px4Parameters:
    preset = () if config.autopilot_defaults else NO_GPS
    radio = RADIO_SETUP if config.pilot.rc_on else ()
    own = (("MAV_SYS_ID", float(config.system_id)), ("SIM_BAT_DRAIN", config.battery_drain_s))
    return Px4Parameters((*preset, *radio, *own, *config.parameters))


def gains_of(get: Px4Parameters) -> Gains:
    """As the parameters are now."""
    return Gains(
        xy_p=get["MPC_XY_P"],
        z_p=get["MPC_Z_P"],
        vxy_p=get["MPC_XY_VEL_P_ACC"],
        vxy_i=get["MPC_XY_VEL_I_ACC"],
        vz_p=get["MPC_Z_VEL_P_ACC"],
        vz_i=get["MPC_Z_VEL_I_ACC"],
        v_max_m_s=get["MPC_XY_VEL_MAX"],
        up_max_m_s=get["MPC_Z_VEL_MAX_UP"],
        down_max_m_s=get["MPC_Z_VEL_MAX_DN"],
        hover=max(0.1, get["MPC_THR_HOVER"]),
        thrust_min=get["MPC_THR_MIN"],
        thrust_max=get["MPC_THR_MAX"],
        tilt_max_rad=math.radians(get["MPC_TILTMAX_AIR"]),
        roll_p=get["MC_ROLL_P"],
        pitch_p=get["MC_PITCH_P"],
        yaw_p=get["MC_YAW_P"],
        rate_p=get["MC_ROLLRATE_P"],
    )
