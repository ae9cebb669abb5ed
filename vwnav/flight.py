"""The mission as a state machine over estimates: what is asked of the autopilot, tick by tick.

`Flight.tick` is called at a steady rate with what there is to fly on; it never looks at an image
and never waits. Safety may overrule each setpoint, and the pilot overrules everything.
"""

import math
from dataclasses import replace

from vwnav.guidance.limits import LimitsConfig
from vwnav.mission.config import FlightConfig
from vwnav.mission.departure import Departure
from vwnav.mission.failsafe import Announcer, FailsafeRecovery, paused_above_home
from vwnav.mission.landing import COMING_DOWN, Landing, LandingState
from vwnav.mission.mission import GONE_S, Crew, DeadMansHandle, FlightEnd, Mission, Next, Phase
from vwnav.mission.route_phases import RoutePhases
from vwnav.mission.steering import Steering
from vwnav.mission.takeover import Takeover
from vwnav.safety.hierarchy import Action, Rank
from vwnav.safety.monitor import SafetyMonitor
from vwnav.safety.safety_config import SafetyConfig
from vwnav.types import Array, Estimate
from vwnav.vehicle import Autopilot, Navigation, Order, VehicleState, VelocitySetpoint
from vwnav.watchdog.keepalive import GuardState

_SLOW_PACE = 0.5
_REJOIN_S = 1.0
_CAME_DOWN = "the autopilot came down in a failsafe of its own"


class Flight:
    """Flies a route and comes home."""

    def __init__(
        self,
        autopilot: Autopilot,
        mission: Mission,
        keep_alive: DeadMansHandle,
        crew: Crew,
        config: FlightConfig,
        limits: LimitsConfig,
        safety: SafetyConfig,
    ) -> None:
        self._autopilot = autopilot
        self._keep_alive = keep_alive
        self._crew = crew
        self._safety = SafetyMonitor(safety, limits.cruise_m_s)
        self._departure = Departure(autopilot, config, crew.arms, self._say, crew.show)
        self._arming_shows_s = config.arming_shows_s
        height_m = float(-mission.route_ned_m[0, 2])
        self._highest_m = min(height_m + safety.climb_most_m, safety.ceiling_m)
        self._steering = Steering(autopilot, config, limits, height_m)
        self._route = RoutePhases(
            autopilot, mission, self._steering, config, limits, self._safety.fly_within, self._say
        )
        self._pace = 1.0
        self._announcer = Announcer()
        self._phase_since_s: float | None = None
        self._rejoined_s = -math.inf
        self._landing: Landing | None = None
        self._failsafe = FailsafeRecovery(autopilot, self._steering, safety)
        self._takeover = Takeover(autopilot, self._say)
        self._trouble: str | None = None
        self._abort_reason: str | None = None
        self.phase = Phase.GET_READY
        self.end: FlightEnd | None = None

    @property
    def engaged(self) -> bool:
        """We steer, or have asked for what is not flown yet: the watchdog listens."""
        if self.phase is Phase.GET_READY:
            return self._departure.motors_may_run
        landing_is_flown = self._autopilot.state().mode in COMING_DOWN
        return self.phase.is_ours or (self.phase is Phase.LAND and not landing_is_flown)

    @property
    def home_ne_m(self) -> Array | None:
        """(2,) where the aircraft stood, as far as it is known."""
        return self._route.home_ne_m

    @property
    def setpoint(self) -> VelocitySetpoint | None:
        """What is flown now; None while we ask for nothing."""
        return self._steering.setpoint

    def tick(self, t_s: float, navigation: Navigation) -> None:
        """Advance the mission; to be called at 10 Hz or more until `end` is set."""
        if self.end is not None:
            return
        vehicle = self._autopilot.state()
        self._phase_since_s = t_s if self._phase_since_s is None else self._phase_since_s
        self._keep_alive.beat(self.engaged, self.phase.value, navigation.learned)
        self._route.note(navigation, on_ground=self.phase is Phase.GET_READY)
        if self.phase is Phase.GET_READY:
            self._get_ready(t_s, vehicle, navigation)
        elif self.phase.is_ours_no_more:
            self._wait_for_ground(t_s, vehicle, navigation)
        elif self._is_disarmed(t_s, vehicle):
            self._autopilot.withdraw()
            self._finish(f"the aircraft was disarmed while {self.phase.value}")
        elif self._abort_reason:
            self._begin_landing(t_s, vehicle, self._abort_reason)
        elif not self._taken_by_watchdog(t_s) and not self._overruled(t_s, navigation, vehicle):
            assert navigation.estimate is not None
            self._fly(t_s, navigation.estimate, vehicle)

    def take_up(self, phase: Phase, estimate: Estimate) -> None:
        """Begin in the air, in Offboard and with home given, as if it had flown there.

        For simulations that start where something is going to break.
        """
        self._route.take_up(phase, estimate)
        self.phase, self._phase_since_s = phase, estimate.t_s

    def ride(self, t_s: float, reason: str) -> None:
        """Ask for nothing: estimates alone go out, until the aircraft is disarmed."""
        self._release(t_s, reason)

    def abort(self, reason: str) -> None:
        """Land where we are; the next tick does it. A flight that has ended stays as it ended."""
        self._abort_reason = reason

    def go(self) -> None:
        """A person at the keyboard lets it arm, when it has said that it is ready."""
        self._departure.go()

    def obey(self, order: Order) -> None:
        """A ground station asks for it; in the air the hierarchy decides what comes of that."""
        if order is Order.START:
            self.go()
        elif order is Order.GO_ON and self.phase is Phase.RELEASED:
            self._takeover.given_back = True
            self._safety.obey(order)  # a pause of before is over, too
        elif not self.phase.is_ours and self.phase is not Phase.FAILSAFE:
            self._say(f"the aircraft is not ours to fly now: {order.value} is not heeded")
        else:
            self._safety.obey(order)

    def _say(self, text: str) -> None:
        """To whoever is at the keyboard, and to the ground stations; "" is not said."""
        if text:
            self._crew.say(text)
            self._autopilot.send_text(text)

    def _enter(self, phase: Phase, t_s: float) -> None:
        self.phase, self._phase_since_s = phase, t_s
        self._route.begin_phase()
        self._crew.say(phase.value)
        if phase is not Phase.RELEASED:  # in whose hands it is then, its reason says
            self._autopilot.send_text(phase.value, warns=False)

    def _in_phase_s(self, t_s: float) -> float:
        return t_s - (self._phase_since_s if self._phase_since_s is not None else t_s)

    def _finish(self, reason: str | None, unsafe: bool = False) -> None:
        self._steering.stop()
        self.phase = Phase.DONE
        self._keep_alive.beat(False, self.phase.value)
        self.end = FlightEnd(reason, unsafe)

    def _is_disarmed(self, t_s: float, vehicle: VehicleState) -> bool:
        """A person or the autopilot stopped the motors: who arms it again does so for himself."""
        told = self.phase is not Phase.TAKEOFF or self._in_phase_s(t_s) > self._arming_shows_s
        return told and not vehicle.armed

    # ---- on the ground

    def _get_ready(self, t_s: float, vehicle: VehicleState, navigation: Navigation) -> None:
        if self._abort_reason:
            self._departure.stop(self._abort_reason)
        self._rejoin_on_ground(t_s)
        checks = self._crew.checks(vehicle, navigation, t_s)
        outcome = self._departure.step(vehicle, checks, t_s)
        if outcome is None:
            return
        if outcome.airborne and outcome.reason:
            self._begin_landing(t_s, vehicle, outcome.reason)
        elif outcome.airborne:
            self._enter(Phase.TAKEOFF, t_s)
        elif outcome.not_ours:
            self._release(t_s, str(outcome.reason))
        else:
            self._say(outcome.reason or "")
            self._finish(outcome.reason, outcome.unsafe)

    def _rejoin_on_ground(self, t_s: float) -> None:
        """A watchdog that took over a loop that stalled lets no disarming pass, and sends none."""
        report = self._keep_alive.report
        if self.engaged and report is not None and report.state is not GuardState.RELAY:
            self._rejoin(t_s)

    def _rejoin(self, t_s: float) -> bool:
        """Take the aircraft back from the watchdog, which hears of a claim within a second."""
        if t_s < self._rejoined_s + _REJOIN_S:
            return False
        self._keep_alive.rejoin()
        self._rejoined_s = t_s
        return True

    # ---- who decides

    def _taken_by_watchdog(self, t_s: float) -> bool:
        """Whether it acts in our place. While it only brakes, a loop that stalled may take over."""
        report = self._keep_alive.report
        if report is None or report.state is GuardState.RELAY:
            return False
        if self.phase is Phase.RESUME and self._in_phase_s(t_s) < _REJOIN_S:
            return False  # it stood down, and has not heard of the new claim yet
        if report.state is GuardState.BRAKING:
            if self._rejoin(t_s):
                self._say("the control loop had stalled: taking over from the watchdog again")
            return False
        self._release(t_s, "the watchdog has the aircraft: the control loop was silent too long")
        return True

    def _overruled(self, t_s: float, navigation: Navigation, vehicle: VehicleState) -> bool:
        """True when safety, not the mission, decided this tick."""
        self._failsafe.note(navigation, t_s)
        steers = self.phase.is_steered
        decision = self._safety.step(self._sighted(t_s, navigation), vehicle, t_s, steers)
        is_paused = self._safety.is_paused
        if self.phase is Phase.DESCEND and is_paused:
            decision = paused_above_home(decision)
        self._say(self._announcer.words(decision, self.phase, is_paused))
        self._say(self._safety.unheeded(decision))
        self._pace = _SLOW_PACE if decision.action is Action.SLOW else 1.0
        match decision.action:
            case Action.NAVIGATE | Action.SLOW:
                return False
            case Action.RELEASE:
                self._release(t_s, decision.reason)
            case Action.YIELD if vehicle.may_be_pilots:
                self._autopilot.withdraw()
                self._steering.stop()
            case Action.YIELD:
                self._yield(t_s, self._announcer.of_failsafe(decision))
            case Action.LAND:
                self._begin_landing(t_s, vehicle, decision.reason)
            case _ if self.phase in (Phase.TAKEOFF, Phase.RESUME):
                return navigation.estimate is None  # a setpoint would end ArduCopter's take-off
            case Action.RETURN if self.phase in (Phase.RETURN, Phase.DESCEND):
                return False
            case _ if self.phase is Phase.DESCEND and not is_paused:
                # Near the ground the map shows nothing: down is the way out.
                if navigation.estimate is not None:
                    return False
                self._steering.descend_blind()
            case Action.HOLD:
                self._steering.still()
            case Action.CLIMB:
                assert navigation.estimate is not None
                self._steering.search_upwards(navigation.estimate, self._highest_m)
            case Action.RETURN:
                assert navigation.estimate is not None
                self._trouble = decision.reason
                self._say(decision.reason)
                self._route.turn_home(navigation.estimate, decision.rank is Rank.POSITION)
                self._enter(Phase.RETURN, t_s)
        return True

    def _sighted(self, t_s: float, navigation: Navigation) -> Navigation:
        """Images count from the climb on: standing and lifting off there is little to see."""
        if self.phase is Phase.TAKEOFF or self._phase_since_s is None:
            return replace(navigation, seen_s=t_s)
        if self.phase is Phase.CLIMB:
            newest_s = max(navigation.seen_s or -math.inf, self._phase_since_s)
            return replace(navigation, seen_s=newest_s)
        return navigation

    def _release(self, t_s: float, reason: str) -> None:
        """Somebody else has the aircraft: nothing more is asked for, estimates go on."""
        self._autopilot.withdraw()
        interrupted = self._failsafe.interrupted if self.phase is Phase.FAILSAFE else None
        self._takeover.begin(interrupted or self.phase, self._trouble)
        self._trouble = self._trouble or reason
        self._steering.stop()
        self._say(reason)
        self._enter(Phase.RELEASED, t_s)

    def _yield(self, t_s: float, reason: str) -> None:
        """The autopilot flies a failsafe that may be ours to end, later."""
        self._autopilot.withdraw()
        self._failsafe.begin(self.phase, self._safety.gap_s, self._safety.battery_is_enough, t_s)
        self._steering.stop()
        self._say(reason)
        self._enter(Phase.FAILSAFE, t_s)

    def _resume(self, t_s: float, vehicle: VehicleState, navigation: Navigation) -> None:
        """The pilot's side gives the aircraft back, in so many words: on where it was left."""
        lands_for = self._safety.lands_for(navigation, vehicle, t_s)
        if self._takeover.ask_back(vehicle, navigation, lands_for):
            self._safety.resume()
            self._trouble = self._takeover.trouble
            self._keep_alive.rejoin()
            self._enter(Phase.RESUME, t_s)

    # ---- the mission

    def _fly(self, t_s: float, estimate: Estimate, vehicle: VehicleState) -> None:
        if self.phase is Phase.RESUME:
            following = self._takeover.answer()
        else:
            since_s = self._in_phase_s(t_s)
            following = self._route.step(self.phase, since_s, estimate, vehicle, self._pace)
        self._go_on(following, t_s, vehicle)

    def _go_on(self, following: Next | None, t_s: float, vehicle: VehicleState) -> None:
        """Enter the phase that follows, if one does."""
        match following:
            case Next(Phase.LAND, reason):
                self._begin_landing(t_s, vehicle, reason)
            case Next(Phase.RELEASED, str(reason)):
                self._release(t_s, reason)
            case Next(phase):
                self._enter(phase, t_s)

    # ---- down

    def _begin_landing(self, t_s: float, vehicle: VehicleState, trouble: str | None) -> None:
        """Hand over to the autopilot's own landing; `trouble` is why, None after a whole route."""
        self._trouble = self._trouble or trouble
        self._say(trouble or "")
        self._steering.stop()
        self._landing = Landing(self._autopilot, vehicle, t_s, self._say)
        self._enter(Phase.LAND, t_s)

    def _wait_for_ground(self, t_s: float, vehicle: VehicleState, navigation: Navigation) -> None:
        """The aircraft comes down, or is somebody else's; it is left when the motors stop."""
        if not vehicle.armed:
            by_itself = _CAME_DOWN if self.phase is Phase.FAILSAFE else None
            self._finish(self._trouble or by_itself)
        elif vehicle.silence_s > GONE_S:
            trouble = f"{self._trouble}; " if self._trouble else ""
            self._finish(f"{trouble}the autopilot was not heard any more")
        elif self.phase is Phase.FAILSAFE:
            decision, gap_s = self._safety.step(navigation, vehicle, t_s), self._safety.gap_s
            self._say(self._announcer.of_failsafe(decision))
            self._say(self._safety.unheeded(decision))
            ended = self._failsafe.step(decision, gap_s, vehicle, navigation, t_s)
            self._go_on(ended, t_s, vehicle)
        elif self.phase is Phase.RELEASED:
            self._safety.watch(navigation, vehicle, t_s)
            if self._takeover.given_back:
                self._resume(t_s, vehicle, navigation)
        elif self.phase is Phase.LAND:
            assert self._landing is not None
            state = self._landing.step(vehicle, t_s)
            self._trouble = self._trouble or self._landing.refused
            if state is LandingState.TAKEN:
                self._release(t_s, "the pilot took over while landing")
