"""The mission's state machine, against a vehicle that only remembers what it was asked."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from vehicles import FLYING

from vwnav.flight import Flight
from vwnav.guidance.limits import LimitsConfig
from vwnav.mission.config import FlightConfig
from vwnav.mission.mission import Crew, Mission, Phase
from vwnav.safety.check import Check
from vwnav.safety.monitor import SafetyConfig
from vwnav.types import Estimate
from vwnav.vehicle import FlightMode, Navigation, Order, Request, VehicleState, VelocitySetpoint
from vwnav.watchdog.keepalive import GuardState, WatchdogReport

ROUTE = np.array([[60.0, 0.0, -50.0], [60.0, 60.0, -50.0]])
DT_S = 0.1
READY = replace(
    FLYING,
    rc_available=False,
    armed=False,
    in_air=False,
    mode=FlightMode.HOLD,
    intended_mode=FlightMode.HOLD,
    height_m=0.0,
)
NOT_READY = Check("autopilot", "FAIL", "it reports no local position")


@dataclass
class Handle:
    """A dead-man's handle that remembers its beats."""

    report: WatchdogReport | None = None
    beats: list[bool] = field(default_factory=list)
    rejoined: int = 0

    def beat(self, engaged: bool, phase: str, learned: object = None) -> None:
        self.beats.append(engaged)

    def rejoin(self) -> None:
        self.rejoined += 1


@dataclass
class PointVehicle:
    """Flies each setpoint at once; answers a command `answers_after` ticks later.

    A command that is refused or unheard changes nothing.
    """

    position: np.ndarray = field(default_factory=lambda: np.zeros(3))
    velocity: np.ndarray = field(default_factory=lambda: np.zeros(3))
    vehicle: VehicleState = READY
    asked: list[str] = field(default_factory=list)
    refuse: dict[str, list[str]] = field(default_factory=dict)  # words, one for each asking
    answers_after: int = 1
    stays_armed: bool = False
    setpoints: int = 0
    texts: list[str] = field(default_factory=list)
    warned: list[str] = field(default_factory=list)
    under_way: tuple[str, Request, int] | None = None

    def state(self) -> VehicleState:
        return self.vehicle

    def ask(self, name: str) -> Request:
        self.asked.append(name)
        self.withdraw()
        request = Request()
        self.under_way = (name, request, self.answers_after)
        return request

    def withdraw(self) -> None:
        if self.under_way is not None:
            self.under_way[1].done, self.under_way[1].refused = True, "replaced by a newer command"
        self.under_way = None

    def arm(self) -> Request:
        return self.ask("arm")

    def takeoff(self, height_m: float) -> Request:
        return self.ask("takeoff")

    def stand_by(self) -> Request:
        return self.ask("stand by")

    def disarm(self) -> Request:
        return self.ask("disarm")

    def start_offboard(self) -> Request:
        return self.ask("offboard")

    def hold(self) -> Request:
        return self.ask("hold")

    def land(self) -> Request:
        return self.ask("land")

    def send_text(self, text: str, warns: bool = True) -> None:
        self.texts.append(text)
        self.warned += [text] if warns else []

    def send_velocity(self, setpoint: VelocitySetpoint) -> None:
        self.setpoints += 1
        if self.vehicle.mode is FlightMode.OFFBOARD:
            self.velocity = np.array([setpoint.north_m_s, setpoint.east_m_s, setpoint.down_m_s])

    def be(self, **changes) -> None:
        """A change of the vehicle's state; a mode alone is one that a person chose."""
        if "mode" in changes and "intended_mode" not in changes:
            changes["intended_mode"] = changes["mode"]
        self.vehicle = replace(self.vehicle, **changes)

    def move(self) -> None:
        self.answer()
        if self.vehicle.mode in (FlightMode.OFFBOARD, FlightMode.LAND):
            self.position = self.position + self.velocity * DT_S
        if self.vehicle.mode is FlightMode.LAND and self.position[2] >= 0.0:
            self.be(armed=self.stays_armed, in_air=False)

    def answer(self) -> None:
        if self.under_way is None:
            return
        name, request, ticks = self.under_way
        if ticks > 1:
            self.under_way = (name, request, ticks - 1)
            return
        self.under_way = None
        words = self.refuse.get(name)
        request.done, request.refused = True, words.pop(0) if words else None
        if request.refused is None:
            self.obey(name)

    def obey(self, name: str) -> None:
        match name:
            case "arm" | "disarm":
                self.be(armed=name == "arm")
            case "takeoff":
                self.be(mode=FlightMode.TAKEOFF, in_air=True)
                self.position[2] = -4.0
            case "offboard":
                self.be(mode=FlightMode.OFFBOARD)
            case "hold":
                self.be(mode=FlightMode.HOLD)
            case "land":
                self.be(mode=FlightMode.LAND)
                self.velocity = np.array([0.0, 0.0, 2.0])


@dataclass
class Scene:
    """A flight, its vehicle, and whether the camera finds the map."""

    vehicle: PointVehicle = field(default_factory=PointVehicle)
    handle: Handle = field(default_factory=Handle)
    said: list[str] = field(default_factory=list)
    mission: Mission = field(default_factory=lambda: Mission(ROUTE, home_ne_m=np.zeros(2)))
    arms: bool = True
    checks: tuple[Check, ...] = ()
    fixes: bool = True
    sees: bool = True
    lost: str = ""
    frame_ne_m: np.ndarray = field(default_factory=lambda: np.zeros(2))  # where truth is believed
    reset_counter: int = 0
    variance: float = 0.25
    t_s: float = 0.0
    looks_hz: float = 5.0  # answered ones
    seen_s: float | None = None
    t_last_fix_s: float | None = None
    farthest_m: float = 0.0

    def __post_init__(self) -> None:
        crew = Crew(
            self.said.append,
            lambda *_: self.checks,
            arms=self.arms,
        )
        self.flight = Flight(
            self.vehicle,
            self.mission,
            self.handle,
            crew,
            FlightConfig(),
            LimitsConfig(),
            SafetyConfig(),
        )

    def navigation(self) -> Navigation:
        if self.sees:
            self.seen_s = self.t_s
        if self.lost:
            return Navigation(None, self.lost, self.seen_s)
        if self.fixes and self.vehicle.position[2] < -20.0:
            self.t_last_fix_s = self.t_s
        estimate = Estimate(
            t_s=self.t_s,
            position_ned_m=np.add(self.vehicle.position, [*self.frame_ne_m, 0.0]),
            velocity_ned_m_s=self.vehicle.velocity.copy(),
            covariance=np.eye(6) * self.variance,
            quat_wxyz=np.array([1.0, 0.0, 0.0, 0.0]),
            sigma_yaw_rad=0.02,
            agl_m=float(-self.vehicle.position[2]),
            sigma_agl_m=0.5,
            t_last_fix_s=self.t_last_fix_s,
            reset_counter=self.reset_counter,
        )
        return Navigation(estimate, "", self.seen_s, looks=int(self.looks_hz * self.t_s))

    def run(self, until=lambda scene: False, limit_s: float = 400.0) -> "Scene":
        while self.flight.end is None and self.t_s < limit_s and not until(self):
            self.t_s += DT_S
            self.vehicle.be(t_s=self.t_s)
            self.flight.tick(self.t_s, self.navigation())
            self.vehicle.move()
            self.farthest_m = max(self.farthest_m, float(np.hypot(*self.vehicle.position[:2])))
        return self

    def go_on(self, seconds: float) -> "Scene":
        return self.run(limit_s=self.t_s + seconds)


def in_phase(phase: Phase):
    return lambda scene: scene.flight.phase is phase


def on_route() -> Scene:
    return Scene().run(in_phase(Phase.ROUTE)).go_on(3.0)


def test_one_that_rides_along_tells_no_ground_station_that_a_pilot_flies():
    """A second navigator said so while the watchdog landed the aircraft."""
    scene = Scene()
    scene.vehicle.be(armed=True, in_air=True, mode=FlightMode.OFFBOARD)
    scene.flight.ride(0.0, "the navigator ended: this one only sends estimates")
    scene.run(limit_s=2.0)
    assert scene.vehicle.texts == ["the navigator ended: this one only sends estimates"]
    assert scene.said[-1] == Phase.RELEASED.value  # the record's word for it


def test_a_whole_route_is_flown_and_ends_landed_at_home():
    scene = Scene().run()
    assert scene.flight.end.reason is None
    assert scene.farthest_m > 80.0
    assert np.hypot(*scene.vehicle.position[:2]) < 2.0
    assert scene.vehicle.asked == ["arm", "takeoff", "offboard", "land"]


def test_answers_that_take_half_a_second_change_nothing_and_the_loop_never_waits():
    scene = Scene(vehicle=PointVehicle(answers_after=6)).run()
    assert scene.flight.end.reason is None
    assert scene.vehicle.asked == ["arm", "takeoff", "offboard", "land"]


# ---- on the ground


def test_nothing_is_asked_while_the_list_is_not_complete_and_that_is_unsafe():
    scene = Scene(checks=(NOT_READY,)).run()
    assert scene.vehicle.asked == []
    assert "local position" in scene.flight.end.reason
    assert scene.vehicle.warned[-1] == scene.flight.end.reason
    assert scene.flight.end.unsafe


def test_what_keeps_it_on_the_ground_is_told_to_who_stands_at_a_ground_station():
    """A service has no screen; what settles within seconds nobody need read."""
    battery, camera = Check("battery", "FAIL", "30 %"), Check("camera", "FAIL", "no picture")
    scene = Scene(checks=(battery, camera), arms=False).run(limit_s=8.0)
    scene.checks = ()
    scene.go_on(2.0)  # ready for a moment is not ready
    scene.checks = (battery,)
    scene.go_on(4.0)
    assert scene.vehicle.warned == []
    scene.go_on(35.0)
    assert scene.vehicle.warned == ["not ready: battery: 30 %"] * 2  # who connects late reads it
    scene.checks = ()
    scene.go_on(35.0)
    assert len(scene.vehicle.warned) == 3
    assert scene.vehicle.warned[-1].startswith("ready: ")
    scene.checks = (camera,)
    scene.go_on(14.0)
    assert len(scene.vehicle.warned) == 3
    scene.go_on(2.0)
    assert scene.vehicle.warned[-1] == "not ready: camera: no picture"


def test_a_refused_arming_ends_the_flight_with_the_autopilots_words():
    scene = Scene(vehicle=PointVehicle(refuse={"arm": ["denied: compass"] * 9})).run()
    assert "denied: compass" in scene.flight.end.reason


def test_a_moments_refusal_to_arm_is_waited_out():
    """PX4 1.18 was ready for 2.1 s, then not for 6 s, while its heading settled."""
    refusals = ["not now (heading estimate invalid)"] * 2
    scene = Scene(vehicle=PointVehicle(refuse={"arm": refusals})).run(in_phase(Phase.TAKEOFF))
    assert scene.flight.phase is Phase.TAKEOFF
    assert sum("heading estimate invalid" in line for line in scene.said) == 2


def test_readiness_of_two_seconds_is_none():
    assert Scene().run(limit_s=2.2).vehicle.asked == []


def test_an_aircraft_that_arms_but_does_not_take_off_is_disarmed_and_never_armed_again():
    scene = Scene(vehicle=PointVehicle(refuse={"takeoff": ["failed"] * 9})).run()
    assert scene.vehicle.asked == ["arm", "takeoff", "disarm"]
    assert "failed" in scene.flight.end.reason


def test_an_aircraft_that_the_pilot_disarms_before_take_off_is_not_armed_again():
    scene = Scene(vehicle=PointVehicle(refuse={"takeoff": ["x"]}, answers_after=60))
    scene.run(lambda s: s.vehicle.asked[-1:] == ["takeoff"])
    scene.vehicle.be(armed=False)
    scene.go_on(60.0)
    assert scene.vehicle.asked == ["arm", "takeoff"]
    assert "disarmed" in scene.flight.end.reason


@pytest.mark.parametrize("in_air", [False, True])
def test_an_aircraft_that_somebody_armed_is_asked_for_nothing_until_it_is_disarmed(in_air):
    scene = Scene()
    scene.vehicle.be(armed=True, in_air=in_air, mode=FlightMode.MANUAL)
    scene.run(limit_s=60.0)
    assert (scene.vehicle.asked, scene.vehicle.setpoints) == ([], 0)
    assert not any(scene.handle.beats)
    assert scene.flight.end is None
    scene.vehicle.be(armed=False, in_air=False)
    assert "not by vwnav" in scene.run().flight.end.reason
    assert scene.vehicle.asked == []


def test_without_leave_to_arm_it_waits_for_a_person():
    scene = Scene(arms=False)
    scene.run(limit_s=1.0)
    scene.flight.go()  # it has not asked yet: an Enter too early lets nothing happen later
    scene.run(limit_s=300.0)
    assert scene.vehicle.asked == []
    assert any("press Enter" in line for line in scene.said)
    scene.flight.go()
    scene.go_on(10.0)
    assert scene.vehicle.asked[:2] == ["arm", "takeoff"]


@pytest.mark.parametrize(("mode", "goes"), [(FlightMode.HOLD, True), (FlightMode.MANUAL, False)])
def test_a_pilot_who_arms_in_hold_lets_it_take_off_and_one_who_arms_to_fly_does_not(mode, goes):
    scene = Scene(arms=False).run(limit_s=10.0)
    scene.vehicle.be(armed=True, mode=mode)
    scene.go_on(10.0)
    assert ("takeoff" in scene.vehicle.asked) is goes


@pytest.mark.parametrize("switches_first", [True, False])
@pytest.mark.parametrize("mode", [FlightMode.HOLD, FlightMode.OFFBOARD])
def test_a_pilot_whose_radio_arms_in_a_mode_of_the_sticks_lets_it_take_off_by_hold(
    mode, switches_first
):
    """PX4 denies a radio every other mode, ArduCopter denies it GUIDED."""
    scene = Scene(arms=False)
    if not switches_first:
        scene.vehicle.be(mode=FlightMode.MANUAL)
    scene.run(limit_s=10.0)
    scene.vehicle.be(mode=FlightMode.MANUAL)
    scene.go_on(2.0)
    scene.vehicle.be(armed=True)
    scene.go_on(3.0)
    assert scene.vehicle.asked == []
    assert scene.said[-1] == "armed by the pilot: it takes off once Hold or GUIDED is chosen"
    scene.vehicle.be(mode=mode)
    scene.go_on(3.0)
    assert scene.vehicle.asked[0] == "takeoff"


@pytest.mark.parametrize("what", ["flies", "flies, then hold", "mission", "not ready, then hold"])
def test_a_pilot_whose_radio_armed_it_for_himself_has_it(what):
    scene = Scene(arms=False).run(limit_s=10.0)
    scene.vehicle.be(mode=FlightMode.MANUAL)
    scene.go_on(2.0)
    scene.vehicle.be(armed=True)
    scene.go_on(1.0)
    if what == "mission":
        scene.vehicle.be(mode=FlightMode.MISSION)
    elif what.startswith("not ready"):
        scene.checks = (NOT_READY,)
    else:
        scene.vehicle.be(in_air=True)
    scene.go_on(2.0)
    if what.endswith("hold"):
        scene.vehicle.be(mode=FlightMode.HOLD)
    scene.go_on(10.0)
    assert scene.vehicle.asked == []
    assert scene.flight.phase is Phase.RELEASED


def test_one_whose_radio_armed_and_disarmed_it_is_waited_for_again():
    scene = Scene(arms=False)
    scene.vehicle.be(mode=FlightMode.MANUAL)
    scene.run(limit_s=10.0)
    scene.vehicle.be(armed=True)
    scene.go_on(2.0)
    scene.flight.go()
    scene.go_on(2.0)
    scene.vehicle.be(armed=False)
    scene.go_on(10.0)
    assert scene.vehicle.asked == []  # whoever stopped the motors may stand beside them
    scene.flight.go()
    scene.go_on(5.0)
    assert scene.vehicle.asked[:2] == ["arm", "takeoff"]


@pytest.mark.parametrize(
    "mode", [FlightMode.OFFBOARD, FlightMode.LAND, FlightMode.RETURN, FlightMode.TAKEOFF]
)
def test_what_stands_in_a_mode_in_which_nobody_can_arm_it_is_asked_to_leave_it(mode):
    """PX4 after a flight: it shows Offboard, and no readiness; a person is asked for nothing."""
    scene = Scene(arms=False)
    scene.vehicle.be(mode=mode)
    scene.run(limit_s=10.0)
    assert scene.vehicle.asked == []
    scene.vehicle.be(armable=False)
    scene.go_on(4.0)
    assert scene.vehicle.asked == ["stand by"]
    scene.go_on(6.0)
    assert scene.vehicle.asked == ["stand by", "stand by"]
    scene.vehicle.be(mode=FlightMode.HOLD, armable=True)
    scene.go_on(6.0)
    for chosen in (FlightMode.HOLD, FlightMode.MANUAL, FlightMode.MISSION):
        scene.vehicle.be(mode=chosen, armable=False)
        scene.go_on(6.0)
    assert len(scene.vehicle.asked) == 2


def test_a_person_who_takes_his_time_is_waited_for_whatever_is_missing_for_a_moment():
    scene = Scene(arms=False).run(limit_s=120.0)
    scene.checks = (NOT_READY,)
    scene.go_on(0.5)
    scene.checks = ()
    scene.go_on(10.0)
    scene.vehicle.be(mode=FlightMode.MANUAL)
    scene.go_on(100.0)
    scene.vehicle.be(mode=FlightMode.HOLD)
    scene.go_on(10.0)
    assert scene.flight.end is None
    scene.checks = (NOT_READY,)
    scene.go_on(95.0)
    assert scene.flight.end.unsafe


@pytest.mark.parametrize("mode", [FlightMode.MANUAL, FlightMode.MISSION, FlightMode.OTHER])
def test_who_chooses_a_mode_of_his_own_before_arming_is_not_armed_over(mode):
    scene = Scene().run(limit_s=2.0)
    scene.vehicle.be(mode=mode)
    assert scene.go_on(60.0).vehicle.asked == []


def with_heartbeats_late(scene: Scene, seconds: float) -> Scene:
    """Motors start `seconds` after the arming was accepted: so late a heartbeat tells it."""
    obey, ticks = scene.vehicle.obey, round(seconds / DT_S)
    move = scene.vehicle.move

    def late(name: str) -> None:
        if name != "arm":
            obey(name)
            return
        scene.armed_at = scene.t_s + ticks * DT_S

    def moves() -> None:
        move()
        if 0.0 < getattr(scene, "armed_at", 0.0) <= scene.t_s:
            scene.armed_at = 0.0
            obey("arm")

    scene.vehicle.obey, scene.vehicle.move = late, moves
    return scene


@pytest.mark.parametrize("late_s", [0.0, 0.9, 2.0])
@pytest.mark.parametrize("after_s", [0.0, 0.1, 0.5])
def test_who_is_interrupted_while_it_arms_stays_until_the_motors_stand(late_s, after_s):
    scene = with_heartbeats_late(Scene(vehicle=PointVehicle(answers_after=3)), late_s)
    scene.run(lambda s: s.vehicle.asked == ["arm"]).go_on(after_s)
    scene.flight.abort("interrupted")
    scene.run(limit_s=scene.t_s + 60.0)
    assert scene.flight.end.reason == "interrupted"
    for _ in range(50):  # what was on its way arrives when nobody is there any more
        scene.t_s += DT_S
        scene.vehicle.move()
    assert not scene.vehicle.vehicle.armed


def test_a_take_off_that_is_flown_though_its_answers_were_lost_is_guarded_and_landed():
    scene = Scene(vehicle=PointVehicle(refuse={"takeoff": ["no answer to 3 tries"]}))
    scene.run(lambda s: "takeoff" in s.vehicle.asked)
    scene.vehicle.position = np.array([0.0, 0.0, -4.0])
    scene.vehicle.be(in_air=True, mode=FlightMode.OFFBOARD)
    scene.run(in_phase(Phase.LAND))
    assert scene.handle.beats[-1]
    assert "no answer" in scene.run().flight.end.reason
    assert not scene.vehicle.vehicle.armed


@pytest.mark.parametrize("mode", [FlightMode.MANUAL, FlightMode.HOLD])
def test_a_pilot_who_arms_just_after_our_arming_was_refused_has_the_aircraft(mode):
    """His switch has stood there from the start, or he arms where he could have let us."""
    scene = Scene(vehicle=PointVehicle(refuse={"arm": ["denied"] * 9}))
    scene.vehicle.be(mode=mode)
    scene.run(lambda s: any("refused to arm" in line for line in s.said)).go_on(0.3)
    asked = list(scene.vehicle.asked)
    scene.vehicle.be(armed=True)
    scene.go_on(3.0)
    scene.vehicle.be(in_air=True)
    scene.go_on(10.0)
    assert scene.flight.phase is Phase.RELEASED
    assert scene.vehicle.asked == asked


@pytest.mark.parametrize("ready", [True, False])
def test_a_pilot_who_arms_as_he_was_told_beside_an_arming_without_an_answer_is_taken_off(ready):
    """Enter was pressed, nothing came, and he armed by the radio: both ask for the same."""
    scene = Scene(arms=False, vehicle=PointVehicle(refuse={"arm": ["no answer to 3 tries"]}))
    scene.vehicle.be(mode=FlightMode.HOLD)
    scene.vehicle.stays_armed = not ready
    scene.run(lambda s: any("press Enter" in line for line in s.said))
    scene.flight.go()
    scene.run(lambda s: any("refused to arm" in line for line in s.said)).go_on(0.5)
    scene.checks = () if ready else (Check("battery", "FAIL", "is low"),)
    scene.vehicle.be(armed=True)
    scene.go_on(1.0)
    assert ("disarm" in scene.vehicle.asked) is not ready
    assert ("takeoff" in scene.vehicle.asked) is ready
    scene.checks = ()
    scene.go_on(1.0)
    assert ("takeoff" in scene.vehicle.asked) is ready  # not after it was told to stand


def test_an_arming_without_an_answer_is_not_asked_for_again_by_itself():
    """The motors had run, and stood: they started again beside whoever looked why."""
    scene = Scene(vehicle=PointVehicle(refuse={"arm": ["no answer to 3 tries"]}))
    reason = scene.run().flight.end.reason
    assert scene.vehicle.asked.count("arm") == 1
    assert "not armed again" in reason


def test_a_person_may_ask_again_where_an_arming_had_no_answer():
    scene = Scene(arms=False, vehicle=PointVehicle(refuse={"arm": ["no answer to 3 tries"]}))
    scene.vehicle.be(mode=FlightMode.HOLD)
    scene.run(lambda s: any("press Enter" in line for line in s.said))
    scene.flight.go()
    scene.run(lambda s: any("refused to arm" in line for line in s.said))
    scene.run(lambda s: "press Enter" in s.said[-1]).go_on(5.0)
    assert scene.vehicle.asked.count("arm") == 1
    scene.flight.go()
    assert scene.run().flight.end.reason is None


def test_who_waits_for_the_motors_of_an_autopilot_that_is_gone_does_not_wait_for_ever():
    scene = Scene(vehicle=PointVehicle(refuse={"takeoff": ["failed"]}, stays_armed=True))
    scene.run(lambda s: "takeoff" in s.vehicle.asked)
    scene.vehicle.be(silence_s=50.0)
    scene.vehicle.answer = lambda: None  # nothing is heard there any more
    scene.flight.abort("interrupted")
    assert scene.go_on(20.0).flight.end is None
    scene.vehicle.be(silence_s=61.0)
    assert "not heard any more" in scene.go_on(1.0).flight.end.reason


def test_an_autopilot_that_is_gone_while_its_arming_was_not_answered_is_named_with_its_reason():
    scene = Scene(vehicle=PointVehicle(refuse={"arm": ["no answer to 3 tries"]}))
    scene.run(lambda s: any("refused to arm" in line for line in s.said))
    scene.vehicle.be(armed=True, silence_s=61.0)
    reason = scene.go_on(1.0).flight.end.reason
    assert reason == "it could not be armed; the autopilot was not heard any more"


def test_a_loop_that_stalled_on_the_ground_takes_the_aircraft_back_from_the_watchdog():
    """Which would let neither a take-off nor a disarming pass, and sends none itself."""
    scene = Scene(vehicle=PointVehicle(answers_after=30)).run(lambda s: s.vehicle.asked == ["arm"])
    scene.handle.report = WatchdogReport(GuardState.LANDING, 1, 0.1)
    scene.go_on(2.5)
    assert scene.flight.phase is Phase.GET_READY
    assert scene.handle.rejoined >= 2


def test_the_watchdog_guards_from_the_first_word_that_may_start_the_motors():
    scene = Scene(vehicle=PointVehicle(answers_after=3)).run(lambda s: s.vehicle.asked == ["arm"])
    scene.go_on(DT_S)
    assert scene.handle.beats[-1]


# ---- taking off


def test_no_setpoint_disturbs_the_autopilots_own_take_off():
    scene = Scene().run(in_phase(Phase.TAKEOFF))
    scene.vehicle.position = np.zeros(3)
    scene.t_last_fix_s, scene.variance = scene.t_s, 12.0**2  # uncertain: a reason to hold
    scene.vehicle.be(mode=FlightMode.OFFBOARD)  # ArduCopter's GUIDED
    scene.go_on(DT_S)
    assert scene.vehicle.setpoints == 0


@pytest.mark.parametrize(("in_air", "goes"), [(True, True), (False, False)])
def test_a_take_off_that_ends_lower_than_believed_has_ended_once_it_rises_no_more(in_air, goes):
    """Barometer or rangefinder show too little: the autopilot hovers at its own height."""
    scene = Scene().run(in_phase(Phase.TAKEOFF))
    scene.vehicle.position = np.array([0.0, 0.0, -2.6])
    scene.vehicle.be(mode=FlightMode.OFFBOARD, in_air=in_air)  # ArduCopter's GUIDED
    scene.go_on(2.0)
    assert "offboard" not in scene.vehicle.asked
    scene.go_on(4.0)
    assert ("offboard" in scene.vehicle.asked) is goes


@pytest.mark.parametrize("answers_after", [1, 30])
def test_a_pilot_who_takes_over_while_offboard_is_asked_for_has_the_aircraft(answers_after):
    scene = Scene()
    scene.run(in_phase(Phase.TAKEOFF))
    scene.vehicle.answers_after = 100
    scene.run(lambda s: s.vehicle.asked[-1] == "offboard")
    scene.vehicle.be(mode=FlightMode.MANUAL)
    scene.vehicle.answers_after = answers_after
    asked, setpoints = list(scene.vehicle.asked), scene.vehicle.setpoints
    scene.go_on(30.0)
    assert scene.flight.phase is Phase.RELEASED
    assert (scene.vehicle.asked, scene.vehicle.setpoints) == (asked, setpoints)
    assert scene.vehicle.under_way is None, "the request was not withdrawn"


def test_a_refused_offboard_is_landed():
    scene = Scene(vehicle=PointVehicle(refuse={"offboard": ["denied"]})).run()
    assert scene.vehicle.asked[-1] == "land"
    assert "refused Offboard: denied" in scene.flight.end.reason


# ---- home


def test_without_a_fix_it_stays_above_home_lands_and_says_why():
    scene = Scene(fixes=False).run()
    assert scene.flight.end.reason == (
        "no fix above home: the map shows another place, --home is wrong, "
        "or the camera does not work"
    )
    assert scene.farthest_m < 1.0


@pytest.mark.parametrize("search_s", [25.0, 40.0])
def test_a_slow_search_is_waited_for(search_s):
    """A computer that is slow, or a map that is large, is no map of another place."""
    scene = Scene(fixes=False, looks_hz=1.0 / search_s).run(in_phase(Phase.FIRST_FIX))
    scene.go_on(50.0)
    assert scene.flight.phase is Phase.FIRST_FIX
    scene.fixes = True
    scene.run()
    assert scene.flight.end.reason is None
    assert scene.farthest_m > 80.0


def test_a_search_that_is_never_answered_is_told_as_one():
    scene = Scene(fixes=False, looks_hz=0.0).run(in_phase(Phase.FIRST_FIX))
    since_s = scene.t_s
    scene.run(in_phase(Phase.LAND))
    assert scene.t_s - since_s < 61.0
    scene.run()
    assert "0 looks at the map answered in 60 s: this computer is too" in scene.flight.end.reason


def jump_at_first_fix(scene: Scene, to_ne_m: tuple[float, float]) -> Scene:
    """The frame's origin is nowhere near: the first fix shows where that is."""
    scene.run(in_phase(Phase.FIRST_FIX))
    scene.frame_ne_m, scene.reset_counter = np.array(to_ne_m), scene.reset_counter + 1
    return scene


def test_an_unknown_home_is_where_it_stood_and_never_the_origin_of_the_frame():
    scene = Scene(mission=Mission(ROUTE, about_home=True))
    jump_at_first_fix(scene, (400.0, -300.0)).run()
    assert scene.flight.end.reason is None
    assert scene.flight.home_ne_m == pytest.approx([400.0, -300.0], abs=0.5)
    assert np.hypot(*scene.vehicle.position[:2]) < 2.0
    assert 80.0 < scene.farthest_m < 100.0


def test_a_home_given_wrong_is_not_returned_to():
    scene = Scene(mission=Mission(np.add(ROUTE, [20.0, 0.0, 0.0]), home_ne_m=np.zeros(2)))
    jump_at_first_fix(scene, (20.0, 0.0)).run()
    assert np.hypot(*scene.vehicle.position[:2]) < 2.0
    assert any("20 m from the home" in line for line in scene.said)


def test_a_position_that_jumps_on_the_way_down_does_not_move_home():
    scene = Scene().run(in_phase(Phase.DESCEND)).go_on(1.0)
    scene.frame_ne_m, scene.reset_counter = np.array([4.0, 0.0]), scene.reset_counter + 1
    scene.run()
    believed_ne_m = scene.vehicle.position[:2] + scene.frame_ne_m
    assert np.hypot(*believed_ne_m) < 1.0


def test_a_return_before_anybody_knows_where_home_is_is_a_landing():
    scene = Scene(mission=Mission(ROUTE, about_home=True), fixes=False)
    scene.run(in_phase(Phase.CLIMB))
    scene.vehicle.be(battery_ratio=0.2)
    scene.run()
    assert scene.vehicle.asked[-1] == "land"
    assert scene.farthest_m < 1.0


def test_a_route_that_turns_out_to_leave_the_map_is_not_flown():
    mission = Mission(ROUTE, about_home=True, refuse=lambda _: "the map does not cover the route")
    scene = Scene(mission=mission).run()
    assert "does not cover" in scene.flight.end.reason
    assert scene.farthest_m < 1.0


# ---- in the air


@pytest.mark.parametrize("phase", [Phase.CLIMB, Phase.ROUTE, Phase.RETURN, Phase.DESCEND])
def test_a_flight_taken_up_in_the_air_goes_on_to_its_end(phase):
    scene = Scene()
    scene.vehicle.be(armed=True, in_air=True, mode=FlightMode.OFFBOARD)
    scene.vehicle.position = np.array(
        [20.0, 10.0, -40.0] if phase is Phase.ROUTE else [2, 1, -40.0]
    )
    scene.flight.take_up(phase, scene.navigation().estimate)
    scene.run()
    assert scene.flight.end.reason is None
    assert "arm" not in scene.vehicle.asked


@pytest.mark.parametrize(
    "phase", [Phase.CLIMB, Phase.FIRST_FIX, Phase.ROUTE, Phase.RETURN, Phase.DESCEND]
)
def test_an_aircraft_whose_motors_stand_in_flight_is_left_and_who_arms_it_again_has_it(phase):
    scene = Scene()
    if phase is Phase.RETURN:
        scene.run(in_phase(Phase.ROUTE)).go_on(5.0)
        scene.vehicle.be(battery_ratio=0.2)
    scene.run(in_phase(phase))
    scene.vehicle.be(armed=False, in_air=False)
    setpoints = scene.go_on(DT_S).vehicle.setpoints
    assert scene.flight.end.reason == f"the aircraft was disarmed while {phase.value}"
    scene.vehicle.be(armed=True, in_air=True)
    scene.go_on(10.0)
    assert scene.vehicle.setpoints == setpoints
    assert not scene.handle.beats[-1]


def test_a_landing_that_was_not_heard_is_asked_for_again_and_the_beat_is_held_until_it_is_flown():
    scene = on_route()
    scene.vehicle.refuse = {"land": ["no answer"] * 3}
    scene.flight.abort("interrupted by the operator")
    scene.run(lambda s: s.vehicle.refuse["land"] == [])
    assert scene.handle.beats[-1]
    scene.run()
    assert scene.vehicle.asked[-4:] == ["land"] * 4
    assert sum("refused to land" in line for line in scene.said) == 1
    assert scene.flight.end.reason == "interrupted by the operator"
    assert not scene.vehicle.vehicle.armed


def test_a_landing_that_an_autopilot_out_of_earshot_does_not_answer_is_not_called_refused():
    scene = on_route()
    scene.vehicle.refuse = {"land": ["no answer"] * 3}
    scene.vehicle.be(silence_s=1.5)
    scene.flight.abort("interrupted by the operator")
    scene.run(lambda s: s.vehicle.refuse["land"] == [])
    scene.go_on(0.5)
    scene.vehicle.be(silence_s=0.1)
    scene.run()
    assert not [line for line in scene.said if "refused" in line]
    assert scene.flight.end.reason == "interrupted by the operator"


def test_it_is_not_left_while_it_stands_armed_and_land_is_not_asked_for_again():
    scene = on_route()
    scene.vehicle.stays_armed = True
    scene.flight.abort("interrupted")
    scene.go_on(45.0)
    assert scene.flight.end is None
    assert scene.vehicle.asked[-1] == "disarm"
    assert scene.vehicle.asked.count("land") == 1
    scene.vehicle.stays_armed = False
    assert scene.run().flight.end is not None


def test_an_autopilot_that_is_gone_for_good_is_not_waited_for():
    scene = on_route()
    scene.flight.abort("interrupted")
    scene.go_on(1.0)
    scene.vehicle.be(silence_s=50.0)
    assert scene.go_on(5.0).flight.end is None
    scene.vehicle.be(silence_s=61.0)
    assert "not heard any more" in scene.go_on(1.0).flight.end.reason


def test_without_an_estimate_to_fly_on_it_stops_and_is_landed_before_the_autopilot_gives_up():
    scene = on_route()
    scene.lost, lost_s = "its velocity is unknown", scene.t_s
    scene.go_on(0.5)
    assert np.all(scene.vehicle.velocity == 0.0)
    scene.run(in_phase(Phase.LAND))
    assert 1.9 < scene.t_s - lost_s < 3.0
    assert "velocity is unknown" in scene.run().flight.end.reason


def test_blind_for_good_it_comes_down_within_seconds_and_blind_for_five_it_flies_on():
    scene = on_route()
    scene.sees = False
    scene.go_on(5.0)
    assert np.all(scene.vehicle.velocity == 0.0)
    scene.sees = True
    scene.go_on(2.0)
    assert scene.flight.phase is Phase.ROUTE
    scene.sees, blind_s = False, scene.t_s
    scene.run(in_phase(Phase.LAND))
    assert scene.t_s - blind_s < 7.0
    assert "camera" in scene.run().flight.end.reason


@pytest.mark.parametrize("mode", [FlightMode.MANUAL, FlightMode.HOLD, FlightMode.MISSION])
def test_after_the_pilots_mode_change_nothing_is_asked_again(mode):
    scene = on_route()
    scene.vehicle.be(mode=mode)
    asked, setpoints = list(scene.vehicle.asked), scene.vehicle.setpoints
    scene.go_on(30.0)
    assert scene.flight.phase is Phase.RELEASED
    assert (scene.vehicle.asked, scene.vehicle.setpoints) == (asked, setpoints)
    assert not scene.handle.beats[-1]
    scene.vehicle.be(armed=False)
    assert scene.run().flight.end.reason


@pytest.mark.parametrize("mode", [FlightMode.MANUAL, FlightMode.HOLD, FlightMode.OFFBOARD])
def test_a_pilot_who_takes_over_a_landing_has_it(mode):
    """A ground station that flies ArduCopter in GUIDED, too."""
    scene = on_route()
    scene.flight.abort("interrupted")
    scene.go_on(5.0)
    scene.vehicle.be(mode=mode)
    asked = list(scene.vehicle.asked)
    scene.go_on(20.0)
    assert scene.flight.phase is Phase.RELEASED
    assert scene.vehicle.asked == asked


def test_a_landing_without_a_position_is_held_once_there_is_one_and_goes_on():
    """ArduCopter comes down level, 208 m with the wind, until another mode is asked for."""
    scene = on_route()
    scene.flight.abort("interrupted")
    scene.go_on(2.0)
    asked = list(scene.vehicle.asked)
    scene.vehicle.be(lands_blind=True)
    scene.run(lambda scene: scene.vehicle.vehicle.mode is FlightMode.HOLD)
    assert scene.vehicle.asked[len(asked) :] == ["hold"]
    scene.vehicle.be(lands_blind=False)
    scene.run()
    assert scene.vehicle.asked[len(asked) :] == ["hold", "land"]
    assert sum("Hold, then Land" in line for line in scene.said) == 1
    assert not scene.vehicle.vehicle.armed


def test_a_hold_that_is_refused_to_one_that_lands_blind_is_asked_for_seldom_and_it_comes_down():
    scene = on_route()
    scene.flight.abort("interrupted")
    scene.go_on(2.0)
    scene.vehicle.refuse = {"hold": ["not now"] * 100}
    scene.vehicle.be(lands_blind=True)
    began_s, asked = scene.t_s, len(scene.vehicle.asked)
    scene.run()
    again = set(scene.vehicle.asked[asked:])
    assert again == {"hold"}
    assert len(scene.vehicle.asked) - asked <= 1 + (scene.t_s - began_s) / 6.0
    assert not scene.vehicle.vehicle.armed


def test_a_hold_that_one_that_lands_blind_takes_late_is_still_landed():
    scene = on_route()
    scene.flight.abort("interrupted")
    scene.go_on(2.0)
    scene.vehicle.answers_after = round(5.0 / DT_S)
    scene.vehicle.be(lands_blind=True)
    scene.run(lambda scene: scene.vehicle.vehicle.mode is FlightMode.HOLD)
    scene.vehicle.answers_after = 1
    scene.vehicle.be(lands_blind=False)
    scene.run()
    assert scene.vehicle.asked[-2:] == ["hold", "land"]
    assert not scene.vehicle.vehicle.armed


def test_a_pilot_who_chooses_hold_once_it_lands_again_keeps_it():
    scene = on_route()
    scene.flight.abort("interrupted")
    scene.go_on(2.0)
    scene.vehicle.be(lands_blind=True)
    scene.run(lambda scene: scene.vehicle.vehicle.mode is FlightMode.HOLD)
    scene.vehicle.be(lands_blind=False)
    scene.run(lambda scene: scene.vehicle.vehicle.mode is FlightMode.LAND).go_on(6.5)
    asked = list(scene.vehicle.asked)
    scene.vehicle.be(mode=FlightMode.HOLD)
    scene.go_on(10.0)
    assert scene.flight.phase is Phase.RELEASED
    assert scene.vehicle.asked == asked


@pytest.mark.parametrize("lands", [True, False])
def test_in_a_fallback_to_sticks_that_are_heard_nothing_is_asked_for(lands):
    """PX4 flies as they tell it, and tells that Offboard is intended, whoever moves them."""
    scene = on_route()
    if lands:
        scene.vehicle.refuse = {"land": ["no answer"]}
        scene.flight.abort("interrupted")
        scene.go_on(0.5)
    else:
        gap(scene, 4.0)
    asked, setpoints = list(scene.vehicle.asked), scene.vehicle.setpoints
    scene.vehicle.be(rc_available=True)
    failsafe(scene, FlightMode.MANUAL).go_on(10.0)
    assert scene.flight.phase is Phase.RELEASED
    assert (scene.vehicle.asked, scene.vehicle.setpoints) == (asked, setpoints)


def test_a_pilot_who_takes_over_where_the_autopilot_had_fallen_back_to_sticks_has_it():
    scene = on_route()
    scene.vehicle.refuse = {"land": ["not now"] * 100}
    failsafe(gap(scene, 4.0), FlightMode.MANUAL).go_on(9.0)
    assert scene.flight.phase is Phase.LAND
    assert scene.vehicle.asked[-2:] == ["land", "land"]
    scene.vehicle.be(mode=FlightMode.MANUAL)
    asked = list(scene.vehicle.asked)
    scene.go_on(2.0)
    assert scene.flight.phase is Phase.RELEASED
    assert scene.vehicle.asked == asked


@pytest.mark.parametrize("mode", [FlightMode.RETURN, FlightMode.HOLD])
def test_who_chooses_the_very_mode_that_the_autopilot_had_fallen_back_to_has_it(mode):
    """The mode that is flown does not change: what was asked for does."""
    scene = failsafe(gap(on_route(), 2.5), mode)
    scene.vehicle.refuse = {name: ["not now"] * 100 for name in ("hold", "land")}
    scene.vehicle.be(own_position_ned_m=scene.vehicle.position.copy())
    scene.run(lambda scene: scene.vehicle.asked[-1] == "land").go_on(1.0)
    assert scene.flight.phase is Phase.LAND
    scene.vehicle.be(mode=mode, failsafe=False)
    asked = list(scene.vehicle.asked)
    scene.go_on(10.0)
    assert scene.flight.phase is Phase.RELEASED
    assert scene.vehicle.asked == asked


def test_a_landing_in_the_take_off_is_asked_for_again_when_that_ends_in_hold():
    """PX4's take-off goes over into Hold by itself; nobody chose it, and nobody would end it."""
    scene = Scene().run(in_phase(Phase.TAKEOFF))
    scene.vehicle.refuse = {"land": ["no answer"] * 6}
    scene.flight.abort("interrupted")
    scene.go_on(0.5)
    scene.vehicle.be(mode=FlightMode.HOLD)
    scene.go_on(4.0)
    assert scene.flight.phase is Phase.LAND
    assert scene.run().flight.end.reason == "interrupted"


def test_offboard_is_not_asked_for_out_of_a_failsafe_that_holds_the_take_off():
    """PX4 waits 5 s in Hold before it returns; a mode that is asked for then ends the failsafe."""
    scene = Scene().run(in_phase(Phase.TAKEOFF))
    scene.vehicle.be(mode=FlightMode.HOLD, intended_mode=FlightMode.TAKEOFF, failsafe=True)
    scene.go_on(5.0)
    scene.vehicle.be(mode=FlightMode.RETURN, intended_mode=FlightMode.TAKEOFF)
    scene.go_on(5.0)
    assert scene.flight.phase is Phase.FAILSAFE
    assert scene.vehicle.asked == ["arm", "takeoff"]


@pytest.mark.parametrize(
    ("mode", "phase"), [(FlightMode.TAKEOFF, Phase.ROUTE), (FlightMode.HOLD, Phase.RELEASED)]
)
def test_after_a_failsafe_in_the_take_off_it_goes_on_in_it_and_not_in_somebodys_hold(mode, phase):
    scene = Scene().run(in_phase(Phase.TAKEOFF))
    scene.vehicle.be(mode=FlightMode.HOLD, intended_mode=FlightMode.TAKEOFF, failsafe=True)
    scene.go_on(1.0)
    scene.vehicle.be(mode=mode, failsafe=False)
    assert scene.run(in_phase(phase)).flight.phase is phase


def test_the_failsafe_of_a_pilot_who_took_over_a_landing_is_his():
    """His radio is lost: PX4 returns, and still intends the mode that he chose."""
    scene = on_route()
    scene.vehicle.refuse = {"land": ["no answer"]}
    scene.flight.abort("interrupted")
    scene.go_on(0.5)
    scene.vehicle.be(mode=FlightMode.RETURN, intended_mode=FlightMode.MANUAL, failsafe=True)
    asked = list(scene.vehicle.asked)
    scene.go_on(10.0)
    assert scene.flight.phase is Phase.RELEASED
    assert scene.vehicle.asked == asked


@pytest.mark.parametrize("mode", [FlightMode.HOLD, FlightMode.MANUAL, FlightMode.RETURN])
def test_a_landing_is_asked_for_again_out_of_a_failsafe_that_does_not_come_down(mode):
    """COM_OBL_RC_ACT 5 holds, 0 of the 1.16 era goes to Position: until the battery is empty."""
    scene = on_route()
    scene.vehicle.refuse = {"land": ["no answer"]}
    scene.flight.abort("interrupted")
    scene.go_on(0.5)
    failsafe(scene, mode).go_on(10.0)
    assert scene.flight.phase is Phase.LAND
    assert not [line for line in scene.said if "the pilot" in line]
    assert scene.run().flight.end.reason == "interrupted"


def test_a_fallback_to_sticks_is_no_pilot_and_ends_when_the_autopilot_comes_back():
    scene = failsafe(gap(on_route(), 0.8), FlightMode.MANUAL).go_on(1.0)
    assert scene.flight.phase is Phase.FAILSAFE
    assert not [line for line in scene.said if "the pilot" in line]
    scene.vehicle.be(mode=FlightMode.OFFBOARD, failsafe=False)
    scene.run()
    assert scene.flight.end.reason is None


def failsafe(scene: Scene, mode: FlightMode) -> Scene:
    """The autopilot flies `mode` though ours is still the intended one."""
    scene.vehicle.be(mode=mode, intended_mode=FlightMode.OFFBOARD, failsafe=True)
    return scene


def gap(scene: Scene, seconds: float) -> Scene:
    scene.vehicle.be(silence_s=seconds)
    scene.go_on(seconds)
    scene.vehicle.be(silence_s=0.1)
    return scene


def test_after_a_gap_of_a_second_the_route_goes_on_when_the_autopilot_comes_back():
    scene = failsafe(gap(on_route(), 0.8), FlightMode.LAND).go_on(1.0)
    assert scene.flight.phase is Phase.FAILSAFE
    scene.vehicle.be(mode=FlightMode.OFFBOARD, failsafe=False)
    scene.run()
    assert scene.flight.end.reason is None


def test_after_a_longer_gap_hold_and_land_are_asked_for_once_the_autopilot_agrees_with_us():
    scene = failsafe(gap(on_route(), 4.0), FlightMode.DESCEND)
    asked, setpoints = list(scene.vehicle.asked), scene.vehicle.setpoints
    scene.vehicle.be(own_position_ned_m=scene.vehicle.position + 60.0)
    scene.go_on(5.0)
    assert (scene.vehicle.asked, scene.vehicle.setpoints) == (asked, setpoints)
    scene.vehicle.be(own_position_ned_m=scene.vehicle.position.copy())
    scene.go_on(0.8)
    assert scene.vehicle.asked == asked
    scene.run()
    assert scene.vehicle.asked[len(asked) :] == ["hold", "land"]
    assert "lost for too long" in scene.flight.end.reason


def hold_asked_for(mode: FlightMode) -> Scene:
    """In a failsafe after a long gap, just after Hold was asked for; it has not been answered."""
    scene = failsafe(gap(on_route(), 4.0), mode)
    scene.vehicle.answers_after = 1000
    scene.vehicle.be(own_position_ned_m=scene.vehicle.position.copy())
    return scene.run(lambda scene: scene.vehicle.asked[-1] == "hold").go_on(0.4)


@pytest.mark.parametrize("intended", [FlightMode.MANUAL, FlightMode.UNKNOWN])
@pytest.mark.parametrize("sticks", [True, False])
def test_a_pilot_who_takes_over_while_hold_is_asked_for_is_not_landed_against(intended, sticks):
    """Whether his radio is heard, or nobody has told yet who chose the mode."""
    scene = hold_asked_for(FlightMode.DESCEND)
    asked = list(scene.vehicle.asked)
    scene.vehicle.be(
        mode=FlightMode.MANUAL, intended_mode=intended, failsafe=False, rc_available=sticks
    )
    scene.go_on(8.0)
    assert scene.vehicle.asked == asked
    assert scene.flight.phase is Phase.RELEASED


@pytest.mark.parametrize("mode", [FlightMode.RETURN, FlightMode.OTHER])
def test_nor_is_one_who_chooses_a_mode_of_the_autopilot_s(mode):
    scene = hold_asked_for(FlightMode.DESCEND)
    asked = list(scene.vehicle.asked)
    scene.vehicle.be(mode=mode, failsafe=False)
    scene.go_on(8.0)
    assert scene.vehicle.asked == asked
    assert scene.flight.phase is Phase.RELEASED


def test_nor_is_a_way_home_that_the_autopilot_flies_instead_of_the_hold():
    """A battery's, say: it knows where it is, and is flown to its end."""
    scene = hold_asked_for(FlightMode.DESCEND)
    asked = list(scene.vehicle.asked)
    scene.vehicle.be(mode=FlightMode.RETURN, intended_mode=FlightMode.HOLD)
    scene.go_on(8.0)
    assert scene.vehicle.asked == asked
    assert scene.flight.phase is Phase.RELEASED


def test_a_hold_that_is_told_to_be_wanted_while_the_failsafe_flies_on_is_ours():
    scene = hold_asked_for(FlightMode.DESCEND)
    scene.vehicle.be(intended_mode=FlightMode.HOLD)
    scene.go_on(3.0)
    assert scene.flight.phase is Phase.LAND


@pytest.mark.parametrize("trouble", ["battery", "nothing on our side"])
def test_a_failsafe_that_is_not_for_want_of_us_is_flown_to_its_end_and_not_made_worse(trouble):
    scene = on_route()
    if trouble == "battery":
        scene.vehicle.be(battery_ratio=0.2)
        gap(scene, 4.0)
    asked, setpoints = list(scene.vehicle.asked), scene.vehicle.setpoints
    failsafe(scene, FlightMode.HOLD).go_on(5.0)
    failsafe(scene, FlightMode.RETURN).go_on(15.0)
    assert scene.vehicle.asked == asked
    assert scene.flight.phase is Phase.FAILSAFE
    assert scene.vehicle.setpoints >= setpoints + 20.0 / DT_S - 2  # else offboard loss comes too
    assert scene.flight.setpoint == VelocitySetpoint(0.0, 0.0, 0.0)
    scene.vehicle.be(armed=False, in_air=False)
    assert scene.run().flight.end.reason


@pytest.mark.parametrize("mode", [FlightMode.MANUAL, FlightMode.HOLD])
def test_a_mode_is_called_a_failsafe_only_when_that_is_told(mode):
    """A HEARTBEAT shows it before CURRENT_MODE says who asked for it."""
    scene = on_route()
    said = len(scene.said)
    scene.vehicle.be(mode=mode, intended_mode=FlightMode.UNKNOWN)
    scene.go_on(0.4)
    assert not [line for line in scene.said[said:] if "its failsafe" in line]
    failsafe(scene, mode).go_on(0.4)
    assert sum(f"flies its failsafe: {mode.value}" in line for line in scene.said[said:]) == 1


@pytest.mark.parametrize("mode", [FlightMode.MANUAL, FlightMode.HOLD])
def test_what_a_person_interrupted_is_gone_on_with_however_late_it_is_told_that_he_did(mode):
    scene = on_route()
    scene.vehicle.be(mode=mode, intended_mode=FlightMode.UNKNOWN)
    scene.go_on(0.4)
    scene.vehicle.be(mode=mode)
    scene.go_on(2.0)
    assert scene.flight.phase is Phase.RELEASED
    scene.flight.obey(Order.GO_ON)
    assert scene.run(in_phase(Phase.ROUTE)).flight.phase is Phase.ROUTE


def test_no_setpoint_is_sent_where_the_sticks_may_be_a_pilots():
    scene = on_route()
    setpoints = scene.vehicle.setpoints
    scene.vehicle.be(mode=FlightMode.MANUAL, intended_mode=FlightMode.UNKNOWN)
    scene.go_on(0.5)
    assert scene.flight.phase is Phase.ROUTE  # which is no failsafe, as far as anybody knows
    scene.vehicle.be(mode=FlightMode.MANUAL)
    scene.go_on(5.0)
    assert scene.flight.phase is Phase.RELEASED
    assert scene.vehicle.setpoints <= setpoints + 1


def test_setpoints_go_on_while_nobody_has_said_who_asked_for_the_mode():
    scene = on_route()
    setpoints = scene.vehicle.setpoints
    scene.vehicle.be(mode=FlightMode.HOLD, intended_mode=FlightMode.UNKNOWN)
    scene.go_on(1.0)
    assert scene.vehicle.setpoints >= setpoints + 1.0 / DT_S - 2
    scene.vehicle.be(intended_mode=FlightMode.HOLD)
    setpoints = scene.go_on(1.0).vehicle.setpoints
    assert scene.flight.phase is Phase.RELEASED
    assert scene.go_on(5.0).vehicle.setpoints == setpoints


def test_a_critical_battery_lands_at_once():
    scene = on_route()
    scene.vehicle.be(battery_ratio=0.05)
    assert "battery critical" in scene.run().flight.end.reason


def test_losing_all_fixes_on_the_route_holds_then_comes_home():
    scene = on_route()
    scene.fixes = False
    scene.run()
    assert scene.flight.end.reason
    assert np.hypot(*scene.vehicle.position[:2]) < 5.0


@pytest.mark.parametrize(("ends", "farthest_m"), [(False, 130.0), (True, 90.0)])
def test_who_is_carried_off_by_a_gale_is_landed_and_not_where_it_ends(ends, farthest_m):
    """It flew home at its best, backwards, for as long as the battery lasted: 738 m in 80 s."""

    def blows(scene: Scene) -> bool:
        is_calm = ends and scene.flight.phase is not Phase.ROUTE
        if scene.vehicle.vehicle.mode is FlightMode.OFFBOARD and not is_calm:
            scene.vehicle.position[1] -= 14.0 * DT_S
        return False

    scene = on_route().run(blows)
    assert not scene.vehicle.vehicle.armed
    assert any("carried off" in each for each in scene.said) is not ends
    assert scene.farthest_m < farthest_m


def test_an_abort_lands_where_it_is():
    scene = on_route()
    scene.flight.abort("interrupted by the operator")
    assert scene.run().flight.end.reason == "interrupted by the operator"


def test_the_watchdog_keeps_what_it_took():
    scene = on_route()
    scene.handle.report = WatchdogReport(GuardState.LANDING, 1, 0.1)
    scene.go_on(5.0)
    assert scene.flight.phase is Phase.RELEASED


def test_a_short_stall_is_taken_back_from_a_braking_watchdog():
    scene = on_route()
    scene.handle.report = WatchdogReport(GuardState.BRAKING, 1, 0.1)
    scene.go_on(0.15)
    assert scene.handle.rejoined
    assert scene.flight.phase is Phase.ROUTE


def test_a_stall_is_taken_back_and_said_once_a_second_until_the_watchdog_has_heard():
    scene = on_route()
    scene.handle.report = WatchdogReport(GuardState.BRAKING, 1, 0.1)
    scene.go_on(2.5)
    assert scene.handle.rejoined == 3
    assert sum("taking over from the watchdog" in each for each in scene.said) == 3


def test_the_dead_mans_handle_is_held_exactly_while_we_steer():
    scene = Scene().run()
    assert any(scene.handle.beats)
    assert not scene.handle.beats[0]
    assert not scene.handle.beats[-1]


def test_a_poor_position_is_flown_slower_and_then_sought_from_higher_up():
    scene = on_route()
    scene.variance = 5.0**2
    scene.go_on(3.0)
    assert np.hypot(*scene.vehicle.velocity[:2]) < 0.6 * LimitsConfig().cruise_m_s
    scene.variance = 9.0**2
    scene.go_on(12.0)
    assert scene.flight.phase is Phase.ROUTE
    assert -scene.vehicle.position[2] > -ROUTE[0, 2] + 10.0
    assert "position uncertain by 9 m: climbing to where the map shows more" in scene.said
    scene.variance = 0.25
    scene.go_on(30.0)
    assert -scene.vehicle.position[2] == pytest.approx(-ROUTE[0, 2], abs=3.0)


def test_where_the_position_is_poor_it_returns_along_the_flown_way():
    """Out along two legs at right angles, and back along them, not across."""
    corner = np.array([[0.0, 150.0, -50.0], [150.0, 150.0, -50.0]])
    scene = Scene(mission=Mission(corner, home_ne_m=np.zeros(2)))
    scene.run(lambda scene: scene.vehicle.position[0] > 120.0)
    scene.fixes = False
    scene.run(in_phase(Phase.RETURN))
    farthest_off_m = 0.0
    while scene.flight.phase is Phase.RETURN:
        scene.go_on(0.5)
        north, east = scene.vehicle.position[:2]
        off_m = min(np.hypot(max(-east, east - 150.0, 0.0), north), abs(east - 150.0))
        farthest_off_m = max(farthest_off_m, off_m)
    assert farthest_off_m < 25.0


def test_what_it_decides_is_told_to_the_ground_stations_in_the_same_words():
    scene = on_route()
    scene.flight.obey(Order.PAUSE)
    scene.go_on(3.0)
    assert scene.vehicle.texts[-1] == "the ground station asks for a pause: holding"
    assert np.hypot(*scene.vehicle.velocity[:2]) < 0.5
    scene.flight.obey(Order.GO_ON)
    scene.go_on(1.0)
    assert scene.vehicle.texts[-1] == "all well again: going on"
    assert scene.vehicle.texts == scene.said
    progress = {phase.value for phase in Phase}
    assert scene.vehicle.warned == [text for text in scene.said if text not in progress]


def taken() -> Scene:
    """A pilot has taken over on the route, and the watchdog stood down."""
    scene = on_route()
    scene.vehicle.be(mode=FlightMode.MANUAL)
    scene.go_on(5.0)
    assert scene.flight.phase is Phase.RELEASED
    return scene


def test_what_the_pilots_side_gives_back_goes_on_where_it_was_left():
    scene = taken()
    asked = len(scene.vehicle.asked)
    scene.go_on(20.0)
    assert len(scene.vehicle.asked) == asked  # never by itself
    scene.flight.obey(Order.GO_ON)
    scene.go_on(2.0)
    assert scene.vehicle.asked[asked:] == ["offboard"]
    assert scene.flight.phase is Phase.ROUTE
    scene.run()
    assert scene.flight.end.reason is None
    assert scene.farthest_m > 80.0


def test_an_autopilot_that_refuses_leaves_the_aircraft_with_the_pilot():
    scene = taken()
    scene.vehicle.refuse["offboard"] = ["no"]
    scene.flight.obey(Order.GO_ON)
    scene.go_on(30.0)
    assert scene.flight.phase is Phase.RELEASED
    assert scene.vehicle.asked.count("offboard") == 2


def test_without_an_estimate_nothing_is_taken_back():
    scene = taken()
    scene.lost = "velocity unknown"
    scene.flight.obey(Order.GO_ON)
    scene.go_on(5.0)
    assert scene.flight.phase is Phase.RELEASED
    assert "no estimate" in scene.said[-1]


def test_a_pause_of_before_the_pilot_took_over_is_over_when_he_gives_back():
    scene = on_route()
    scene.flight.obey(Order.PAUSE)
    scene.go_on(2.0)
    scene.vehicle.be(mode=FlightMode.MANUAL)
    scene.go_on(5.0)
    scene.flight.obey(Order.GO_ON)
    assert scene.run().flight.end.reason is None


def test_a_return_that_the_pilot_interrupts_keeps_its_reason():
    scene = on_route().go_on(5.0)
    scene.vehicle.be(battery_ratio=0.2)
    scene.run(in_phase(Phase.RETURN))
    scene.vehicle.be(mode=FlightMode.MANUAL)
    scene.go_on(1.0)
    scene.flight.obey(Order.GO_ON)
    assert "battery low" in scene.run().flight.end.reason


def test_a_landing_that_the_pilot_took_over_is_not_taken_for_the_route_of_before():
    scene = taken()
    scene.flight.obey(Order.GO_ON)
    scene.run(in_phase(Phase.LAND))
    scene.vehicle.be(mode=FlightMode.MANUAL)
    scene.run(in_phase(Phase.RELEASED))
    asked = list(scene.vehicle.asked)
    scene.flight.obey(Order.GO_ON)
    scene.go_on(10.0)
    assert scene.vehicle.asked == asked
    assert "no route to go on with" in scene.said[-1]


@pytest.mark.parametrize("order", [Order.LAND, Order.RETURN, Order.PAUSE])
def test_what_is_asked_for_on_the_ground_is_said_and_does_not_wait_for_the_air(order):
    scene = Scene().go_on(1.0)
    scene.flight.obey(order)
    assert "not heeded" in scene.said[-1]
    assert scene.run().flight.end.reason is None


def test_a_pause_stops_the_descent_that_other_holds_do_not_and_what_is_done_is_told():
    scene = on_route().run(in_phase(Phase.DESCEND)).go_on(2.0)
    scene.flight.obey(Order.PAUSE)
    scene.go_on(1.0)
    assert scene.said[-1] == "the ground station asks for a pause: holding"
    height_m = -scene.vehicle.position[2]
    scene.go_on(5.0)
    assert -scene.vehicle.position[2] == pytest.approx(height_m)
    scene.variance = 9.0**2  # holds for itself, which in the descent is no reason to stay
    scene.go_on(4.0)
    assert "holding" in scene.said[-1]
    assert -scene.vehicle.position[2] == pytest.approx(height_m)
    scene.variance = 0.1
    scene.go_on(1.0).flight.obey(Order.GO_ON)
    scene.sees = False
    scene.go_on(3.0)
    assert -scene.vehicle.position[2] < height_m - 4.0
    assert scene.said[-1] == "the camera shows nothing that can be followed: going on down"


def test_a_pause_in_the_take_off_is_told_as_what_it_does():
    scene = Scene().run(in_phase(Phase.TAKEOFF))
    scene.vehicle.answers_after = 10
    scene.flight.obey(Order.PAUSE)
    scene.go_on(0.3)
    assert scene.said[-1] == "the ground station asks for a pause: after the take-off"
    scene.run(in_phase(Phase.CLIMB)).go_on(3.0)
    assert scene.said[-1] == "the ground station asks for a pause: holding"


def test_an_aircraft_that_would_only_be_landed_is_not_taken_back():
    scene = taken()
    scene.sees = False
    scene.go_on(10.0)
    asked = list(scene.vehicle.asked)
    scene.flight.obey(Order.GO_ON)
    scene.go_on(3.0)
    assert scene.vehicle.asked == asked
    assert scene.said[-1] == (
        "the camera shows nothing that can be followed: the aircraft stays the pilot's"
    )
    scene.sees = True
    scene.go_on(1.0).flight.obey(Order.GO_ON)
    assert scene.run().flight.end.reason is None


def test_an_offboard_that_a_failsafe_of_the_take_off_took_back_is_asked_for_again():
    scene = Scene().run(in_phase(Phase.TAKEOFF))
    scene.vehicle.answers_after = 30
    scene.run(lambda scene: scene.vehicle.asked[-1] == "offboard")
    scene.vehicle.be(mode=FlightMode.HOLD, intended_mode=FlightMode.TAKEOFF, failsafe=True)
    scene.go_on(1.0)
    assert scene.flight.phase is Phase.FAILSAFE
    scene.vehicle.answers_after = 1
    scene.vehicle.be(mode=FlightMode.TAKEOFF, failsafe=False)
    assert scene.run(in_phase(Phase.ROUTE)).flight.phase is Phase.ROUTE


@pytest.mark.parametrize("order", [Order.PAUSE, Order.RETURN])
def test_what_a_ground_station_asks_for_is_done_where_the_position_is_poor_too(order):
    scene = on_route()
    scene.variance = 5.0**2
    scene.go_on(2.0)
    scene.flight.obey(order)
    scene.go_on(1.0)
    if order is Order.RETURN:
        assert scene.flight.phase is Phase.RETURN
    else:
        assert np.hypot(*scene.vehicle.velocity[:2]) < 0.1


@pytest.mark.parametrize(
    ("mode", "intended", "phase"),
    [
        (FlightMode.HOLD, FlightMode.HOLD, Phase.RELEASED),
        (FlightMode.HOLD, FlightMode.OFFBOARD, Phase.FAILSAFE),
    ],
)
def test_a_mode_that_comes_between_the_answer_and_our_own_mode_is_not_taken_for_ours(
    mode, intended, phase
):
    """Every mode was ours until Offboard was seen: a pilot's own was not noticed any more."""
    scene = taken()
    scene.flight.obey(Order.GO_ON)
    scene.run(in_phase(Phase.RESUME))
    assert scene.vehicle.vehicle.mode is FlightMode.OFFBOARD  # told to nobody yet
    scene.vehicle.be(mode=mode, intended_mode=intended)
    scene.go_on(1.0)
    assert scene.flight.phase is phase
    scene.vehicle.be(mode=FlightMode.MANUAL)
    scene.go_on(0.2)
    setpoints = scene.vehicle.setpoints
    scene.go_on(5.0)
    assert scene.flight.phase is Phase.RELEASED
    assert scene.vehicle.setpoints == setpoints


def test_a_return_that_was_held_is_said_to_go_on():
    scene = on_route().go_on(5.0)
    scene.vehicle.be(battery_ratio=0.2)
    scene.run(in_phase(Phase.RETURN)).go_on(1.0)
    scene.sees = False
    scene.go_on(2.0)
    assert scene.said[-1] == "the camera shows nothing that can be followed: holding"
    scene.sees = True
    scene.go_on(1.0)
    assert scene.said[-1] == "all well again: going on"
    assert np.hypot(*scene.vehicle.velocity[:2]) > 1.0


def test_what_a_ground_station_asks_for_in_vain_is_told_once_with_what_stands_against_it():
    scene = on_route().go_on(5.0)
    scene.vehicle.be(battery_ratio=0.2)
    scene.run(in_phase(Phase.RETURN)).go_on(1.0)
    scene.flight.obey(Order.PAUSE)
    scene.go_on(3.0)
    told = "the ground station asks for a pause: not now, battery low"
    assert scene.said.count(told) == scene.vehicle.texts.count(told) == 1
    scene.flight.obey(Order.RETURN)
    scene.go_on(1.0)
    assert scene.said[-1] == told  # that is done


def test_a_pause_in_the_descent_after_a_return_does_not_begin_the_return_again():
    """It flew up to the height of a return and down again, and said so at every tick."""
    scene = on_route()
    scene.vehicle.be(battery_ratio=0.2)
    scene.run(in_phase(Phase.DESCEND)).go_on(2.0)
    said, height_m = len(scene.said), -scene.vehicle.position[2]
    scene.flight.obey(Order.PAUSE)
    scene.go_on(3.0)
    assert scene.flight.phase is Phase.DESCEND
    assert scene.said[said:] == ["the ground station asks for a pause: not now, battery low"]
    assert -scene.vehicle.position[2] < height_m - 4.0


def test_a_position_that_stays_poor_while_a_pause_lasts_in_the_descent_ends_no_pause():
    scene = on_route().run(in_phase(Phase.DESCEND)).go_on(2.0)
    scene.flight.obey(Order.PAUSE)
    scene.variance = 9.0**2
    scene.go_on(14.0)
    height_m = -scene.vehicle.position[2]
    said = len(scene.said)
    scene.go_on(15.0)
    assert scene.flight.phase is Phase.DESCEND
    assert scene.said[said:] == ["position uncertain by 9 m: holding"]
    scene.flight.obey(Order.PAUSE)  # which is done
    scene.go_on(2.0)
    assert len(scene.said) == said + 1
    assert -scene.vehicle.position[2] >= height_m
    scene.flight.obey(Order.GO_ON)
    scene.go_on(3.0)
    assert scene.said[-1] == "position uncertain by 9 m: going on down"
    assert -scene.vehicle.position[2] < height_m - 2.0


def test_a_position_that_stays_poor_in_a_return_is_not_called_well():
    scene = on_route()
    scene.flight.obey(Order.RETURN)
    scene.run(in_phase(Phase.RETURN)).go_on(1.0)
    scene.variance = 9.0**2
    scene.go_on(20.0)
    assert scene.said[-1] == "position uncertain by 9 m: returning"
    assert "all well again: going on" not in scene.said


def test_an_aircraft_whose_battery_went_critical_in_the_pilots_hands_is_not_taken_back():
    """Nobody looked: it was taken out of his hands and landed three seconds later."""
    scene = taken()
    scene.vehicle.be(battery_ratio=0.05)
    scene.go_on(20.0)
    asked = list(scene.vehicle.asked)
    scene.flight.obey(Order.GO_ON)
    scene.go_on(10.0)
    assert scene.vehicle.asked == asked
    assert scene.said[-1] == "battery critical: the aircraft stays the pilot's"


def test_what_is_asked_for_while_the_autopilot_lands_is_said_not_to_be_done():
    scene = on_route()
    scene.flight.abort("interrupted")
    scene.go_on(1.0)
    assert scene.flight.phase is Phase.LAND
    scene.flight.obey(Order.PAUSE)
    assert "not heeded" in scene.said[-1]


def test_going_on_that_ends_no_pause_is_answered_in_words():
    """It was taken without a word, and the aircraft flew home all the same."""
    scene = on_route().go_on(5.0)
    scene.flight.obey(Order.RETURN)
    scene.run(in_phase(Phase.RETURN)).go_on(1.0)
    scene.flight.obey(Order.GO_ON)
    scene.go_on(1.0)
    told = "the ground station asks for going on: not now, it has asked for the way home"
    assert scene.said[-1] == scene.vehicle.texts[-1] == told
    scene.flight.obey(Order.PAUSE)
    scene.go_on(1.0)
    scene.flight.obey(Order.GO_ON)
    scene.go_on(1.0)
    assert scene.said[-1] == "all well again: going on"
    assert scene.said.count(told) == 1


def test_going_on_says_what_holds_the_flight_besides():
    scene = on_route().go_on(5.0)
    scene.sees = False
    scene.go_on(2.0)
    scene.flight.obey(Order.GO_ON)
    scene.go_on(0.5)
    blind = "the camera shows nothing that can be followed"
    assert scene.said[-1] == f"the ground station asks for going on: not now, {blind}"


def test_an_aircraft_whose_camera_is_blind_stays_the_pilots():
    """It was taken out of his hands, held, and landed half a second later."""
    scene = taken()
    scene.sees = False
    scene.go_on(2.0)
    asked = list(scene.vehicle.asked)
    scene.flight.obey(Order.GO_ON)
    scene.go_on(10.0)
    assert scene.flight.phase is Phase.RELEASED
    assert scene.vehicle.asked == asked
    blind = "the camera shows nothing that can be followed"
    assert scene.said[-1] == f"{blind}: the aircraft stays the pilot's"
    scene.sees = True
    scene.go_on(1.0)
    scene.flight.obey(Order.GO_ON)
    assert scene.run(in_phase(Phase.ROUTE)).flight.phase is Phase.ROUTE
