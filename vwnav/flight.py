"""The mission as a state machine over estimates: what is asked of the autopilot, tick by tick.

`Flight.tick` is called at a steady rate with the newest estimate; it never looks at a picture.
Safety may overrule each setpoint, and the pilot overrules everything.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from typing import Protocol

import numpy as np

from vwnav.guidance.controller import LimitsConfig, RouteFollower
from vwnav.safety.estimate_guard import is_flyable
from vwnav.safety.keepalive import GuardState, WatchdogReport
from vwnav.safety.monitor import Action, SafetyMonitor
from vwnav.types import (
    Array,
    Autopilot,
    Estimate,
    FlightMode,
    VehicleState,
    VelocitySetpoint,
)


@dataclass(frozen=True, slots=True)
class FlightConfig:
    """Times and heights of a mission."""

    ready_timeout_s: float = 90.0  # the autopilot's filter must trust our estimate within this
    ready_steady_s: float = 4.0  # PX4 was seen ready for 2.1 s, then for 6 s not, then for good
    departure_tries: int = 3  # readiness may go in the very moment of arming
    takeoff_height_m: float = 4.0  # flown by the autopilot's own take-off
    climb_m_s: float = 3.0
    descend_m_s: float = 2.0
    land_from_m: float = 5.0  # below this the autopilot's own landing takes over
    first_fix_timeout_s: float = 20.0  # hovering at height without any fix
    fixes_to_start: int = 3
    takeoff_timeout_s: float = 40.0
    landing_timeout_s: float = 120.0
    land_again_s: float = 1.0  # a landing that was refused or not heard is asked for again
    lost_land_s: float = 2.0  # PX4 gives up 4.6 s, ArduCopter 8 s after the last estimate
    hold_gain_per_s: float = 0.5
    hold_speed_m_s: float = 1.5


class Phase(Enum):
    """Where the mission stands."""

    GET_READY = "getting ready"
    TAKEOFF = "taking off"
    CLIMB = "climbing"
    FIRST_FIX = "waiting for a fix"
    ROUTE = "on route"
    RETURN = "returning"
    DESCEND = "descending"
    LAND = "landing"
    RELEASED = "pilot flies"
    DONE = "done"


@dataclass(frozen=True, slots=True)
class FlightEnd:
    """How the flight ended; `reason` is None when the whole route was flown."""

    reason: str | None


class DeadMansHandle(Protocol):
    """What the mission needs of `vwnav.safety.keepalive.KeepAlive`."""

    @property
    def report(self) -> WatchdogReport | None:
        """The watchdog's newest answer."""
        ...

    def beat(self, engaged: bool, phase: str) -> None:
        """Say that the loop lives, and whether it steers."""
        ...

    def rejoin(self) -> None:
        """Take the aircraft back from a watchdog that acts."""
        ...


class Flight:
    """Flies a route and comes home.

    Args:
        route_ned_m: (n, 3) waypoints about home; the way back to above home is added.
        say: receives one line per event.
    """

    def __init__(
        self,
        autopilot: Autopilot,
        route_ned_m: Array,
        safety: SafetyMonitor,
        keep_alive: DeadMansHandle,
        config: FlightConfig,
        limits: LimitsConfig,
        say: Callable[[str], None],
    ) -> None:
        self._autopilot = autopilot
        self._safety = safety
        self._keep_alive = keep_alive
        self._config = config
        self._limits = limits
        self._say = say
        self._height_m = float(-route_ned_m[0, 2])
        home_ned_m = np.array([[0.0, 0.0, route_ned_m[-1, 2]]])
        self._follower = RouteFollower(np.vstack([route_ned_m, home_ned_m]), limits)
        self._hold_ne_m: Array | None = None
        self._fixes = 0
        self._t_last_fix_s: float | None = None
        self._ready_since_s: float | None = None
        self._phase_since_s: float | None = None
        self._refusals = 0
        self._lost_since_s: float | None = None
        self._asked_to_land_s = 0.0
        self._comes_down = False
        self._said_refused = False
        self._mode_before_landing: FlightMode | None = None
        self._trouble: str | None = None
        self._abort_reason: str | None = None
        self.phase = Phase.GET_READY
        self.setpoint: VelocitySetpoint | None = None
        self.end: FlightEnd | None = None

    @property
    def engaged(self) -> bool:
        """We steer: setpoints are ours and the watchdog listens for the beat."""
        return self.phase in _STEERING

    def tick(self, t_s: float, estimate: Estimate | None) -> None:
        """Advance the mission; to be called at 10 Hz or more until `end` is set."""
        if self.end is not None:
            return
        vehicle = self._autopilot.state()
        if self._phase_since_s is None:
            self._phase_since_s = t_s
        self._keep_alive.beat(self.engaged, self.phase.value)
        if self._abort_reason and self.phase not in (Phase.LAND, Phase.RELEASED):
            self._abort(t_s, vehicle)
            return
        if estimate is None:
            self._wait_for_estimate(t_s)
            return
        self._count_fixes(estimate)
        if self.engaged and self._taken_by_watchdog(t_s):
            return
        if self.phase is not Phase.GET_READY and not self._overruled(t_s, estimate, vehicle):
            self._fly(t_s, estimate, vehicle)
        elif self.phase is Phase.GET_READY:
            self._get_ready(t_s, vehicle)

    def abort(self, reason: str) -> None:
        """Land where we are; the next tick does it. A flight that has ended stays as it ended."""
        self._abort_reason = reason

    def _enter(self, phase: Phase, t_s: float) -> None:
        self.phase, self._phase_since_s = phase, t_s
        self._say(phase.value)

    def _in_phase_s(self, t_s: float) -> float:
        return t_s - (self._phase_since_s if self._phase_since_s is not None else t_s)

    def _finish(self, reason: str | None) -> None:
        self.phase, self.setpoint = Phase.DONE, None
        self._keep_alive.beat(False, self.phase.value)
        self.end = FlightEnd(reason)

    def _abort(self, t_s: float, vehicle: VehicleState) -> None:
        if vehicle.armed:
            self._begin_landing(t_s, self._abort_reason)
        else:
            self._finish(self._abort_reason)

    def _wait_for_estimate(self, t_s: float) -> None:
        if self._in_phase_s(t_s) > self._config.ready_timeout_s:
            self._finish("no estimate: neither attitude nor height came from the autopilot")

    def _count_fixes(self, estimate: Estimate) -> None:
        if estimate.t_last_fix_s is not None and estimate.t_last_fix_s != self._t_last_fix_s:
            self._t_last_fix_s = estimate.t_last_fix_s
            self._fixes += 1

    def _get_ready(self, t_s: float, vehicle: VehicleState) -> None:
        """Arm and take off once the autopilot has trusted our estimate steadily."""
        if not (vehicle.armable and vehicle.local_position_ok):
            self._ready_since_s = None
        elif self._ready_since_s is None:
            self._ready_since_s = t_s
        elif t_s - self._ready_since_s >= self._config.ready_steady_s:
            self._depart(t_s)
            return
        if self._in_phase_s(t_s) > self._config.ready_timeout_s:
            missing = "local position" if vehicle.armable else "readiness to arm"
            self._finish(
                f"the autopilot reported no {missing} in {self._config.ready_timeout_s:.0f} s: "
                "is it set up for vision? `vwnav doctor --connection URL` checks its parameters"
            )

    def _depart(self, t_s: float) -> None:
        """Arm and take off; when that is refused, wait until it is ready once more."""
        height_m = self._config.takeoff_height_m
        refused = self._autopilot.arm() or self._autopilot.takeoff(height_m)
        if refused is None:
            self._enter(Phase.TAKEOFF, t_s)
            return
        self._refusals += 1
        self._ready_since_s = None
        reason = f"the autopilot refused to take off: {refused}"
        if self._refusals < self._config.departure_tries:
            self._say(reason)
            return
        if self._autopilot.state().armed:
            self._autopilot.disarm()
        self._finish(reason)

    def _taken_by_watchdog(self, t_s: float) -> bool:
        """Whether it acts in our place. While it only brakes, a loop that stalled may take over."""
        report = self._keep_alive.report
        if report is None or report.state is GuardState.RELAY:
            return False
        if report.state is GuardState.BRAKING:
            self._say("the control loop had stalled: taking over from the watchdog again")
            self._keep_alive.rejoin()
            return False
        self._trouble = "the watchdog has the aircraft: the control loop was silent for too long"
        self.setpoint = None
        self._enter(Phase.RELEASED, t_s)
        return True

    def _overruled(self, t_s: float, estimate: Estimate, vehicle: VehicleState) -> bool:
        """True when safety, not the mission, decided this tick."""
        if self.phase in (Phase.LAND, Phase.RELEASED):
            return False
        decision = self._safety.step(estimate, vehicle, t_s)
        if decision.action is not Action.RELEASE and self._is_lost(estimate, t_s):
            decision = replace(decision, action=Action.LAND, reason="the estimate is lost")
        match decision.action:
            case Action.NAVIGATE:
                return False
            case Action.RELEASE:
                self._trouble = decision.reason
                self.setpoint = None
                self._enter(Phase.RELEASED, t_s)
            case Action.LAND:
                self._begin_landing(t_s, decision.reason)
            case Action.HOLD | Action.RETURN if self.phase is Phase.DESCEND:
                return False  # near the ground the map shows nothing: down is the way out
            case Action.HOLD | Action.RETURN if self.phase is Phase.TAKEOFF:
                return False  # a setpoint would end ArduCopter's take-off where it is
            case Action.HOLD:
                self._steer(VelocitySetpoint(0.0, 0.0, 0.0))
            case Action.RETURN:
                if self.phase is Phase.RETURN:
                    return False
                self._trouble = decision.reason
                home = np.array([[0.0, 0.0, estimate.position_ned_m[2]]])
                self._follower = RouteFollower(home, self._limits)
                self._enter(Phase.RETURN, t_s)
        return True

    def _is_lost(self, estimate: Estimate, t_s: float) -> bool:
        """It has not been sent for a while: down, before the autopilot gives up by itself.

        Without sticks PX4 of the 1.16 era would then drift in Altitude mode, and nobody land it.
        """
        if is_flyable(estimate):
            self._lost_since_s = None
            return False
        self._lost_since_s = t_s if self._lost_since_s is None else self._lost_since_s
        return t_s - self._lost_since_s >= self._config.lost_land_s

    def _fly(self, t_s: float, estimate: Estimate, vehicle: VehicleState) -> None:
        match self.phase:
            case Phase.TAKEOFF:
                self._take_off(t_s, estimate, vehicle)
            case Phase.CLIMB:
                self._climb(t_s, estimate)
            case Phase.FIRST_FIX:
                self._wait_for_fix(t_s, estimate)
            case Phase.ROUTE | Phase.RETURN:
                self._follow(t_s, estimate)
            case Phase.DESCEND:
                self._descend(t_s, estimate)
            case Phase.LAND | Phase.RELEASED:
                self._wait_for_ground(t_s, vehicle)

    def _take_off(self, t_s: float, estimate: Estimate, vehicle: VehicleState) -> None:
        """The autopilot climbs by itself; then it is asked for Offboard, once."""
        height_m = -float(estimate.position_ned_m[2])
        if not vehicle.armed and self._in_phase_s(t_s) > 3.0:
            self._finish("the autopilot disarmed during take-off")
        elif height_m >= 0.85 * self._config.takeoff_height_m or self._hovers(vehicle, height_m):
            self._hold_ne_m = estimate.position_ned_m[:2].copy()
            self._autopilot.send_velocity(VelocitySetpoint(0.0, 0.0, 0.0))
            refused = self._autopilot.start_offboard()
            if refused:
                self._begin_landing(t_s, f"the autopilot refused Offboard: {refused}")
            else:
                self._enter(Phase.CLIMB, t_s)
        elif self._in_phase_s(t_s) > self._config.takeoff_timeout_s:
            self._begin_landing(t_s, "the take-off did not reach its height")

    def _hovers(self, vehicle: VehicleState, height_m: float) -> bool:
        """The autopilot's take-off is over, at what it takes for the height."""
        return vehicle.mode is FlightMode.HOLD and height_m > 0.3 * self._config.takeoff_height_m

    def _climb(self, t_s: float, estimate: Estimate) -> None:
        """Straight up over the start, wherever that is."""
        missing_m = self._height_m + float(estimate.position_ned_m[2])
        if missing_m < 1.0:
            self._enter(Phase.FIRST_FIX, t_s)
        self._steer(self._hold(estimate, -min(self._config.climb_m_s, max(missing_m, 0.0) * 0.8)))

    def _wait_for_fix(self, t_s: float, estimate: Estimate) -> None:
        if self._fixes >= self._config.fixes_to_start:
            self._enter(Phase.ROUTE, t_s)
        elif self._in_phase_s(t_s) > self._config.first_fix_timeout_s:
            self._begin_landing(
                t_s, "no fix above home: the map shows another place, or the camera does not work"
            )
            return
        self._steer(self._hold(estimate, self._height_error(estimate)))

    def _follow(self, t_s: float, estimate: Estimate) -> None:
        step = self._follower.step(estimate)
        self._steer(step.setpoint)
        if step.done:
            self._hold_ne_m = np.zeros(2)
            self._enter(Phase.DESCEND, t_s)

    def _descend(self, t_s: float, estimate: Estimate) -> None:
        height_m = -float(estimate.position_ned_m[2])
        if height_m < self._config.land_from_m:
            self._begin_landing(t_s, None)
            return
        self._steer(self._hold(estimate, self._config.descend_m_s))

    def _hold(self, estimate: Estimate, down_m_s: float) -> VelocitySetpoint:
        """Stay over the held point while moving vertically."""
        assert self._hold_ne_m is not None
        wanted = (self._hold_ne_m - estimate.position_ned_m[:2]) * self._config.hold_gain_per_s
        speed = float(np.hypot(*wanted))
        wanted *= min(1.0, self._config.hold_speed_m_s / max(speed, 1e-9))
        return VelocitySetpoint(float(wanted[0]), float(wanted[1]), down_m_s)

    def _height_error(self, estimate: Estimate) -> float:
        """Downward speed that brings the aircraft to the route's height."""
        error_m = self._height_m + float(estimate.position_ned_m[2])
        return float(np.clip(-error_m * 0.8, -self._config.climb_m_s, self._config.descend_m_s))

    def _steer(self, setpoint: VelocitySetpoint) -> None:
        values = (setpoint.north_m_s, setpoint.east_m_s, setpoint.down_m_s)
        if not all(math.isfinite(v) for v in values):
            raise ValueError(f"setpoint is not finite: {setpoint}")
        self.setpoint = setpoint
        self._autopilot.send_velocity(setpoint)

    def _begin_landing(self, t_s: float, trouble: str | None) -> None:
        """Hand over to the autopilot's own landing; `trouble` is why, None after a whole route."""
        self._trouble = self._trouble or trouble
        if trouble:
            self._say(trouble)
        self.setpoint = None
        self._enter(Phase.LAND, t_s)
        self._keep_alive.beat(False, self.phase.value)
        self._mode_before_landing = self._autopilot.state().mode
        self._land(t_s)

    def _land(self, t_s: float) -> None:
        self._asked_to_land_s = t_s
        refused = self._autopilot.land()
        if refused and not self._said_refused:
            self._said_refused = True  # once: it is asked for every second
            self._trouble = self._trouble or f"the autopilot refused to land: {refused}"
            self._say(f"the autopilot refused to land: {refused}")

    def _landing_is_not_begun(self, vehicle: VehicleState) -> bool:
        """The mode is still the one that we wanted to leave: nobody has chosen another."""
        waits = self.phase is Phase.LAND and not self._comes_down
        return waits and vehicle.mode is self._mode_before_landing

    def _wait_for_ground(self, t_s: float, vehicle: VehicleState) -> None:
        self._comes_down = self._comes_down or vehicle.mode in _COMING_DOWN
        if not vehicle.armed:
            self._finish(self._trouble)
        elif self.phase is Phase.LAND and self._in_phase_s(t_s) > self._config.landing_timeout_s:
            self._finish(self._trouble or "the autopilot did not report the landing")
        elif self._landing_is_not_begun(vehicle):
            # Not heard, or refused: without setpoints ArduCopter would coast for three seconds.
            if vehicle.mode is FlightMode.OFFBOARD:
                self._autopilot.send_velocity(VelocitySetpoint(0.0, 0.0, 0.0))
            if t_s - self._asked_to_land_s >= self._config.land_again_s:
                self._land(t_s)
        elif (
            self.phase is Phase.LAND
            and vehicle.in_air
            and vehicle.mode not in _COMING_DOWN
            and self._in_phase_s(t_s) > 3.0
        ):
            self._trouble = self._trouble or "the pilot took over while landing"
            self._enter(Phase.RELEASED, t_s)


# In the autopilot's own take-off too: if we die in it, nobody else would bring the aircraft down.
_STEERING = frozenset(
    {Phase.TAKEOFF, Phase.CLIMB, Phase.FIRST_FIX, Phase.ROUTE, Phase.RETURN, Phase.DESCEND}
)
_COMING_DOWN = frozenset({FlightMode.LAND, FlightMode.DESCEND})
