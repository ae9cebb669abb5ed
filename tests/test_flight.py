"""The mission's state machine, against a vehicle that only remembers what it was asked."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from vehicles import FLYING

from vwnav.flight import Flight, FlightConfig, Phase
from vwnav.guidance.controller import LimitsConfig
from vwnav.safety.keepalive import GuardState, WatchdogReport
from vwnav.safety.monitor import SafetyConfig, SafetyMonitor
from vwnav.types import Estimate, FlightMode, VehicleState, VelocitySetpoint

ROUTE = np.array([[60.0, 0.0, -50.0], [60.0, 60.0, -50.0]])
DT_S = 0.1
READY = replace(FLYING, armed=False, in_air=False, mode=FlightMode.HOLD, height_m=0.0)


@dataclass
class Handle:
    """A dead-man's handle that remembers its beats."""

    report: WatchdogReport | None = None
    beats: list[bool] = field(default_factory=list)
    rejoined: int = 0

    def beat(self, engaged: bool, phase: str) -> None:
        self.beats.append(engaged)

    def rejoin(self) -> None:
        self.rejoined += 1


@dataclass
class PointVehicle:
    """Flies each setpoint at once; lands by itself when asked to."""

    position: np.ndarray = field(default_factory=lambda: np.zeros(3))
    velocity: np.ndarray = field(default_factory=lambda: np.zeros(3))
    vehicle: VehicleState = READY
    asked: list[str] = field(default_factory=list)
    refuse: str | None = None
    refusals: int = 10**6
    refuse_takeoff: str | None = None
    deaf_to_land: int = 0

    def state(self) -> VehicleState:
        return self.vehicle

    def arm(self) -> str | None:
        self.asked.append("arm")
        if self.refuse is not None and self.refusals > 0:
            self.refusals -= 1
            return self.refuse
        self.vehicle = replace(self.vehicle, armed=True)
        return None

    def takeoff(self, height_m: float) -> str | None:
        self.asked.append("takeoff")
        if self.refuse_takeoff is not None:
            return self.refuse_takeoff
        self.vehicle = replace(self.vehicle, mode=FlightMode.TAKEOFF, in_air=True)
        self.position[2] = -height_m
        return None

    def disarm(self) -> str | None:
        self.asked.append("disarm")
        self.vehicle = replace(self.vehicle, armed=False)
        return None

    def start_offboard(self) -> str | None:
        self.asked.append("offboard")
        self.vehicle = replace(self.vehicle, mode=FlightMode.OFFBOARD)
        return None

    def land(self) -> str | None:
        self.asked.append("land")
        if self.deaf_to_land > 0:
            self.deaf_to_land -= 1
            return "no answer within 0.45 s"
        self.vehicle = replace(self.vehicle, mode=FlightMode.LAND)
        self.velocity = np.array([0.0, 0.0, 2.0])
        return None

    def send_velocity(self, setpoint: VelocitySetpoint) -> None:
        self.velocity = np.array([setpoint.north_m_s, setpoint.east_m_s, setpoint.down_m_s])

    def move(self) -> None:
        if self.vehicle.mode in (FlightMode.OFFBOARD, FlightMode.LAND):
            self.position = self.position + self.velocity * DT_S
        if self.vehicle.mode is FlightMode.LAND and self.position[2] >= 0.0:
            self.vehicle = replace(self.vehicle, armed=False, in_air=False)


@dataclass
class Scene:
    """A flight, its vehicle, and whether the camera finds the map."""

    vehicle: PointVehicle = field(default_factory=PointVehicle)
    handle: Handle = field(default_factory=Handle)
    said: list[str] = field(default_factory=list)
    fixes: bool = True
    variance: float = 0.25
    t_s: float = 0.0
    t_last_fix_s: float | None = None
    farthest_m: float = 0.0

    def __post_init__(self) -> None:
        self.flight = Flight(
            self.vehicle,
            ROUTE,
            SafetyMonitor(SafetyConfig()),
            self.handle,
            FlightConfig(),
            LimitsConfig(),
            self.said.append,
        )

    def estimate(self) -> Estimate:
        if self.fixes and self.vehicle.position[2] < -20.0:
            self.t_last_fix_s = self.t_s
        return Estimate(
            t_s=self.t_s,
            position_ned_m=self.vehicle.position.copy(),
            velocity_ned_m_s=self.vehicle.velocity.copy(),
            covariance=np.eye(6) * self.variance,
            quat_wxyz=np.array([1.0, 0.0, 0.0, 0.0]),
            sigma_yaw_rad=0.02,
            agl_m=float(-self.vehicle.position[2]),
            sigma_agl_m=0.5,
            t_last_fix_s=self.t_last_fix_s,
            reset_counter=0,
        )

    def run(self, until=lambda scene: False, limit_s: float = 400.0) -> "Scene":
        while self.flight.end is None and self.t_s < limit_s and not until(self):
            self.t_s += DT_S
            self.vehicle.vehicle = replace(self.vehicle.vehicle, t_s=self.t_s)
            self.flight.tick(self.t_s, self.estimate())
            self.vehicle.move()
            self.farthest_m = max(self.farthest_m, float(np.hypot(*self.vehicle.position[:2])))
        return self


def in_phase(phase: Phase):
    return lambda scene: scene.flight.phase is phase


def test_a_whole_route_is_flown_and_ends_landed_at_home():
    scene = Scene().run()
    assert scene.flight.end.reason is None
    assert scene.farthest_m > 80.0
    assert np.hypot(*scene.vehicle.position[:2]) < 2.0
    assert scene.vehicle.asked == ["arm", "takeoff", "offboard", "land"]


def test_without_a_fix_it_stays_above_home_lands_and_says_why():
    scene = Scene(fixes=False).run()
    assert "no fix above home" in scene.flight.end.reason
    assert scene.farthest_m < 1.0


def test_nothing_is_asked_while_the_autopilot_has_no_position():
    scene = Scene()
    scene.vehicle.vehicle = replace(READY, local_position_ok=False)
    scene.run()
    assert scene.vehicle.asked == []
    assert "local position" in scene.flight.end.reason


def test_a_refused_arming_ends_the_flight_with_the_autopilots_words():
    scene = Scene()
    scene.vehicle.refuse = "denied: compass"
    assert "denied: compass" in scene.run().flight.end.reason


def test_a_moments_refusal_to_arm_is_waited_out():
    """PX4 1.18 was ready for 2.1 s, then not for 6 s, while its heading settled."""
    scene = Scene()
    scene.vehicle.refuse, scene.vehicle.refusals = "not now (heading estimate invalid)", 2
    scene.run(in_phase(Phase.TAKEOFF))
    assert scene.flight.phase is Phase.TAKEOFF
    assert sum("heading estimate invalid" in line for line in scene.said) == 2


def test_readiness_of_two_seconds_is_none():
    scene = Scene()
    scene.run(limit_s=2.2)
    assert scene.vehicle.asked == []


def test_an_aircraft_that_arms_but_does_not_take_off_is_disarmed():
    scene = Scene()
    scene.vehicle.refuse_takeoff = "failed"
    scene.run()
    assert scene.vehicle.asked[-1] == "disarm"
    assert "failed" in scene.flight.end.reason


def test_no_setpoint_disturbs_the_autopilots_own_take_off():
    scene = Scene().run(in_phase(Phase.TAKEOFF))
    scene.vehicle.position = np.zeros(3)
    scene.t_last_fix_s, scene.variance = scene.t_s, 12.0**2  # uncertain: a reason to hold
    scene.vehicle.velocity = np.full(3, np.nan)
    scene.vehicle.vehicle = replace(scene.vehicle.vehicle, mode=FlightMode.OFFBOARD)  # GUIDED
    scene.flight.tick(scene.t_s + DT_S, scene.estimate())
    assert np.all(np.isnan(scene.vehicle.velocity)), "a setpoint was sent"


def test_a_landing_that_was_not_heard_is_asked_for_again():
    scene = Scene().run(in_phase(Phase.ROUTE))
    scene.vehicle.deaf_to_land = 3
    scene.flight.abort("interrupted by the operator")
    scene.run()
    assert scene.vehicle.asked[-4:] == ["land"] * 4
    assert sum("refused to land" in line for line in scene.said) == 1
    assert scene.flight.end.reason == "interrupted by the operator"
    assert not scene.vehicle.vehicle.armed


def test_an_estimate_that_is_not_sent_any_more_is_landed_before_the_autopilot_gives_up():
    scene = Scene().run(in_phase(Phase.ROUTE))
    scene.variance, lost_s = 25.0, scene.t_s  # velocity unknown to 5 m/s
    scene.run(in_phase(Phase.LAND))
    assert 1.9 < scene.t_s - lost_s < 3.0
    assert "lost" in scene.run().flight.end.reason


@pytest.mark.parametrize("mode", [FlightMode.MANUAL, FlightMode.HOLD, FlightMode.MISSION])
def test_after_the_pilots_mode_change_nothing_is_asked_again(mode):
    scene = Scene().run(in_phase(Phase.ROUTE))
    scene.run(lambda s: s.farthest_m > 20.0)
    scene.vehicle.vehicle = replace(scene.vehicle.vehicle, mode=mode)
    asked = list(scene.vehicle.asked)
    scene.run(limit_s=scene.t_s + 30.0)
    assert scene.flight.phase is Phase.RELEASED
    assert scene.vehicle.asked == asked
    assert not scene.handle.beats[-1]


def test_a_critical_battery_lands_at_once():
    scene = Scene().run(in_phase(Phase.ROUTE))
    scene.vehicle.vehicle = replace(scene.vehicle.vehicle, battery_ratio=0.05)
    scene.run()
    assert "battery critical" in scene.flight.end.reason


def test_losing_all_fixes_on_the_route_holds_then_comes_home():
    scene = Scene().run(in_phase(Phase.ROUTE))
    scene.fixes = False
    scene.run()
    assert scene.flight.end.reason
    assert np.hypot(*scene.vehicle.position[:2]) < 5.0


def test_an_abort_lands_where_it_is():
    scene = Scene().run(in_phase(Phase.ROUTE))
    scene.flight.abort("interrupted by the operator")
    scene.run()
    assert scene.flight.end.reason == "interrupted by the operator"


def test_the_watchdog_keeps_what_it_took():
    scene = Scene().run(in_phase(Phase.ROUTE))
    scene.handle.report = WatchdogReport(GuardState.LANDING, 1, 0.1)
    scene.run(limit_s=scene.t_s + 5.0)
    assert scene.flight.phase is Phase.RELEASED


def test_a_short_stall_is_taken_back_from_a_braking_watchdog():
    scene = Scene().run(in_phase(Phase.ROUTE))
    scene.handle.report = WatchdogReport(GuardState.BRAKING, 1, 0.1)
    scene.run(limit_s=scene.t_s + 0.15)
    assert scene.handle.rejoined
    assert scene.flight.phase is Phase.ROUTE


def test_the_dead_mans_handle_is_held_exactly_while_we_steer():
    scene = Scene().run()
    assert any(scene.handle.beats)
    assert not scene.handle.beats[0]
    assert not scene.handle.beats[-1]
