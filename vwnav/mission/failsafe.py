"""What safety decides, in words; and when the mission goes on after a failsafe of the autopilot."""

import math
from dataclasses import replace

from vwnav.mission.mission import Next, Phase
from vwnav.mission.steering import Steering
from vwnav.safety.hierarchy import Action, Decision, Rank
from vwnav.safety.recovery import Recovery, Wish
from vwnav.safety.safety_config import SafetyConfig
from vwnav.vehicle import Autopilot, Navigation, VehicleState

_TOO_LONG = "the link or the estimate was lost for too long"
_DOING = {
    Action.SLOW: "slower",
    Action.HOLD: "holding",
    Action.CLIMB: "climbing to where the map shows more",
}
# But in these phases, which go on all the same; a pause ends the descent.
_DOING_ALL_THE_SAME = {Phase.TAKEOFF: "after the take-off", Phase.DESCEND: "going on down"}
_ON_THE_WAY_HOME = (Phase.RETURN, Phase.DESCEND)  # the phase itself has been said


class FailsafeRecovery:
    """The autopilot's failsafe, one at a time, and whether the estimate was lost before it.

    Attributes:
        interrupted: the phase of the mission that a person ended, where it was none: who chose the
            mode is told a moment after the mode. None once it was told to be one.
    """

    def __init__(self, autopilot: Autopilot, steering: Steering, config: SafetyConfig) -> None:
        self._autopilot = autopilot
        self._steering = steering
        self._config = config
        self._lost_s: float | None = None
        self._before = Phase.GET_READY
        self._recovery: Recovery | None = None
        self.interrupted: Phase | None = None

    def note(self, navigation: Navigation, t_s: float) -> None:
        """Remember that there was no estimate."""
        if navigation.estimate is None:
            self._lost_s = t_s

    def begin(self, phase: Phase, gap_s: float, battery_is_enough: bool, t_s: float) -> None:
        """It has begun, in that phase of the mission; `gap_s` as `SafetyMonitor` has it."""
        missed = self._lost_lately(t_s) or gap_s > 0.0
        self._recovery = Recovery(self._config, explained=battery_is_enough and missed)
        self._before = self.interrupted = phase

    def step(
        self,
        decision: Decision,
        gap_s: float,
        vehicle: VehicleState,
        navigation: Navigation,
        t_s: float,
    ) -> Next | None:
        """What follows when it has ended; what may be asked for until then is asked for."""
        assert self._recovery is not None
        if vehicle.is_fallback:
            self.interrupted = None
        if decision.action is Action.RELEASE and not self._recovery.has_brought(vehicle):
            return Next(Phase.RELEASED, decision.reason)
        self.note(navigation, t_s)
        gap_s = math.inf if self._lost_lately(t_s) else gap_s
        match self._recovery.step(vehicle, navigation.estimate, gap_s, t_s):
            case Wish.GO_ON:
                return Next(self._before)
            case Wish.STAY:
                self._steering.still()
            case Wish.HOLD:
                self._autopilot.hold()
            case Wish.LAND:
                return Next(Phase.LAND, _TOO_LONG)
            case Wish.WAIT:
                pass
        return None

    def _lost_lately(self, t_s: float) -> bool:
        return self._lost_s is not None and t_s - self._lost_s < self._config.gap_memory_s


class Announcer:
    """Remembers what was decided last."""

    def __init__(self) -> None:
        self._decided = (Action.NAVIGATE, Rank.NAVIGATION, "")
        self._returns_for = ""
        self._yields_to = ""

    def of_failsafe(self, decision: Decision) -> str:
        """What the autopilot flies in our place, when that is news."""
        if decision.action is not Action.YIELD or decision.reason == self._yields_to:
            return ""
        self._yields_to = decision.reason
        return decision.reason

    def words(self, decision: Decision, phase: Phase, is_paused: bool) -> str:
        """Of a decision that is another than the last one, or means another thing in this phase.

        "" where nothing is to be said.
        """
        doing = _doing(decision, phase, is_paused)
        before, self._decided = self._decided, (decision.action, decision.rank, doing)
        if decision.action is not Action.YIELD:
            self._yields_to = ""
        returned_for = self._returns_for
        if decision.action is Action.RETURN:
            self._returns_for = decision.reason
        if self._decided == before:
            return ""
        if decision.action in _DOING:
            return f"{decision.reason}: {doing}"
        goes_home = decision.action is Action.RETURN and phase in _ON_THE_WAY_HOME
        goes_on = decision.action is Action.NAVIGATE or goes_home
        if not goes_on or before[0] not in _DOING:
            return ""
        if goes_home and decision.reason != returned_for:
            goes = _DOING_ALL_THE_SAME.get(phase, phase.value)
            return "" if before[2] == goes else f"{decision.reason}: {goes}"
        return "all well again: going on"


def paused_above_home(decision: Decision) -> Decision:
    """Who returns for the position is there: in the descent it stays, for who wants it to."""
    returns = decision.action is Action.RETURN and decision.rank is Rank.POSITION
    return replace(decision, action=Action.HOLD) if returns else decision


def _doing(decision: Decision, phase: Phase, is_paused: bool) -> str:
    """What is done by a decision; "" of one that has no words of its own."""
    doing = _DOING.get(decision.action, "")
    if not doing or (phase is Phase.DESCEND and is_paused):
        return doing
    return _DOING_ALL_THE_SAME.get(phase, doing)
