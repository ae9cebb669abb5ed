"""The mission as a state machine over estimates: what is asked of the autopilot, tick by tick.

`Flight.tick` is called at a steady rate with what there is to fly on; it never looks at a picture
and never waits. Safety may overrule each setpoint, and the pilot overrules everything.
"""

import math
from dataclasses import replace

import numpy as np

from vwnav.guidance.controller import LimitsConfig, RouteFollower, vertical_speed_m_s
from vwnav.mission.departure import Departure
from vwnav.mission.flown_way import FlownWay
from vwnav.mission.home import Home
from vwnav.mission.landing import COMING_DOWN, Landing, LandingState
from vwnav.mission.mission import Crew, DeadMansHandle, FlightConfig, FlightEnd, Mission, Phase
from vwnav.safety.monitor import Action, Decision, Rank, SafetyMonitor
from vwnav.safety.recovery import Recovery, Wish
from vwnav.safety.safety_config import SafetyConfig
from vwnav.types import (
    Array,
    Autopilot,
    Estimate,
    FlightMode,
    Navigation,
    Order,
    Request,
    VehicleState,
    VelocitySetpoint,
)
from vwnav.watchdog.keepalive import GuardState

_STILL = VelocitySetpoint(0.0, 0.0, 0.0)
GONE_S = 60.0  # of an autopilot that has not been heard for so long nobody will tell the end
_SLOW_PACE = 0.5
_REJOIN_S = 1.0
_DOING = {
    Action.SLOW: "slower",
    Action.HOLD: "holding",
    Action.CLIMB: "climbing to where the map shows more",
}
# Phases of their own, which say it.
_TOLD_ELSEWHERE = frozenset({Action.RETURN, Action.LAND, Action.YIELD, Action.RELEASE})
_CAME_DOWN = "the autopilot came down in a failsafe of its own"
_MODE_SHOWS_S = 1.0  # from an accepted take-off to the heartbeat that tells its mode


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
        self._mission = mission
        self._keep_alive = keep_alive
        self._crew = crew
        self._config = config
        self._limits = limits
        self._safety_config = safety
        self._safety = SafetyMonitor(safety, limits.cruise_m_s)
        self._departure = Departure(autopilot, config, crew.arms, self._say, crew.show)
        self._home = Home(mission.home_ne_m)
        self._height_m = float(-mission.route_ned_m[0, 2])
        self._follower: RouteFollower | None = None
        self._hold_ne_m = np.zeros(2)
        self._way = FlownWay()
        self._pace = 1.0
        self._decided = (Action.NAVIGATE, Rank.NAVIGATION)
        self._fixes = 0
        self._before: Estimate | None = None
        self._phase_since_s: float | None = None
        self._offboard: Request | None = None
        self._landing: Landing | None = None
        self._recovery: Recovery | None = None
        self._phase_before_failsafe = Phase.GET_READY
        self._lost_s: float | None = None
        self._phase_before_release = Phase.GET_READY
        self._handed_back = False
        self._trouble: str | None = None
        self._abort_reason: str | None = None
        self.phase = Phase.GET_READY
        self.setpoint: VelocitySetpoint | None = None
        self.end: FlightEnd | None = None

    @property
    def engaged(self) -> bool:
        """We steer, or have asked for a landing that is not flown yet: the watchdog listens."""
        landing_is_flown = self._autopilot.state().mode in COMING_DOWN
        return self.phase in _STEERING or (self.phase is Phase.LAND and not landing_is_flown)

    @property
    def home_ne_m(self) -> Array | None:
        """(2,) where the aircraft stood, as far as it is known."""
        return self._home.place_ne_m

    def tick(self, t_s: float, navigation: Navigation) -> None:
        """Advance the mission; to be called at 10 Hz or more until `end` is set."""
        if self.end is not None:
            return
        vehicle = self._autopilot.state()
        if self._phase_since_s is None:
            self._phase_since_s = t_s
        self._keep_alive.beat(self.engaged, self.phase.value)
        self._note(navigation.estimate)
        if self._abort_reason and self.phase not in (Phase.LAND, Phase.RELEASED, Phase.FAILSAFE):
            self._abort(t_s, vehicle)
        elif self.phase is Phase.GET_READY:
            self._get_ready(t_s, vehicle, navigation)
        elif self.phase in _OURS_NO_MORE:
            self._wait_for_ground(t_s, vehicle, navigation)
        elif not self._taken_by_watchdog(t_s) and not self._overruled(t_s, navigation, vehicle):
            assert navigation.estimate is not None
            self._fly(t_s, navigation.estimate, vehicle)

    def take_up(self, phase: Phase, estimate: Estimate) -> None:
        """Begin in the air, in Offboard and with home given, as if it had flown there.

        For simulations that start where something is going to break.
        """
        assert self._mission.home_ne_m is not None
        self._home.take(self._mission.home_ne_m)
        self._hold_ne_m = estimate.position_ned_m[:2].copy()
        if phase is Phase.RETURN:
            self._return(estimate.t_s, estimate)
        elif phase is Phase.ROUTE:
            route_ned_m = self._route_ned_m()
            self._follower = RouteFollower(route_ned_m, self._limits)
            self._safety.fly_within(route_ned_m, route_ned_m[-1, :2])
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
            self._handed_back = True
        elif self.phase in (Phase.GET_READY, Phase.RELEASED, Phase.DONE):
            self._say(f"the aircraft is not ours to fly now: {order.value} is not heeded")
        else:
            self._safety.obey(order)

    def _say(self, text: str) -> None:
        """To whoever is at the keyboard, and to the ground stations."""
        self._crew.say(text)
        self._autopilot.send_text(text)

    def _enter(self, phase: Phase, t_s: float) -> None:
        self.phase, self._phase_since_s = phase, t_s
        self._say(phase.value)

    def _in_phase_s(self, t_s: float) -> float:
        return t_s - (self._phase_since_s if self._phase_since_s is not None else t_s)

    def _finish(self, reason: str | None, unsafe: bool = False) -> None:
        self.phase, self.setpoint = Phase.DONE, None
        self._keep_alive.beat(False, self.phase.value)
        self.end = FlightEnd(reason, unsafe)

    def _abort(self, t_s: float, vehicle: VehicleState) -> None:
        if vehicle.armed and self.phase is not Phase.GET_READY:
            self._begin_landing(t_s, vehicle, self._abort_reason)
        else:
            self._autopilot.withdraw()
            if vehicle.armed and not vehicle.in_air and self._departure.has_armed:
                self._autopilot.disarm()
            self._finish(self._abort_reason)

    def _note(self, estimate: Estimate | None) -> None:
        """Count fixes. Before anybody knows where home is, the held point jumps along: it is here.

        After that it is home, and a position that jumps shows how far from it the aircraft is.
        """
        if estimate is None:
            return
        before, self._before = self._before, estimate
        if before is None:
            return
        if estimate.t_last_fix_s is not None and estimate.t_last_fix_s != before.t_last_fix_s:
            self._fixes += 1
        flown_m = (
            0.5
            * (estimate.velocity_ned_m_s + before.velocity_ned_m_s)[:2]
            * (estimate.t_s - before.t_s)
        )
        if estimate.reset_counter != before.reset_counter and self._home.place_ne_m is None:
            jump_m = (estimate.position_ned_m - before.position_ned_m)[:2] - flown_m
            self._hold_ne_m = self._hold_ne_m + jump_m
        if self.phase is not Phase.GET_READY:
            self._home.flown(flown_m)

    # ---- on the ground

    def _get_ready(self, t_s: float, vehicle: VehicleState, navigation: Navigation) -> None:
        checks = self._crew.checks(vehicle, navigation, t_s)
        outcome = self._departure.step(vehicle, checks, t_s)
        if outcome is None:
            return
        if outcome.airborne:
            self._enter(Phase.TAKEOFF, t_s)
        elif outcome.not_ours:
            self._release(t_s, str(outcome.reason))
        else:
            self._finish(outcome.reason, outcome.unsafe)

    # ---- who decides

    def _taken_by_watchdog(self, t_s: float) -> bool:
        """Whether it acts in our place. While it only brakes, a loop that stalled may take over."""
        report = self._keep_alive.report
        if report is None or report.state is GuardState.RELAY:
            return False
        if self.phase is Phase.RESUME and self._in_phase_s(t_s) < _REJOIN_S:
            return False  # it stood down, and has not heard of the new claim yet
        if report.state is GuardState.BRAKING:
            self._say("the control loop had stalled: taking over from the watchdog again")
            self._keep_alive.rejoin()
            return False
        self._release(
            t_s, "the watchdog has the aircraft: the control loop was silent for too long"
        )
        return True

    def _overruled(self, t_s: float, navigation: Navigation, vehicle: VehicleState) -> bool:
        """True when safety, not the mission, decided this tick."""
        if navigation.estimate is None:
            self._lost_s = t_s
        decision = self._safety.step(self._sighted(t_s, navigation), vehicle, t_s)
        self._tell(decision)
        self._pace = _SLOW_PACE if decision.action is Action.SLOW else 1.0
        match decision.action:
            case Action.NAVIGATE | Action.SLOW:
                return False
            case Action.RELEASE:
                self._release(t_s, decision.reason)
            case Action.YIELD:
                self._yield(t_s, decision.reason)
            case Action.LAND:
                self._begin_landing(t_s, vehicle, decision.reason)
            case _ if self.phase in (Phase.TAKEOFF, Phase.RESUME):
                return navigation.estimate is None  # a setpoint would end ArduCopter's take-off
            case _ if self.phase is Phase.DESCEND:
                # Near the ground the map shows nothing: down is the way out.
                if navigation.estimate is not None:
                    return False
                self._steer(replace(_STILL, down_m_s=self._limits.descend_m_s))
            case Action.HOLD:
                self._steer(_STILL)
            case Action.CLIMB:
                assert navigation.estimate is not None
                self._steer(replace(_STILL, down_m_s=-self._searching_climb(navigation.estimate)))
            case Action.RETURN:
                if self.phase is Phase.RETURN:
                    return False
                assert navigation.estimate is not None
                self._trouble = decision.reason
                self._say(decision.reason)
                self._return(t_s, navigation.estimate, decision.rank is Rank.POSITION)
        return True

    def _tell(self, decision: Decision) -> None:
        """A decision that is another than the last one, in words."""
        before, self._decided = self._decided, (decision.action, decision.rank)
        if self._decided == before or decision.action in _TOLD_ELSEWHERE:
            return
        if decision.action is Action.NAVIGATE:
            if before[0] not in _TOLD_ELSEWHERE:
                self._say("all well again: going on")
        else:
            self._say(f"{decision.reason}: {_DOING[decision.action]}")

    def _searching_climb(self, estimate: Estimate) -> float:
        """Upward speed, to where the map shows more: no higher than is allowed."""
        highest_m = min(
            self._height_m + self._safety_config.climb_most_m, self._safety_config.ceiling_m
        )
        missing_m = highest_m + float(estimate.position_ned_m[2])
        return float(np.clip(0.5 * missing_m, 0.0, self._limits.climb_m_s))

    def _sighted(self, t_s: float, navigation: Navigation) -> Navigation:
        """Pictures count from the climb on: standing and lifting off there is little to see."""
        if self.phase is Phase.TAKEOFF or self._phase_since_s is None:
            return replace(navigation, seen_s=t_s)
        if self.phase is Phase.CLIMB:
            newest_s = max(navigation.seen_s or -math.inf, self._phase_since_s)
            return replace(navigation, seen_s=newest_s)
        return navigation

    def _release(self, t_s: float, reason: str) -> None:
        """Somebody else has the aircraft: nothing more is asked for, estimates go on."""
        self._autopilot.withdraw()
        if self.phase in (Phase.ROUTE, Phase.RETURN):
            self._phase_before_release = self.phase
        self._trouble = self._trouble or reason
        self.setpoint = None
        self._say(reason)
        self._enter(Phase.RELEASED, t_s)

    def _yield(self, t_s: float, reason: str) -> None:
        """The autopilot flies a failsafe that may be ours to end, later."""
        self._autopilot.withdraw()
        missed = self._lost_lately(t_s) or self._safety.gap_s > 0.0
        explained = self._safety.battery_is_enough and missed
        self._recovery = Recovery(self._safety_config, explained)
        self._phase_before_failsafe = self.phase
        self.setpoint = None
        self._say(reason)
        self._enter(Phase.FAILSAFE, t_s)

    def _recover(self, t_s: float, vehicle: VehicleState, navigation: Navigation) -> None:
        """What a failsafe of the autopilot lets us do."""
        assert self._recovery is not None
        decision = self._safety.step(navigation, vehicle, t_s)
        if decision.action is Action.RELEASE and not self._recovery.has_asked:
            self._release(t_s, decision.reason)
            return
        if navigation.estimate is None:
            self._lost_s = t_s
        gap_s = math.inf if self._lost_lately(t_s) else self._safety.gap_s
        match self._recovery.step(vehicle, navigation.estimate, gap_s, t_s):
            case Wish.GO_ON:
                self._enter(self._phase_before_failsafe, t_s)
            case Wish.STAY:
                self._steer(_STILL)
            case Wish.HOLD:
                self._autopilot.hold()
            case Wish.LAND:
                self._begin_landing(t_s, vehicle, "the link or the estimate was lost for too long")
            case Wish.WAIT:
                pass

    def _resume(self, t_s: float, vehicle: VehicleState, navigation: Navigation) -> None:
        """The pilot's side gives the aircraft back, in so many words: on where it was left."""
        self._handed_back = False
        if self._phase_before_release is Phase.GET_READY or not vehicle.in_air:
            self._say("there is no route to go on with: the aircraft stays the pilot's")
        elif navigation.estimate is None:
            self._say("there is no estimate to fly on: the aircraft stays the pilot's")
        else:
            self._safety.resume()
            self._trouble = None
            self._keep_alive.rejoin()
            self._offboard = self._autopilot.start_offboard()
            self._enter(Phase.RESUME, t_s)

    def _take_again(self, t_s: float) -> None:
        request = self._offboard
        assert request is not None
        if not request.done:
            return
        if request.refused is None:
            self._enter(self._phase_before_release, t_s)
        else:
            self._release(t_s, f"the autopilot refused Offboard: {request.refused}")

    def _lost_lately(self, t_s: float) -> bool:
        memory_s = self._safety_config.gap_memory_s
        return self._lost_s is not None and t_s - self._lost_s < memory_s

    # ---- the mission

    def _fly(self, t_s: float, estimate: Estimate, vehicle: VehicleState) -> None:
        match self.phase:
            case Phase.TAKEOFF:
                self._take_off(t_s, estimate, vehicle)
            case Phase.RESUME:
                self._take_again(t_s)
            case Phase.CLIMB:
                self._climb(t_s, estimate)
            case Phase.FIRST_FIX:
                self._wait_for_fix(t_s, estimate, vehicle)
            case Phase.ROUTE | Phase.RETURN:
                self._follow(t_s, estimate)
            case Phase.DESCEND:
                self._descend(t_s, estimate, vehicle)

    def _take_off(self, t_s: float, estimate: Estimate, vehicle: VehicleState) -> None:
        """The autopilot climbs by itself; then it is asked for Offboard."""
        height_m = -float(estimate.position_ned_m[2])
        if vehicle.mode is FlightMode.MANUAL and self._in_phase_s(t_s) > _MODE_SHOWS_S:
            self._release(t_s, "the pilot took over")
        elif not vehicle.armed:
            if self._in_phase_s(t_s) > self._config.arming_shows_s:
                self._autopilot.withdraw()
                self._finish("the aircraft was disarmed during take-off")
        elif self._offboard is not None:
            self._ask_for_offboard(t_s, vehicle)
        elif height_m >= 0.85 * self._config.takeoff_height_m or self._hovers(vehicle, height_m):
            self._hold_ne_m = estimate.position_ned_m[:2].copy()
            self._offboard = self._autopilot.start_offboard()
        elif self._in_phase_s(t_s) > self._config.takeoff_timeout_s:
            self._begin_landing(t_s, vehicle, "the take-off did not reach its height")

    def _ask_for_offboard(self, t_s: float, vehicle: VehicleState) -> None:
        request = self._offboard
        assert request is not None
        if not request.done:
            return
        if request.refused is None:
            self._enter(Phase.CLIMB, t_s)
        else:
            reason = f"the autopilot refused Offboard: {request.refused}"
            self._begin_landing(t_s, vehicle, reason)

    def _hovers(self, vehicle: VehicleState, height_m: float) -> bool:
        """The autopilot's take-off is over, at what it takes for the height."""
        return vehicle.mode is FlightMode.HOLD and height_m > 0.3 * self._config.takeoff_height_m

    def _climb(self, t_s: float, estimate: Estimate) -> None:
        """Straight up over the start, wherever that is."""
        missing_m = self._height_m + float(estimate.position_ned_m[2])
        if missing_m < 1.0:
            self._enter(Phase.FIRST_FIX, t_s)
        down_m_s = vertical_speed_m_s(-max(missing_m, 0.0), 0.0, self._limits)
        self._steer(self._hold(estimate, down_m_s))

    def _wait_for_fix(self, t_s: float, estimate: Estimate, vehicle: VehicleState) -> None:
        if self._fixes >= self._config.fixes_to_start:
            self._begin_route(t_s, estimate, vehicle)
        elif self._in_phase_s(t_s) > self._config.first_fix_timeout_s:
            reason = "no fix above home: the map shows another place, or the camera does not work"
            self._begin_landing(t_s, vehicle, reason)
        else:
            self._steer(self._hold(estimate, self._height_error(estimate)))

    def _begin_route(self, t_s: float, estimate: Estimate, vehicle: VehicleState) -> None:
        """Now it is known where the aircraft stood, and with that where the route lies."""
        self._settle_home(estimate)
        route_ned_m = self._route_ned_m()
        refused = self._mission.refuse(route_ned_m)
        if refused:
            self._begin_landing(t_s, vehicle, refused)
            return
        self._follower = RouteFollower(route_ned_m, self._limits)
        self._safety.fly_within(route_ned_m, route_ned_m[-1, :2])
        self._enter(Phase.ROUTE, t_s)
        self._steer(self._hold(estimate, self._height_error(estimate)))

    def _settle_home(self, estimate: Estimate) -> None:
        told = self._home.settle(estimate)
        if told:
            self._say(told)

    def _route_ned_m(self) -> Array:
        """(n + 1, 3) the waypoints and the way back to above home."""
        home_ne_m, route_ned_m = self._home.place_ne_m, self._mission.route_ned_m
        assert home_ne_m is not None
        if self._mission.about_home:
            route_ned_m = np.add(route_ned_m, [*home_ne_m, 0.0])
        return np.vstack([route_ned_m, [*home_ne_m, route_ned_m[-1, 2]]])

    def _return(self, t_s: float, estimate: Estimate, as_flown: bool = False) -> None:
        """Straight home, or `as_flown`: over ground where the map has matched."""
        self._settle_home(estimate)
        home_ne_m = self._home.place_ne_m
        assert home_ne_m is not None
        way_ned_m = np.array([[*home_ne_m, estimate.position_ned_m[2]]])
        if as_flown:
            way_ned_m = self._way.back_ned_m(estimate, home_ne_m)
        self._follower = RouteFollower(way_ned_m, self._limits)
        self._enter(Phase.RETURN, t_s)

    def _follow(self, t_s: float, estimate: Estimate) -> None:
        assert self._follower is not None
        assert self._home.place_ne_m is not None
        if self.phase is Phase.ROUTE:
            self._way.note(estimate)
        step = self._follower.step(estimate, self._pace)
        self._steer(step.setpoint)
        if step.done:
            self._hold_ne_m = self._home.place_ne_m
            self._enter(Phase.DESCEND, t_s)

    def _descend(self, t_s: float, estimate: Estimate, vehicle: VehicleState) -> None:
        height_m = -float(estimate.position_ned_m[2])
        if height_m < self._config.land_from_m:
            self._begin_landing(t_s, vehicle, None)
            return
        self._steer(self._hold(estimate, self._limits.descend_m_s))

    def _hold(self, estimate: Estimate, down_m_s: float) -> VelocitySetpoint:
        """Stay over the held point while moving vertically."""
        wanted = (self._hold_ne_m - estimate.position_ned_m[:2]) * self._config.hold_gain_per_s
        speed = float(np.hypot(*wanted))
        wanted *= min(1.0, self._config.hold_speed_m_s / max(speed, 1e-9))
        return VelocitySetpoint(float(wanted[0]), float(wanted[1]), down_m_s)

    def _height_error(self, estimate: Estimate) -> float:
        """Downward speed that brings the aircraft to the route's height."""
        error_m = -self._height_m - float(estimate.position_ned_m[2])
        return vertical_speed_m_s(error_m, 0.0, self._limits)

    def _steer(self, setpoint: VelocitySetpoint) -> None:
        values = (setpoint.north_m_s, setpoint.east_m_s, setpoint.down_m_s)
        if not all(math.isfinite(v) for v in values):
            raise ValueError(f"setpoint is not finite: {setpoint}")
        self.setpoint = setpoint
        self._autopilot.send_velocity(setpoint)

    # ---- down

    def _begin_landing(self, t_s: float, vehicle: VehicleState, trouble: str | None) -> None:
        """Hand over to the autopilot's own landing; `trouble` is why, None after a whole route."""
        self._trouble = self._trouble or trouble
        if trouble:
            self._say(trouble)
        self.setpoint = None
        self._landing = Landing(self._autopilot, vehicle, t_s, self._say)
        self._enter(Phase.LAND, t_s)

    def _wait_for_ground(self, t_s: float, vehicle: VehicleState, navigation: Navigation) -> None:
        """The aircraft comes down, or is somebody else's; it is left when the motors stop."""
        if not vehicle.armed:
            by_itself = _CAME_DOWN if self.phase is Phase.FAILSAFE else None
            self._finish(self._trouble or by_itself)
        elif vehicle.silence_s > GONE_S:
            self._finish(f"{self._trouble}; the autopilot was not heard any more")
        elif self.phase is Phase.FAILSAFE:
            self._recover(t_s, vehicle, navigation)
        elif self.phase is Phase.RELEASED and self._handed_back:
            self._resume(t_s, vehicle, navigation)
        elif self.phase is Phase.LAND:
            assert self._landing is not None
            state = self._landing.step(vehicle, t_s)
            self._trouble = self._trouble or self._landing.refused
            if state is LandingState.TAKEN:
                self._release(t_s, "the pilot took over while landing")


# In the autopilot's own take-off too: if we die in it, nobody else would bring the aircraft down.
_STEERING = frozenset(
    {
        Phase.TAKEOFF,
        Phase.RESUME,
        Phase.CLIMB,
        Phase.FIRST_FIX,
        Phase.ROUTE,
        Phase.RETURN,
        Phase.DESCEND,
    }
)
_OURS_NO_MORE = frozenset({Phase.LAND, Phase.FAILSAFE, Phase.RELEASED})
