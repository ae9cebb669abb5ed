"""The simulated ArduCopter as a whole: one `step` is 4 ms of airframe, sensors and control."""

import math

from vwnav.sim.config import VehicleConfig
from vwnav.sim.copter.commander import CopterCommander
from vwnav.sim.copter.estimator import CopterEstimator
from vwnav.sim.copter.failsafes import CopterBattery, CopterHealth, Failsafes
from vwnav.sim.copter.flight_modes import SPOOL_UP_S, FlightModes
from vwnav.sim.copter.modes import MODE_OF, Mode
from vwnav.sim.copter.parameters import NO_GPS, CopterParameters
from vwnav.sim.copter.radio import SETUP, SWITCH_US, Radio
from vwnav.sim.home import HomePosition
from vwnav.sim.mavlink.command import Landed, Result, Severity
from vwnav.sim.multirotor.controller import Controller, Gains
from vwnav.sim.multirotor.setpoint import Setpoint
from vwnav.sim.multirotor.simulated import SimulatedMultirotor
from vwnav.sim.scripted_pilot import ScriptedPilot
from vwnav.vehicle import FlightMode

_TEXTS = 64
_DRAG_PER_S = 0.384  # recorded: 7 degrees of tilt carry it at 3 m/s
_LANDED_AFTER_S, _DISARMED_AFTER_S = 1.6, 0.4  # of touch-down, of landing
_SETTLED_S = 12.0  # after the origin until it may be armed
_FAILSAFE_PAUSE_S = 4.0  # LAND_WITH_DELAY_MS
_BOOT_TEXTS = (
    (0.5, "Calibrating barometer"),
    (2.1, "Barometer 1 calibration complete"),
    (2.7, "ArduPilot Ready"),
    (4.7, "EKF3 IMU0 initialised"),
    (4.7, "AHRS: EKF3 active"),
    (6.0, "EKF3 IMU0 tilt alignment complete"),
    (6.1, "EKF3 IMU0 MAG0 initial yaw alignment complete"),
)
_GAINS = Gains(
    xy_p=1.0, z_p=1.0, vxy_p=2.0, vxy_i=1.0, vz_p=5.0, vz_i=2.0,
    v_max_m_s=20.0, up_max_m_s=5.0, down_max_m_s=5.0,
    hover=0.5, thrust_min=0.1, thrust_max=1.0, tilt_max_rad=math.radians(30.0),
    roll_p=6.5, pitch_p=6.5, yaw_p=2.8, rate_p=0.15,
)  # fmt: skip


class SimulatedCopter(SimulatedMultirotor):
    """State of the vehicle; `step` advances it, MAVLink reads and commands it.

    Args:
        config: where it stands and what goes wrong.
        parameters: kept over a reboot, fresh ones when None.
    """

    estimator: CopterEstimator
    battery: CopterBattery

    def __init__(self, config: VehicleConfig, parameters: CopterParameters | None = None) -> None:
        super().__init__(config, _DRAG_PER_S, _TEXTS)
        self.parameters = parameters or _parameters(config)
        heading_rad = self._compass_heading_rad
        self.estimator = CopterEstimator(heading_rad, config.home_alt_amsl_m, self.parameters)
        self.controller = Controller(_GAINS, heading_rad)
        self.battery = CopterBattery(config.battery_start, config.battery_drain_s, self.parameters)
        self.commander = CopterCommander(self.parameters, self.say)
        self.failsafes = Failsafes(self.parameters, self.battery, self.say)
        self.modes = FlightModes(self.parameters)
        self.radio = Radio(self.parameters)
        self.pilot = ScriptedPilot(config.pilot, self.radio, SWITCH_US)
        self._landed_s = 0.0
        self._changes = 0
        self._boot_texts = list(_BOOT_TEXTS)

    @property
    def flight_mode(self) -> FlightMode:
        """The mode as a navigator calls it."""
        return next(
            (each for each, mode in MODE_OF.items() if mode is self.commander.mode),
            FlightMode.MANUAL,
        )

    def begin_in_flight(
        self,
        place_ned_m: tuple[float, float, float],
        velocity_ned_m_s: tuple[float, float, float],
        heading_rad: float,
        mode: FlightMode,
    ) -> None:
        """Fly steadily, now, as if it had come there on vision; NED about the start place.

        The origin is the start place when none was set.
        """
        estimator, start = self.estimator, self.start_frame
        estimator.set_origin(start.lat_deg, start.lon_deg, start.alt_amsl_m)
        estimator.origin_t_s = min(estimator.origin_t_s, self.t_s - _SETTLED_S)
        self._fly_at(place_ned_m, velocity_ned_m_s, heading_rad)
        self._boot_texts.clear()
        self._place_home_at((0.0, 0.0, 0.0))
        self.commander.begin_in_flight(MODE_OF[mode], self.t_s)
        self._enter_mode(0.0)
        self.controller.reset()
        (vn, ve, vd), yaw_rad = velocity_ned_m_s, estimator.attitude.yaw_rad
        self.set_target(Setpoint(vn_m_s=vn, ve_m_s=ve, vd_m_s=vd, yaw_rad=yaw_rad))

    @property
    def _motors_turn(self) -> bool:
        return self.commander.armed

    def stop_motors(self) -> None:
        """By the pilot's kill switch, wherever it is."""
        self.commander.disarm(self.health, forced=True)

    def _decide_all(self, dt_s: float) -> None:
        self._say_boot_texts()
        self._detect_landing(dt_s)
        self._hear_pilot()
        self._decide(dt_s)

    def _hear_pilot(self) -> None:
        self.pilot.step(self.t_s)
        self.radio.hold_override(self.t_s)
        wanted = self.radio.switched(self.t_s)
        if wanted is not None:
            self.ask(wanted)

    def _decide(self, dt_s: float) -> None:
        commander, health = self.commander, self.health
        for wanted in self.failsafes.step(health, commander.armed, dt_s):
            self._fail_over(wanted, health)
        if self.failsafes.has_lost_position(health, commander.armed, self.t_s):
            self._land_without_position(health)
        commander.check(health, self.t_s)
        if not commander.armed:
            self._place_home()
            self.controller.setpoint = Setpoint(idle=True)
            return
        self.controller.setpoint = self.modes.step(
            self.estimator, self.radio.sticks, self.t_s - commander.armed_s, self.landed, dt_s
        )
        self._disarm_when_down()

    def _fail_over(self, wanted: Mode, health: CopterHealth) -> None:
        """A failsafe chooses the mode; one that lands waits before it comes down."""
        self.commander.force(wanted, health)
        self._follow_commander(_FAILSAFE_PAUSE_S)

    def _land_without_position(self, health: CopterHealth) -> None:
        """The EKF failsafe, in a mode that needs a position; LAND goes on without."""
        if self.modes.holds_position and self.commander.mode is not Mode.LAND:
            self._fail_over(Mode.LAND, health)
            self.say(Severity.CRITICAL, "EKF Failsafe: changed to LAND Mode")
        self.modes.lose_position()

    def ask(self, wanted: Mode) -> Result:
        """Somebody asks for a mode."""
        result = self.commander.ask(wanted, self.health)
        self._follow_commander()
        return result

    def _follow_commander(self, pause_s: float = 0.0) -> None:
        if self.commander.changes != self._changes:
            self._changes = self.commander.changes
            self._enter_mode(pause_s)

    def _enter_mode(self, pause_s: float) -> None:
        may_hold = self.health.may_hold
        self.modes.enter(self.commander.mode, self.estimator, may_hold, pause_s)

    def take_off(self, height_m: float) -> Result:
        """MAV_CMD_NAV_TAKEOFF: in GUIDED, armed and on the ground, to a height over home."""
        commander = self.commander
        is_guided = commander.mode is Mode.GUIDED
        if not (commander.armed and self.landed and is_guided) or height_m <= 0.0:
            return Result.FAILED
        ground_m = self.home.local_m[2] if self.home is not None else self.estimator.down.x
        self.modes.takeoff_down_m = ground_m - height_m
        return Result.ACCEPTED

    def set_target(self, setpoint: Setpoint) -> None:
        """A setpoint arrived."""
        self.modes.handle_target(setpoint)

    @property
    def health(self) -> CopterHealth:
        """What decides about arming and failsafes."""
        estimator, t_s = self.estimator, self.t_s
        heard_s = self.gcs_heard_s
        return CopterHealth(
            position_ok=estimator.position_ok,
            may_hold=estimator.position_ok and not self.failsafes.ekf,
            attitude_ok=estimator.is_aligned,
            vision_ok=estimator.vision_ok,
            settled=estimator.origin is not None and t_s - estimator.origin_t_s > _SETTLED_S,
            gcs_silent_s=math.inf if heard_s is None else t_s - heard_s,
            radio_lost=self.radio.lost(t_s),
            battery_level=self.battery.level,
            landed=self.landed,
        )

    @property
    def landed_state(self) -> Landed:
        """MAV_LANDED_STATE for EXTENDED_SYS_STATE."""
        if self.landed:
            return Landed.ON_GROUND
        if self.modes.takeoff_down_m is not None:
            return Landed.TAKEOFF
        return Landed.LANDING if self.modes.landing else Landed.IN_AIR

    def _detect_landing(self, dt_s: float) -> None:
        """Landed after a while on the ground without a push to leave."""
        landed = self._stands(dt_s, _LANDED_AFTER_S)
        if landed and not self.landed:
            self._landed_s = self.t_s
        self.landed = landed

    def _disarm_when_down(self) -> None:
        """After a landing at once, otherwise when nobody has taken off for DISARM_DELAY."""
        if not self.landed:
            return
        commander = self.commander
        idle_s = self.t_s - max(commander.armed_s, self._landed_s)
        delay_s = self.parameters["DISARM_DELAY"] + SPOOL_UP_S
        if self.modes.landing:
            delay_s = _DISARMED_AFTER_S
        if self.modes.takeoff_down_m is None and idle_s > delay_s:
            commander.stop()

    def _place_home(self) -> None:
        """While disarmed, home is where it stands, once a second and as soon as it is known."""
        known = self.home is not None and self.t_s - self.home.t_s < 1.0
        if not known and self.landed:
            self.set_home_here()

    def set_home_here(self) -> bool:
        """Home becomes the present position; False without a global one."""
        estimator = self.estimator
        if estimator.origin is None or not estimator.position_ok:
            return False
        self._place_home_at((estimator.north.x, estimator.east.x, estimator.down.x))
        return True

    def set_home(self, lat_deg: float, lon_deg: float, alt_amsl_m: float) -> bool:
        """Home becomes a geodetic place; False without an origin."""
        origin = self.estimator.origin
        if origin is None:
            return False
        north, east, down = (float(v) for v in origin.to_ned(lat_deg, lon_deg, alt_amsl_m))
        self._place_home_at((north, east, down))
        return True

    def _place_home_at(self, local_m: tuple[float, float, float]) -> None:
        origin = self.estimator.origin
        assert origin is not None
        lat, lon, alt = (float(value) for value in origin.to_geodetic(list(local_m)))
        self.home = HomePosition(lat, lon, alt, local_m, self.t_s)
        self.modes.home = local_m

    def _say_boot_texts(self) -> None:
        while self._boot_texts and self._boot_texts[0][0] <= self.t_s:
            self.say(Severity.INFO, self._boot_texts.pop(0)[1])


def _parameters(config: VehicleConfig) -> CopterParameters:
    preset = () if config.autopilot_defaults else NO_GPS
    radio = SETUP if config.pilot.rc_on else ()
    own = (("SYSID_THISMAV", float(config.system_id)),)
    return CopterParameters((*preset, *radio, *own, *config.parameters))
