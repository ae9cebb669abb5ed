"""From standing on the ground to the autopilot's own take-off: readiness, a person's word, arming.

Arming and take-off are asked for only of a disarmed aircraft on the ground whose readiness list is
complete. An aircraft that is armed without our asking is somebody else's.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from vwnav.mission.config import DepartureConfig
from vwnav.safety.check import Check
from vwnav.safety.readiness import missing
from vwnav.vehicle import Autopilot, FlightMode, Request, VehicleState

_PILOT_HAS_IT = Check(
    "pilot", "FAIL", "chose a mode flown with sticks: choose Hold (GUIDED on ArduCopter) to go on"
)


class Stage(Enum):
    """How far the departure has got."""

    READINESS = "getting ready"
    PERSON = "waiting for a person"
    ARM = "arming"
    ARMED = "waiting for the autopilot to show that it is armed"
    TAKE_OFF = "asking for take-off"


@dataclass(frozen=True, slots=True)
class DepartureOutcome:
    """How the departure ended.

    Attributes:
        airborne: the autopilot takes off for us.
        not_ours: somebody else armed the aircraft and has it.
        reason: why it ended otherwise; `unsafe` when the readiness list never was complete.
    """

    airborne: bool = False
    not_ours: bool = False
    reason: str | None = None
    unsafe: bool = False


class Departure:
    """One departure; `step` it until it has an outcome.

    Args:
        arms: whether it arms by itself; else the pilot's arming by radio (in Hold, Offboard or
            GUIDED: a pilot who arms in a mode flown with sticks wants to fly) or `go` starts it.
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
        self._say = say
        self._show = show
        self._began_s: float | None = None
        self._ready_since_s: float | None = None
        self._shown: str | None = None
        self._request: Request | None = None
        self._armed_s: float | None = None  # our arming was accepted
        self._refusals = 0
        self._mode = FlightMode.UNKNOWN
        self._pilots = False  # a mode flown with sticks was chosen since it began
        self.stage = Stage.READINESS

    @property
    def has_armed(self) -> bool:
        """The motors run because this departure started them."""
        return self._armed_s is not None

    def go(self) -> None:
        """A person at the keyboard lets it arm; before it has asked for that word it is none."""
        self._arms = self._arms or self.stage is Stage.PERSON

    def step(
        self, vehicle: VehicleState, checks: tuple[Check, ...], t_s: float
    ) -> DepartureOutcome | None:
        """Advance; None while it goes on."""
        self._began_s = t_s if self._began_s is None else self._began_s
        self._note_mode(vehicle.mode)
        match self.stage:
            case Stage.READINESS | Stage.PERSON:
                if self._pilots:
                    checks += (_PILOT_HAS_IT,)
                return self._wait(vehicle, checks, t_s)
            case Stage.ARM:
                return self._arm(vehicle, t_s)
            case Stage.ARMED:
                return self._look_who_has_it(vehicle, t_s)
            case Stage.TAKE_OFF:
                return self._take_off(vehicle, t_s)

    def _note_mode(self, mode: FlightMode) -> None:
        """A switch that stands on sticks from the start is how many aircraft are left standing."""
        if mode is FlightMode.UNKNOWN or mode is self._mode:
            return
        self._pilots = mode is FlightMode.MANUAL and self._mode is not FlightMode.UNKNOWN
        self._mode = mode

    def _wait(
        self, vehicle: VehicleState, checks: tuple[Check, ...], t_s: float
    ) -> DepartureOutcome | None:
        """Until the list has been complete for a while, and somebody says go."""
        if vehicle.armed:
            return self._armed_by_somebody(vehicle)
        trouble = missing(checks)
        if trouble != self._shown:
            self._shown = trouble
            self._show(checks)
        if trouble:
            self._ready_since_s, self.stage = None, Stage.READINESS
            return self._out_of_time(trouble, t_s)
        self._ready_since_s = t_s if self._ready_since_s is None else self._ready_since_s
        if t_s - self._ready_since_s < self._config.ready_steady_s:
            return None
        if self._arms:
            self.stage, self._request = Stage.ARM, self._autopilot.arm()
        elif self.stage is Stage.READINESS:
            self.stage = Stage.PERSON
            self._say(
                "ready: arm by the radio (in Hold on PX4, in GUIDED on ArduCopter), or press Enter"
            )
        return None

    def _armed_by_somebody(self, vehicle: VehicleState) -> DepartureOutcome | None:
        invited = self.stage is Stage.PERSON and not vehicle.in_air
        if invited and vehicle.mode in (FlightMode.HOLD, FlightMode.OFFBOARD):
            self._say("armed by the pilot: taking off")
            self._begin_take_off()
            return None
        return DepartureOutcome(
            not_ours=True,
            reason="the aircraft is armed, and not by vwnav: somebody else flies it; vwnav only "
            "sends estimates until it is disarmed",
        )

    def _out_of_time(self, trouble: str, t_s: float) -> DepartureOutcome | None:
        assert self._began_s is not None
        if t_s - self._began_s <= self._config.ready_timeout_s:
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
        if vehicle.armed:
            self._autopilot.disarm()
        if self._refusals >= self._config.arming_tries:
            return DepartureOutcome(reason=reason)
        self._say(reason)
        self.stage, self._ready_since_s = Stage.READINESS, None
        return None

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
        if not vehicle.in_air:
            self._autopilot.disarm()
        return DepartureOutcome(reason=f"the autopilot refused to take off: {request.refused}")

    def _disarmed(self) -> DepartureOutcome:
        self._autopilot.withdraw()
        return DepartureOutcome(reason="the aircraft was disarmed before it took off")

    def _taken(self) -> DepartureOutcome:
        self._autopilot.withdraw()
        return DepartureOutcome(not_ours=True, reason="the pilot took over before take-off")
