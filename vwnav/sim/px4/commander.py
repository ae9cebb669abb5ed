"""Arming, the user's intended state, and what is flown in its stead: PX4's commander."""

from collections.abc import Callable

from vwnav.sim.mavlink.command import Landed, Result, Severity
from vwnav.sim.px4.failsafe import Failsafe, Px4Health
from vwnav.sim.px4.modes import ACCURATE_STATES, POSITION_STATES, STICK_STATES, NavState
from vwnav.sim.px4.parameters import Px4Parameters

_NOT_ARMABLE = frozenset({NavState.RETURN, NavState.LAND, NavState.DESCEND})
_GONE = ("no position", "heading estimate invalid", "horizontal position unstable")
_REPEAT_S = 2.0

Say = Callable[[Severity, str], None]


class Px4Commander:
    """The vehicle's will.

    Args:
        old: as the 1.16 era.

    Attributes:
        intended: what the user asked for; `state` is what is flown.
        armed: rotors may turn.
    """

    def __init__(self, parameters: Px4Parameters, say: Say, old: bool = False) -> None:
        self._parameters = parameters
        self._say = say
        self._old = old
        self.failsafe = Failsafe(parameters, old)
        self.intended = NavState.HOLD
        self._before = NavState.HOLD
        self.state = NavState.HOLD
        self.armed = False
        self.flown = False
        self._armed_at_s = 0.0
        self._landed_at_s = 0.0
        self._warned = 0
        self._waiting = False
        self._was_active = False
        self._said_s = -_REPEAT_S

    def problems(self, health: Px4Health) -> tuple[str, ...]:
        """What forbids arming in the intended state; () when it may arm."""
        found = []
        if self.intended in POSITION_STATES and not health.local_position_ok:
            found.append(_GONE[0])
        if not health.heading_ok:
            found.append(_GONE[1])
        if not health.position_stable:
            found.append(_GONE[2])
        if health.battery_warning >= 2:
            found.append("battery critical")
        if self.intended in STICK_STATES and not health.manual_ok:
            found.append("no manual control")
        if self.intended is NavState.OFFBOARD and not health.offboard_ok:
            found.append("no offboard signal")
        if health.gcs_lost and int(self._parameters["NAV_DLL_ACT"]) > 0:
            found.append("No connection to the GCS")
        if self.intended in _NOT_ARMABLE:
            found.append("mode not armable")
        return tuple(found)

    def arm(self, health: Px4Health, forced: bool, t_s: float) -> Result:
        """MAV_CMD_COMPONENT_ARM_DISARM 1."""
        if self.armed:
            return Result.ACCEPTED
        if not forced and self.problems(health):
            self._say(Severity.CRITICAL, "Arming denied: Resolve system health failures first")
            return Result.TEMPORARILY_REJECTED
        self.armed, self.flown = True, False
        self._armed_at_s = t_s
        self._say(Severity.INFO, "Armed by external command\t")
        return Result.ACCEPTED

    def begin_in_flight(self, state: NavState, t_s: float) -> None:
        """Be armed and flying, in a state that the user asked for."""
        self.armed = self.flown = True
        self.intended = self.state = state
        self._armed_at_s = self._landed_at_s = t_s
        self.failsafe.reset()

    def disarm(self, health: Px4Health, forced: bool) -> Result:
        """MAV_CMD_COMPONENT_ARM_DISARM 0; in the air only by force."""
        if self.armed and not health.landed and not forced:
            self._say(Severity.CRITICAL, "Disarming denied: not landed\t")
            return Result.TEMPORARILY_REJECTED
        if self.armed:
            self._stop("Disarmed by external command\t")
        return Result.ACCEPTED

    def _stop(self, text: str) -> None:
        self.armed = self.flown = False
        self.failsafe.reset()
        if self.intended in (NavState.LAND, NavState.RETURN, NavState.TAKEOFF):
            self.intended = self._before
        self._say(Severity.INFO, text)

    def ask(self, wanted: NavState, health: Px4Health) -> Result:
        """The user asks for a state; refused in the air when what it needs is missing."""
        if not self._may(wanted, health):
            self._say(Severity.CRITICAL, f"Switching to mode '{wanted.name.title()}' is denied")
            return Result.TEMPORARILY_REJECTED
        if wanted in (NavState.LAND, NavState.TAKEOFF) and self.intended is not wanted:
            self._before = self.intended
        self.intended = wanted
        self.failsafe.override()
        return Result.ACCEPTED

    def _may(self, wanted: NavState, health: Px4Health) -> bool:
        if not self.armed:
            return True
        if wanted is NavState.OFFBOARD and not health.offboard_ok:
            return False
        if wanted is NavState.RETURN and not health.global_position_ok:
            return False
        if wanted in ACCURATE_STATES and not health.position_accurate:
            return False
        if wanted in STICK_STATES and not health.manual_ok:
            return False
        return wanted not in POSITION_STATES or health.local_position_ok

    def take_over(self, health: Px4Health) -> None:
        """The pilot moved the sticks: Position, or Altitude without a position.

        In a mode of the sticks they fly, one that it fell back to as well: nothing changes.
        """
        if not self.armed or {self.intended, self.state} & STICK_STATES or health.landed:
            return
        bit = 2 if self.intended is NavState.OFFBOARD else 1
        if self._old and not int(self._parameters["COM_RC_OVERRIDE"]) & bit:
            return
        wanted = NavState.POSITION if health.local_position_ok else NavState.ALTITUDE
        self.intended = wanted
        self.failsafe.override()
        self._say(Severity.INFO, "Pilot took over using sticks\t")

    def finish_takeoff(self) -> None:
        """The take-off height is reached: Hold."""
        if self.intended is NavState.TAKEOFF:
            self.intended = NavState.HOLD

    def step(self, health: Px4Health, t_s: float) -> NavState:
        """Decide the state to fly now."""
        self._warn_battery(health)
        if not self.armed:
            self.state = self.intended
            self._report_preflight(health, t_s)
            return self.state
        self._disarm_when_down(health, t_s)
        state, waiting = self.failsafe.step(self.intended, health, t_s)
        if self.intended is NavState.LAND and not health.local_position_ok:
            state = NavState.DESCEND
        self._report_failsafe(waiting)
        self.state = state
        return state

    def _disarm_when_down(self, health: Px4Health, t_s: float) -> None:
        if not health.landed:
            if not self.flown:
                self._say(Severity.INFO, "Takeoff detected\t")
            self.flown = True
            self._landed_at_s = t_s
        elif self.flown and t_s - self._landed_at_s > self._parameters["COM_DISARM_LAND"]:
            self._stop("Disarmed by landing\t")
        elif not self.flown:
            idle_s = t_s - self._armed_at_s
            if 0.0 < self._parameters["COM_DISARM_PRFLT"] < idle_s:
                self._stop("Disarmed by auto preflight disarming\t")

    def _warn_battery(self, health: Px4Health) -> None:
        texts = {1: "Low battery\t", 2: "Critical battery\t", 3: "Emergency battery level\t"}
        if health.battery_warning > self._warned:
            severity = Severity.EMERGENCY if health.battery_warning == 3 else Severity.CRITICAL
            self._say(severity, texts[health.battery_warning])
        self._warned = health.battery_warning

    def _report_failsafe(self, waiting: bool) -> None:
        active = self.failsafe.active
        if active and waiting and not self._waiting:
            delay_s = self._parameters["COM_FAIL_ACT_T"]
            self._say(
                Severity.CRITICAL,
                f"Failsafe activated: entering Hold for {delay_s:.0f} seconds\t",
            )
        elif active and not waiting and (self._waiting or not self._was_active):
            self._say(Severity.CRITICAL, "Failsafe activated\t")
        self._waiting, self._was_active = waiting, active

    def _report_preflight(self, health: Px4Health, t_s: float) -> None:
        if t_s - self._said_s < _REPEAT_S:
            return
        self._said_s = t_s
        for problem in self.problems(health):
            if problem in _GONE[1:]:
                self._say(Severity.CRITICAL, f"Preflight Fail: {problem}")

    def landed_state(self, health: Px4Health, landing: bool) -> Landed:
        """MAV_LANDED_STATE for EXTENDED_SYS_STATE."""
        if health.landed:
            return Landed.ON_GROUND
        if self.state is NavState.TAKEOFF:
            return Landed.TAKEOFF
        return Landed.LANDING if landing else Landed.IN_AIR
