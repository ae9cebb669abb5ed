"""PX4's failsafes: what is wrong, what follows from it, and when it is over."""

from dataclasses import dataclass
from enum import Enum, IntEnum

from vwnav.sim.px4.modes import POSITION_STATES, STICK_STATES, NavState
from vwnav.sim.px4.parameters import Parameters


class Action(IntEnum):
    """What a failsafe does, in order of severity."""

    NONE = 0
    WARN = 1
    POSITION = 2
    ALTITUDE = 3
    HOLD = 4
    RETURN = 5
    LAND = 6
    DESCEND = 7


class Cause(Enum):
    """What is wrong."""

    OFFBOARD_LOST = "offboard"
    POSITION_LOST = "position"
    MANUAL_LOST = "manual control"
    GCS_LOST = "ground station"
    BATTERY_CRITICAL = "battery critical"
    BATTERY_EMERGENCY = "battery emergency"
    FENCE = "fence"


# These wait COM_FAIL_ACT_T in Hold first.
_DELAYED = frozenset({Cause.MANUAL_LOST, Cause.GCS_LOST, Cause.BATTERY_CRITICAL})
# These last until the mode is changed or the vehicle disarmed, though the cause be gone.
_LATCHED = _DELAYED | {Cause.BATTERY_EMERGENCY, Cause.FENCE}
_STATE_OF = {
    Action.POSITION: NavState.POSITION,
    Action.ALTITUDE: NavState.ALTITUDE,
    Action.HOLD: NavState.HOLD,
    Action.RETURN: NavState.RETURN,
    Action.LAND: NavState.LAND,
    Action.DESCEND: NavState.DESCEND,
}
_OFFBOARD_ACTIONS = {
    0: Action.POSITION,
    1: Action.ALTITUDE,
    3: Action.RETURN,
    4: Action.LAND,
    5: Action.HOLD,
}
_LINK_ACTIONS = {1: Action.HOLD, 2: Action.RETURN, 3: Action.LAND}
_FENCE_ACTIONS = {1: Action.WARN, 2: Action.HOLD, 3: Action.RETURN, 5: Action.LAND}


@dataclass(frozen=True, slots=True, kw_only=True)
class Health:
    """What the commander looks at, fifty times a second."""

    local_position_ok: bool
    global_position_ok: bool
    heading_ok: bool
    position_stable: bool
    offboard_ok: bool
    manual_ok: bool
    gcs_lost: bool
    battery_warning: int
    landed: bool
    fence_breached: bool


class Failsafe:
    """Turns health into the state to fly instead of the intended one.

    Attributes:
        active: a failsafe is flying.
    """

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters
        self._since_s: dict[Cause, float] = {}
        self._overridden: set[Cause] = set()
        self._manual_seen = False
        self.active = False

    def reset(self) -> None:
        """On disarming."""
        self._since_s.clear()
        self._overridden.clear()
        self.active = False

    def override(self, health: Health) -> None:
        """The user chose a mode: what lasts until then is over, and is not raised again."""
        self._overridden |= {cause for cause in self._since_s if cause in _LATCHED}
        for cause in _LATCHED:
            self._since_s.pop(cause, None)

    def step(self, intended: NavState, health: Health, t_s: float) -> tuple[NavState, bool]:
        """(state to fly, whether it waits in Hold before it acts)."""
        self._manual_seen = self._manual_seen or health.manual_ok
        present = self._present(intended, health)
        self._overridden &= present
        for cause in present - self._overridden:
            self._since_s.setdefault(cause, t_s)
        for cause in list(self._since_s):
            if cause not in present and cause not in _LATCHED:
                del self._since_s[cause]
        action, waiting = Action.NONE, False
        for cause, since_s in self._since_s.items():
            wanted = self._action(cause, intended, health)
            early = t_s - since_s < self._parameters["COM_FAIL_ACT_T"]
            wait = cause in _DELAYED and early and wanted > Action.HOLD
            wanted = Action.HOLD if wait else wanted
            if wanted > action:
                action, waiting = wanted, wait
        self.active = action > Action.WARN
        if not self.active:
            return intended, False
        return self._reachable(_STATE_OF[action], health), waiting

    def _present(self, intended: NavState, health: Health) -> set[Cause]:
        """The causes that hold now."""
        if health.landed:  # what brought it down lasts until it is disarmed; nothing new begins
            return set(self._since_s)
        found: set[Cause] = set()
        if intended is NavState.OFFBOARD and not health.offboard_ok:
            found.add(Cause.OFFBOARD_LOST)
        if intended in POSITION_STATES and not health.local_position_ok:
            found.add(Cause.POSITION_LOST)
        if self._manual_lost(intended, health):
            found.add(Cause.MANUAL_LOST)
        if health.gcs_lost:
            found.add(Cause.GCS_LOST)
        if health.battery_warning == 2:
            found.add(Cause.BATTERY_CRITICAL)
        if health.battery_warning == 3:
            found.add(Cause.BATTERY_EMERGENCY)
        if health.fence_breached:
            found.add(Cause.FENCE)
        return found

    def _manual_lost(self, intended: NavState, health: Health) -> bool:
        if health.manual_ok or intended in (NavState.LAND, NavState.DESCEND):
            return False
        if intended in STICK_STATES:
            return True
        exempt_bit = {NavState.HOLD: 2, NavState.OFFBOARD: 4}.get(intended, 0)
        exempt = bool(int(self._parameters["COM_RCL_EXCEPT"]) & exempt_bit)
        return self._manual_seen and not exempt

    def _action(self, cause: Cause, intended: NavState, health: Health) -> Action:
        get = self._parameters
        battery = int(get["COM_LOW_BAT_ACT"])
        match cause:
            case Cause.OFFBOARD_LOST:
                wanted = _OFFBOARD_ACTIONS.get(int(get["COM_OBL_RC_ACT"]), Action.HOLD)
                stick = wanted in (Action.POSITION, Action.ALTITUDE)
                return Action.RETURN if stick and not health.manual_ok else wanted
            case Cause.POSITION_LOST:
                sticks = intended is NavState.POSITION and health.manual_ok
                return Action.ALTITUDE if sticks else Action.DESCEND
            case Cause.MANUAL_LOST:
                return _LINK_ACTIONS.get(int(get["NAV_RCL_ACT"]), Action.WARN)
            case Cause.GCS_LOST:
                return _LINK_ACTIONS.get(int(get["NAV_DLL_ACT"]), Action.NONE)
            case Cause.BATTERY_CRITICAL:
                return {2: Action.LAND, 3: Action.RETURN}.get(battery, Action.WARN)
            case Cause.BATTERY_EMERGENCY:
                return Action.LAND if battery in (2, 3) else Action.WARN
            case Cause.FENCE:
                return _FENCE_ACTIONS.get(int(get["GF_ACTION"]), Action.WARN)

    def _reachable(self, state: NavState, health: Health) -> NavState:
        """The state itself, or what PX4 falls back to without what the state needs."""
        if state is NavState.RETURN and not health.global_position_ok:
            state = NavState.LAND
        if state in POSITION_STATES and not health.local_position_ok:
            return NavState.ALTITUDE if state is NavState.POSITION else NavState.DESCEND
        return state
