"""The autopilot's own landing: asked for until it is flown, watched until the motors stop."""

import math
from collections.abc import Callable
from enum import Enum

from vwnav.vehicle import Autopilot, FlightMode, Request, VehicleState, VelocitySetpoint

COMING_DOWN = frozenset({FlightMode.LAND, FlightMode.DESCEND})
_ASKED_BY_US = frozenset({FlightMode.TAKEOFF, FlightMode.OFFBOARD, FlightMode.LAND})
_ASK_AGAIN_S = 1.0
_TAKEN_AFTER_S = 3.0  # modes told late are not somebody's choice yet
_DISARM_AFTER_S = 10.0  # on the ground; autopilots do it by themselves after 2 to 3 s
_SLOW_S = 120.0
_STEADIES_S = 6.0  # after a Hold that was asked for: until it is asked for again, one is ours
_HEARD_S = 1.0  # after so long a silence an answer may have been lost with the rest


class LandingState(Enum):
    """Where a landing stands."""

    ASKED = "asked for"
    COMING_DOWN = "coming down"
    TAKEN = "taken over"
    DOWN = "down"


class Landing:
    """One landing, from the moment it is wanted.

    Until the autopilot flies it, zero velocity is sent in Offboard: without setpoints ArduCopter
    would coast for three seconds. Nothing is asked for any more once the aircraft stands: a Land
    asked for at the moment of disarming stays as the mode on the ground.

    Attributes:
        refused: the autopilot's words when it would not land; None when it never refused.
    """

    def __init__(
        self, autopilot: Autopilot, vehicle: VehicleState, t_s: float, say: Callable[[str], None]
    ) -> None:
        self._autopilot = autopilot
        self._say = say
        self._began_s = t_s
        goes_over = {FlightMode.HOLD} if vehicle.mode is FlightMode.TAKEOFF else set()  # by itself
        is_told = vehicle.intended_mode is not FlightMode.UNKNOWN
        intended = vehicle.intended_mode if is_told else vehicle.mode
        self._modes_before = goes_over | {vehicle.mode, intended}
        self._ours = _ASKED_BY_US | goes_over | {intended}
        self._is_flown = False  # the landing itself, not a failsafe that happens to come down
        self._request: Request | None = None
        self._asked_s = t_s
        self._steadied_s = -math.inf
        self._stands_since_s: float | None = None
        self._said_slow = self._was_silent = False
        self.refused: str | None = None
        if vehicle.mode in COMING_DOWN:
            autopilot.withdraw()  # a Hold that was asked for before would end it
        else:
            self._request = autopilot.land()

    def step(self, vehicle: VehicleState, t_s: float) -> LandingState:
        """One look, and what has to be asked for."""
        if not vehicle.armed:
            return LandingState.DOWN
        if not vehicle.in_air:
            return self._stands(vehicle, t_s)
        self._stands_since_s = None
        if t_s - self._began_s > _SLOW_S and not self._said_slow:
            self._said_slow = True
            self._say(f"not down after {_SLOW_S:.0f} s: still waiting")
        if vehicle.mode in COMING_DOWN:
            if vehicle.lands_blind and t_s - self._steadied_s >= _STEADIES_S:
                self._steady(t_s)
            is_flown = self._is_flown or vehicle.intended_mode is vehicle.mode
            self._is_flown = is_flown and t_s - self._steadied_s >= _STEADIES_S
            return LandingState.COMING_DOWN
        if not self._is_changed(vehicle):
            self._ask(vehicle, t_s)
        elif self._is_told(vehicle, t_s):
            return self._taken()
        return LandingState.ASKED

    def _steady(self, t_s: float) -> None:
        """It has a position again, and would hold none until another mode was flown."""
        self._say("it came down without a position, and has one again: Hold, then Land")
        self._steadied_s = self._asked_s = t_s
        self._modes_before = self._modes_before | {FlightMode.HOLD}
        self._ours = self._ours | {FlightMode.HOLD}
        self._request = self._autopilot.hold()

    def _is_changed(self, vehicle: VehicleState) -> bool:
        """By somebody: a failsafe of the autopilot's that comes not down is asked to land, too.

        Who chooses the very mode to which it had fallen back changes what is asked for alone. Out
        of a failsafe PX4 goes back by itself to what was asked for.
        """
        if self._fell_back(vehicle):
            return False
        is_ours = not self._is_flown and vehicle.mode in self._modes_before
        return not is_ours or self._is_persons(vehicle)

    def _is_persons(self, vehicle: VehicleState) -> bool:
        """A mode of the sticks, or one that was asked for by somebody else."""
        is_chosen = vehicle.intended_mode not in self._ours | {FlightMode.UNKNOWN}
        return not self._fell_back(vehicle) and (vehicle.mode is FlightMode.MANUAL or is_chosen)

    def _fell_back(self, vehicle: VehicleState) -> bool:
        return vehicle.is_fallback and vehicle.intended_mode in self._ours

    def _is_told(self, vehicle: VehicleState, t_s: float) -> bool:
        """Modes come late; for a moment it may not be told who chose one."""
        may_be_fallback = vehicle.intended_mode is FlightMode.UNKNOWN is not vehicle.mode
        return t_s - self._began_s > _TAKEN_AFTER_S and not may_be_fallback

    def _taken(self) -> LandingState:
        self._autopilot.withdraw()
        return LandingState.TAKEN

    def _ask(self, vehicle: VehicleState, t_s: float) -> None:
        """The mode is still the one that we want to leave: not heard, refused, or under way."""
        if vehicle.mode is FlightMode.OFFBOARD:
            self._autopilot.send_velocity(VelocitySetpoint(0.0, 0.0, 0.0))
        request = self._request
        self._was_silent = self._was_silent or vehicle.silence_s > _HEARD_S
        if request is not None and not request.done:
            return
        # Once, though it is asked every second; who was not heard has not refused.
        refused = None if request is None else request.refused
        if refused is not None and self.refused is None and not self._was_silent:
            self.refused = f"the autopilot refused to land: {refused}"
            self._say(self.refused)
        if t_s - self._asked_s >= _ASK_AGAIN_S:
            self._asked_s, self._request = t_s, self._autopilot.land()
            self._was_silent = False

    def _stands(self, vehicle: VehicleState, t_s: float) -> LandingState:
        """On the ground with running motors, which a pilot may want."""
        if self._is_persons(vehicle) and self._is_told(vehicle, t_s):
            return self._taken()
        self._stands_since_s = t_s if self._stands_since_s is None else self._stands_since_s
        if t_s - self._stands_since_s >= _DISARM_AFTER_S:
            self._say("the aircraft stands and is still armed: disarming")
            self._stands_since_s = t_s
            self._autopilot.disarm()
        return LandingState.COMING_DOWN
