"""PX4's failsafes: what is wrong, what follows from it, and when it is over."""

from dataclasses import dataclass
from enum import Enum, IntEnum

from vwnav.sim.px4.modes import ACCURATE_STATES, POSITION_STATES, STICK_STATES, NavState
from vwnav.sim.px4.parameters import Px4Parameters

CELLS = 4
_FULL_V, _EMPTY_V = 4.05, 3.6  # per cell, PX4's simulator: 16.2 V full


class FailsafeAction(IntEnum):
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
    FailsafeAction.POSITION: NavState.POSITION,
    FailsafeAction.ALTITUDE: NavState.ALTITUDE,
    FailsafeAction.HOLD: NavState.HOLD,
    FailsafeAction.RETURN: NavState.RETURN,
    FailsafeAction.LAND: NavState.LAND,
    FailsafeAction.DESCEND: NavState.DESCEND,
}
_OFFBOARD_ACTIONS = {
    0: FailsafeAction.POSITION,
    1: FailsafeAction.ALTITUDE,
    3: FailsafeAction.RETURN,
    4: FailsafeAction.LAND,
    5: FailsafeAction.HOLD,
}
# Offboard flies attitudes too: velocities that lack a position count as setpoints that are lost.
_WANT_A_POSITION = POSITION_STATES - {NavState.OFFBOARD}
_LINK_ACTIONS = {1: FailsafeAction.HOLD, 2: FailsafeAction.RETURN, 3: FailsafeAction.LAND}
_FENCE_ACTIONS = {
    1: FailsafeAction.WARN,
    2: FailsafeAction.HOLD,
    3: FailsafeAction.RETURN,
    5: FailsafeAction.LAND,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Px4Health:
    """What the commander looks at, fifty times a second."""

    local_position_ok: bool
    global_position_ok: bool
    position_accurate: bool
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

    Args:
        old: as the 1.16 era: it falls back to the modes of the sticks where there are none.

    Attributes:
        active: a failsafe is flying.
    """

    def __init__(self, parameters: Px4Parameters, old: bool = False) -> None:
        self._parameters = parameters
        self._old = old
        self._since_s: dict[Cause, float] = {}
        self._overridden: set[Cause] = set()
        self._manual_seen = False
        self.active = False

    def reset(self) -> None:
        """On disarming."""
        self._since_s.clear()
        self._overridden.clear()
        self.active = False

    def override(self) -> None:
        """The user chose a mode: what lasts until then is over, and is not raised again."""
        self._overridden |= {cause for cause in self._since_s if cause in _LATCHED}
        for cause in _LATCHED:
            self._since_s.pop(cause, None)

    def step(self, intended: NavState, health: Px4Health, t_s: float) -> tuple[NavState, bool]:
        """(state to fly, whether it waits in Hold before it acts)."""
        self._manual_seen = self._manual_seen or health.manual_ok
        present = self._present(intended, health)
        self._overridden &= present
        for cause in present - self._overridden:
            self._since_s.setdefault(cause, t_s)
        for cause in list(self._since_s):
            if cause not in present and cause not in _LATCHED:
                del self._since_s[cause]
        action, waiting = FailsafeAction.NONE, False
        for cause, since_s in self._since_s.items():
            wanted = self._action(cause, intended, health)
            early = t_s - since_s < self._parameters["COM_FAIL_ACT_T"]
            wait = cause in _DELAYED and early and wanted > FailsafeAction.HOLD
            wanted = FailsafeAction.HOLD if wait else wanted
            if wanted > action:
                action, waiting = wanted, wait
        self.active = action > FailsafeAction.WARN
        if not self.active:
            return intended, False
        return self._reachable(_STATE_OF[action], health), waiting

    def _present(self, intended: NavState, health: Px4Health) -> set[Cause]:
        """The causes that hold now."""
        if health.landed:  # what brought it down lasts until it is disarmed; nothing new begins
            return set(self._since_s)
        found: set[Cause] = set()
        if intended is NavState.OFFBOARD and not health.offboard_ok:
            found.add(Cause.OFFBOARD_LOST)
        if intended in _WANT_A_POSITION and not health.local_position_ok:
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

    def _manual_lost(self, intended: NavState, health: Px4Health) -> bool:
        if health.manual_ok or intended in (NavState.LAND, NavState.DESCEND):
            return False
        if intended in STICK_STATES:
            return True
        exempt_bit = {NavState.HOLD: 2, NavState.OFFBOARD: 4}.get(intended, 0)
        exempt = bool(int(self._parameters["COM_RCL_EXCEPT"]) & exempt_bit)
        return self._manual_seen and not exempt

    def _action(self, cause: Cause, intended: NavState, health: Px4Health) -> FailsafeAction:
        get = self._parameters
        battery = int(get["COM_LOW_BAT_ACT"])
        match cause:
            case Cause.OFFBOARD_LOST:
                wanted = _OFFBOARD_ACTIONS.get(int(get["COM_OBL_RC_ACT"]), FailsafeAction.HOLD)
                stick = wanted in (FailsafeAction.POSITION, FailsafeAction.ALTITUDE)
                reachable = health.manual_ok or self._old
                return FailsafeAction.RETURN if stick and not reachable else wanted
            case Cause.POSITION_LOST:
                sticks = intended is NavState.POSITION and health.manual_ok
                return FailsafeAction.ALTITUDE if sticks else FailsafeAction.DESCEND
            case Cause.MANUAL_LOST:
                return _LINK_ACTIONS.get(int(get["NAV_RCL_ACT"]), FailsafeAction.WARN)
            case Cause.GCS_LOST:
                return _LINK_ACTIONS.get(int(get["NAV_DLL_ACT"]), FailsafeAction.NONE)
            case Cause.BATTERY_CRITICAL:
                return {2: FailsafeAction.LAND, 3: FailsafeAction.RETURN}.get(
                    battery, FailsafeAction.WARN
                )
            case Cause.BATTERY_EMERGENCY:
                return FailsafeAction.LAND if battery in (2, 3) else FailsafeAction.WARN
            case Cause.FENCE:
                return _FENCE_ACTIONS.get(int(get["GF_ACTION"]), FailsafeAction.WARN)

    def _reachable(self, state: NavState, health: Px4Health) -> NavState:
        """The state itself, or what PX4 falls back to without what the state needs."""
        if state is NavState.RETURN and not health.global_position_ok:
            state = NavState.LAND
        if state in ACCURATE_STATES and not health.position_accurate:
            state = NavState.LAND
        if state in POSITION_STATES and not health.local_position_ok:
            return NavState.ALTITUDE if state is NavState.POSITION else NavState.DESCEND
        return state


class Px4Battery:
    """Charge 0..1; `warning` is 0 none, 1 low, 2 critical, 3 emergency (battery_status.warning)."""

    def __init__(self, start: float, parameters: Px4Parameters) -> None:
        self._parameters = parameters
        self.remaining = start
        self.consumed_mah = 0.0
        self.warning = 0

    def step(self, armed: bool, dt_s: float) -> None:
        """Drain for `dt_s` when armed, full to empty in SIM_BAT_DRAIN, and set the warning."""
        get = self._parameters
        left = self.remaining - 0.01 * get["SIM_BAT_MIN_PCT"]
        if armed and left > 0.0:
            used = min(left, dt_s / max(get["SIM_BAT_DRAIN"], 1.0))
            self.remaining -= used
            self.consumed_mah += 5000.0 * used
        thresholds = ((3, "BAT_EMERGEN_THR"), (2, "BAT_CRIT_THR"), (1, "BAT_LOW_THR"))
        self.warning = next((level for level, name in thresholds if self.remaining < get[name]), 0)

    @property
    def voltage_v(self) -> float:
        """Of the whole pack."""
        return CELLS * (_EMPTY_V + (_FULL_V - _EMPTY_V) * self.remaining)

    @property
    def charge_state(self) -> int:
        """MAV_BATTERY_CHARGE_STATE: OK 1, LOW 2, CRITICAL 3, EMERGENCY 4."""
        return 1 + self.warning
