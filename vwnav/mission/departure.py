"""From standing on the ground to the autopilot's own take-off: readiness, a person's word, arming.

Arming and take-off are asked for only of a disarmed aircraft on the ground whose readiness list is
complete. An aircraft that is armed without our asking is somebody else's. Motors that we may have
started are ours until they are seen to stand, however their starting was answered.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from vwnav.mission.config import DepartureConfig
from vwnav.mission.mission import GONE_S
from vwnav.safety.check import Check
from vwnav.safety.readiness import missing
from vwnav.vehicle import NO_ANSWER, Autopilot, FlightMode, Request, VehicleState

_PILOT_HAS_IT = Check(
    "pilot", "FAIL", "chose a mode of his own: choose Hold (GUIDED on ArduCopter) to go on"
)
_PILOTS = frozenset({FlightMode.MANUAL, FlightMode.MISSION, FlightMode.OTHER})
_LETS_US = frozenset({FlightMode.HOLD, FlightMode.OFFBOARD})  # who arms in them
# PX4 is in Offboard again once it is down, and stays in what was chosen on the ground.
_NOBODY_ARMS_IN = frozenset(
    {FlightMode.OFFBOARD, FlightMode.LAND, FlightMode.RETURN, FlightMode.TAKEOFF}
)
_HOW_TO_ARM = (
    "ready: press Enter, or arm: from a ground station in Hold, or by the radio in a mode of the "
    "sticks, and then choose Hold (on ArduCopter GUIDED for Hold)"
)
_NOT_OURS = (
    "the aircraft is armed, and not by vwnav: somebody else flies it; vwnav only sends estimates "
    "until it is disarmed"
)
_ASK_AGAIN_S = 1.0
_MISSING_FOR_S, _MISSING_AGAIN_S = 15.0, 30.0  # PX4 alone settles for ten
_STAND_BY_AGAIN_S = 5.0
# They would start, stop and start again beside whoever looks why.
_NOT_AGAIN = (
    "it was not known whether the motors ran, and they stand: nothing was flown, and it is not "
    "armed again by itself"
)


class Stage(Enum):
    """How far the departure has got."""

    READINESS = "getting ready"
    PERSON = "waiting for a person"
    ARM = "arming"
    ARMED = "waiting for the autopilot to show that it is armed"
    TAKE_OFF = "asking for take-off"
    STOP = "making sure that the motors stand"


@dataclass(frozen=True, slots=True)
class DepartureOutcome:
    """How the departure ended.

    Attributes:
        airborne: the autopilot takes off for us; with a reason, though it was not to.
        not_ours: somebody else armed the aircraft and has it.
        reason: why it ended otherwise; `unsafe` when the readiness list was not complete.
    """

    airborne: bool = False
    not_ours: bool = False
    reason: str | None = None
    unsafe: bool = False


class Departure:
    """One departure; `step` it until it has an outcome.

    Args:
        arms: whether it arms by itself; else `go` starts it, or a person who arms: in Hold,
            Offboard or GUIDED, or in a mode of the sticks and chooses one of those on the ground.
        say: receives one line per event.
        show: receives the list whenever what is missing changes.
    """

    def __init__(
        self,
        autopilot: Autopilot,
        config: DepartureConfig,
        arms: bool,
        say: Callable[[str], None],
        show: Callable[[tuple[Check, ...]], None],
    ) -> None:
        self._autopilot = autopilot
        self._config = config
        self._arms = arms
        self._invited = False  # a pilot was told that he may arm
        self._say = say
        self._show = show
        self._unready_since_s: float | None = None
        self._ready_since_s: float | None = None
        self._shown: str | None = None
        self._tell_s: float | None = None  # what is missing, unless it is ready for good by then
        self._request: Request | None = None
        self._armed_s: float | None = None  # our arming was accepted
        self._refusals = 0
        self._mode = FlightMode.UNKNOWN
        self._pilots = False  # a mode of a pilot's was chosen since it began
        self._ends: str | None = None  # why it is to end
        self._stops_s = self._runs_s = self._asked_s = self._stood_by_s = -math.inf
        self._waits_for_mode = False  # armed in a mode of the sticks, by whom we had invited
        self.stage = Stage.READINESS

    @property
    def motors_may_run(self) -> bool:
        """They were asked to start, and have not been seen to stand since."""
        return self.stage not in (Stage.READINESS, Stage.PERSON)

    def go(self) -> None:
        """A person at the keyboard lets it arm; before it has asked for that word it is none."""
        self._arms = self._arms or self.stage is Stage.PERSON

    def stop(self, reason: str) -> None:
        """End it: at once while nothing was begun, else when the motors stand."""
        self._ends = self._ends or reason

    def step(
        self, vehicle: VehicleState, checks: tuple[Check, ...], t_s: float
    ) -> DepartureOutcome | None:
        """Advance; None while it goes on."""
        self._note_mode(vehicle.mode)
        if self._ends and self.stage is not Stage.STOP:
            if not self.motors_may_run:
                return DepartureOutcome(reason=self._ends)
            self._begin_to_stop(t_s)
        match self.stage:
            case Stage.READINESS | Stage.PERSON:
                return self._wait(vehicle, checks, t_s)
            case Stage.ARM:
                return self._arm(vehicle, t_s)
            case Stage.ARMED:
                return self._look_who_has_it(vehicle, t_s)
            case Stage.TAKE_OFF:
                return self._take_off(vehicle, t_s)
            case Stage.STOP:
                return self._stop(vehicle, checks, t_s)

    def _note_mode(self, mode: FlightMode) -> None:
        """A switch that stands on sticks from the start is how many aircraft are left standing."""
        if mode is FlightMode.UNKNOWN or mode is self._mode:
            return
        self._pilots = mode in _PILOTS and self._mode is not FlightMode.UNKNOWN
        self._mode = mode

    def _wait(
        self, vehicle: VehicleState, checks: tuple[Check, ...], t_s: float
    ) -> DepartureOutcome | None:
        """Until the list has been complete for a while, and somebody says go."""
        if vehicle.armed:
            return self._armed_by_somebody(vehicle, checks)
        if self._waits_for_mode:  # he stopped the motors: an Enter of meanwhile starts them not
            self._waits_for_mode = self._arms = False
            self.stage, self._ready_since_s = Stage.READINESS, None
        self._leave_mode(vehicle, t_s)
        listed = (*checks, _PILOT_HAS_IT) if self._pilots else checks
        trouble = missing(listed)
        if trouble != self._shown:
            self._shown = trouble
            self._show(listed)
        if trouble:
            self._tell_missing(trouble, t_s)
            self._ready_since_s, self.stage = None, Stage.READINESS
            return self._out_of_time(missing(checks), t_s)
        self._ready_since_s = t_s if self._ready_since_s is None else self._ready_since_s
        if t_s - self._ready_since_s < self._config.ready_steady_s:
            return None
        self._unready_since_s = self._tell_s = None
        if self._arms:
            self.stage, self._request = Stage.ARM, self._autopilot.arm()
        elif self.stage is Stage.READINESS:
            self.stage, self._invited = Stage.PERSON, True
            self._say(_HOW_TO_ARM)
        return None

    def _tell_missing(self, trouble: str, t_s: float) -> None:
        """Who stands at a ground station sees no list: what is in the way for long."""
        if self._tell_s is None:
            self._tell_s = t_s + _MISSING_FOR_S
        if t_s >= self._tell_s:
            self._tell_s = t_s + _MISSING_AGAIN_S
            self._say(f"not ready: {trouble}")

    def _leave_mode(self, vehicle: VehicleState, t_s: float) -> None:
        """Out of one in which nobody can arm it."""
        stuck = vehicle.mode in _NOBODY_ARMS_IN and not vehicle.armable
        if stuck and t_s - self._stood_by_s >= _STAND_BY_AGAIN_S:
            self._stood_by_s = t_s
            self._autopilot.stand_by()

    def _armed_by_somebody(
        self, vehicle: VehicleState, checks: tuple[Check, ...]
    ) -> DepartureOutcome | None:
        """A radio arms in modes of the sticks alone, in PX4 and in ArduCopter as it is set up."""
        invited = self._invited and not vehicle.in_air
        if invited and vehicle.mode is FlightMode.MANUAL and not missing(checks):
            if not self._waits_for_mode:
                self._waits_for_mode = True
                self._say("armed by the pilot: it takes off once Hold or GUIDED is chosen")
            return None
        told = self.stage is Stage.PERSON or self._waits_for_mode
        if invited and told and vehicle.mode in _LETS_US:
            self._say("armed by the pilot: taking off")
            self._begin_take_off()
            return None
        return DepartureOutcome(not_ours=True, reason=_NOT_OURS)

    def _out_of_time(self, trouble: str, t_s: float) -> DepartureOutcome | None:
        """After so long without being ready for good; a pilot may take his time."""
        if not trouble or self._unready_since_s is None:
            self._unready_since_s = t_s
        if t_s - self._unready_since_s <= self._config.ready_timeout_s:
            return None
        waited = f"not ready to fly after {self._config.ready_timeout_s:.0f} s: {trouble}"
        return DepartureOutcome(reason=waited, unsafe=True)

    def _arm(self, vehicle: VehicleState, t_s: float) -> DepartureOutcome | None:
        request = self._request
        assert request is not None
        if not request.done:
            return None
        if request.refused is None:
            self._armed_s, self.stage = t_s, Stage.ARMED
            return None
        self._refusals += 1
        reason = f"the autopilot refused to arm: {request.refused}"
        if self._refusals >= self._config.arming_tries:
            self.stop(reason)
        else:
            self._say(reason)
        if vehicle.armed or NO_ANSWER in request.refused:
            self._begin_to_stop(t_s)
            return None
        self.stage, self._ready_since_s = Stage.READINESS, None
        return DepartureOutcome(reason=self._ends) if self._ends else None

    def _look_who_has_it(self, vehicle: VehicleState, t_s: float) -> DepartureOutcome | None:
        """The heartbeat that shows the motors running shows a pilot's switch of that moment too."""
        assert self._armed_s is not None
        if self._pilots:
            return self._taken()
        if vehicle.armed:
            self._begin_take_off()
        elif t_s - self._armed_s > self._config.arming_shows_s:
            return self._disarmed()
        return None

    def _begin_take_off(self) -> None:
        self.stage = Stage.TAKE_OFF
        self._request = self._autopilot.takeoff(self._config.takeoff_height_m)

    def _take_off(self, vehicle: VehicleState, t_s: float) -> DepartureOutcome | None:
        """Never armed again: an aircraft that is disarmed now was disarmed by a person."""
        request = self._request
        assert request is not None
        told = self._armed_s is None or t_s - self._armed_s > self._config.arming_shows_s
        if not vehicle.armed and told:
            return self._disarmed()
        if self._pilots or (vehicle.mode is FlightMode.MANUAL and told):
            return self._taken()
        if not request.done:
            return None
        if request.refused is None:
            return DepartureOutcome(airborne=True)
        self.stop(f"the autopilot refused to take off: {request.refused}")
        self._begin_to_stop(t_s)
        return None

    def _begin_to_stop(self, t_s: float) -> None:
        self._autopilot.withdraw()
        self.stage, self._stops_s, self._runs_s = Stage.STOP, t_s, t_s

    def _stop(
        self, vehicle: VehicleState, checks: tuple[Check, ...], t_s: float
    ) -> DepartureOutcome | None:
        """Until the motors are told to stand, and nothing under way can start them any more.

        An answer that was lost is no refusal: they may start yet, and the aircraft fly.
        """
        if self._is_armed_as_told(vehicle, checks):
            self._say("armed, by the pilot or after all: taking off")
            self._begin_take_off()
            return None
        if self._pilots or (vehicle.mode in _PILOTS and self._armed_s is None and vehicle.armed):
            return self._taken()
        if vehicle.silence_s > GONE_S:
            why = self._ends or "it could not be armed"
            return DepartureOutcome(reason=f"{why}; the autopilot was not heard any more")
        if vehicle.armed and vehicle.in_air:
            return DepartureOutcome(airborne=True, reason=self._ends or "it took off unasked")
        if vehicle.armed:
            self._runs_s = t_s
            if t_s - self._asked_s >= _ASK_AGAIN_S:
                self._asked_s, self._request = t_s, self._autopilot.disarm()
        if t_s - self._runs_s <= self._config.arming_shows_s:
            return None
        self.stage, self._ready_since_s = Stage.READINESS, None
        if self._ends is None and self._invited and not self._has_stopped_motors:
            self._arms = False  # a person's word counts once
            return None
        return DepartureOutcome(reason=self._ends or _NOT_AGAIN)

    @property
    def _has_stopped_motors(self) -> bool:
        """They were seen to run, and told to stand."""
        return self._asked_s >= self._stops_s

    def _is_armed_as_told(self, vehicle: VehicleState, checks: tuple[Check, ...]) -> bool:
        """Beside an arming of ours without an answer: whoever did it, a person wants to fly."""
        may = self._invited and self._ends is None and not missing(checks)
        may = may and not self._has_stopped_motors
        return may and vehicle.armed and not vehicle.in_air and vehicle.mode in _LETS_US

    def _disarmed(self) -> DepartureOutcome:
        self._autopilot.withdraw()
        return DepartureOutcome(reason="the aircraft was disarmed before it took off")

    def _taken(self) -> DepartureOutcome:
        self._autopilot.withdraw()
        return DepartureOutcome(not_ours=True, reason="the pilot took over before take-off")
