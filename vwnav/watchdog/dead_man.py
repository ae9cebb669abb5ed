"""What to do when the navigator falls silent or ends in the air: a state machine without I/O.

An engaged flight without navigator -> zero velocity -> Hold -> Land, until it is down or somebody
else takes the aircraft. MAVSDK repeats setpoints by itself and PX4 returns to Offboard by itself
when setpoints come back, so falling silent too would not be enough: a mode must be commanded.
"""

import math
from dataclasses import dataclass, field
from enum import Enum

from vwnav.vehicle import FlightMode, Learned
from vwnav.watchdog.keepalive import Beat, GuardState


@dataclass(frozen=True, slots=True, kw_only=True)
class DeadManConfig:
    """Times of the sequence, in seconds; Land comes before an autopilot without vision is lost.

    Attributes:
        silence_s: silence of the control loop that counts as its death.
        brake_s: zero velocity before Hold is asked for.
        land_after_s: from the takeover to Land. PX4 gives up its position 4.6 s and ArduCopter
            8 s after the last estimate (measured), and lands blind from then on.
        setpoint_period_s: between zero-velocity setpoints; PX4 wants 2 Hz at least.
        command_period_s: between repetitions of a mode command that has no effect yet.
    """

    silence_s: float = 0.5
    brake_s: float = 1.0
    land_after_s: float = 3.5
    setpoint_period_s: float = 0.05
    command_period_s: float = 0.5


@dataclass(frozen=True, slots=True)
class VehicleView:
    """What the watchdog knows of the autopilot.

    Attributes:
        position_ok: its filter has a horizontal position; None when it never said.
        landed: it says that it stands on the ground, or that it does not; None where it does not
            say.
        mode_is_of_now: it was told since it was last silent. During a cut a person may have taken
            the aircraft, so nobody steers by an older one.
        fell_back: it says that nobody chose what it flies, a Hold or a mode of sticks that are not
            heard, and that one of ours is still the intended one. It would stay up in it.
        is_choice_untold: of such a mode it has not said yet who chose it.
        lands_blind: it comes down as the wind has it, though it has a position again.
    """

    mode: FlightMode = FlightMode.UNKNOWN
    armed: bool = False
    position_ok: bool | None = None
    landed: bool | None = None
    mode_is_of_now: bool = True
    fell_back: bool = False
    is_choice_untold: bool = False
    lands_blind: bool = False


class DeadManAction(Enum):
    """What is to be sent now."""

    ZERO_VELOCITY = "zero velocity"
    HOLD = "hold"
    LAND = "land"


_MODE_SHOWS_S = 3.0  # heartbeats come once a second, and one may get lost
_STEADIES_S, _STEADIES_AGAIN_S = 2.0, 6.0  # for so long at most, and so seldom, is Hold asked for
_COMES_DOWN = frozenset({FlightMode.LAND, FlightMode.DESCEND})
_STEERED = frozenset({FlightMode.OFFBOARD, FlightMode.TAKEOFF})
# Modes that the aircraft may be in while each state is ours; any other one means that the pilot
# or a failsafe of the autopilot has it, and the watchdog keeps out of the way.
_STILL_OURS = {
    GuardState.BRAKING: frozenset({FlightMode.OFFBOARD}),
    GuardState.HOLDING: _STEERED | {FlightMode.HOLD},
    GuardState.LANDING: _STEERED | {FlightMode.HOLD} | _COMES_DOWN,
}
# Once it was seen in Land: a Hold after that is a person's, or that of a vehicle that is down.
_STILL_LANDING = _COMES_DOWN | {FlightMode.OFFBOARD}


# What is asked for in a state, and the modes that are as good.
_WANTED = {
    GuardState.HOLDING: (DeadManAction.HOLD, frozenset({FlightMode.HOLD})),
    GuardState.LANDING: (DeadManAction.LAND, _COMES_DOWN),
}


@dataclass
class DeadMan:
    """Feed it beats, vehicle views and answers, and do what `step` says.

    What the navigator claimed in flight it cannot simply drop: an aircraft that does what it asked
    for last (Offboard, take-off, landing) stays claimed until it is in another mode or disarmed.
    """

    config: DeadManConfig = field(default_factory=DeadManConfig)
    state: GuardState = GuardState.RELAY
    vehicle: VehicleView = field(default_factory=VehicleView)
    _beat: Beat | None = None
    _beat_t_s: float = 0.0
    _listens_since_s: float = -math.inf
    _mode_at_beat: FlightMode = FlightMode.UNKNOWN
    _hold_asked_t_s: float = -math.inf
    _claimed: bool = False
    _ended: bool = False
    _land_seen: bool = False
    _flown: bool = False
    _down: bool = False
    _waits: bool = False
    _steadied_t_s: float = -math.inf
    _takeover_t_s: float = 0.0
    _setpoint_t_s: float = -math.inf
    _command_t_s: float = 0.0
    _accepted: bool = False

    @property
    def has_taken_over(self) -> bool:
        """The navigator's setpoints and its claims to Offboard are not to be handed on."""
        return self.state is not GuardState.RELAY or self._ended

    @property
    def navigator_ended(self) -> bool:
        """It is gone for good: nobody beats or claims any more."""
        return self._ended

    @property
    def is_handed_over(self) -> bool:
        """Somebody else has the aircraft, or nobody of us ever had it."""
        if self.state is GuardState.RELAY:
            return not self._claimed or self._is_someone_elses()
        return self.state is GuardState.STOOD_DOWN

    @property
    def last_beat(self) -> Beat | None:
        """The newest beat, None before the first."""
        return self._beat

    @property
    def learned(self) -> Learned | None:
        """What the navigator said last that one in its place may begin with."""
        return None if self._beat is None else self._beat.learned

    def silence_s(self, t_s: float) -> float:
        """Time since the newest beat, as far as anybody listened."""
        return t_s - max(self._beat_t_s, self._listens_since_s)

    def handle_beat(self, beat: Beat, t_s: float) -> None:
        """A sign of life; it ends a takeover only with a claim newer than the takeover."""
        if self._ended:
            return
        if beat.ended:
            self.handle_end()
            return
        claims_again = self._beat is not None and beat.epoch > self._beat.epoch and beat.engaged
        if self.has_taken_over and not claims_again:
            return
        self.state, self._land_seen = GuardState.RELAY, False
        self._flown = self._down = False
        self._beat, self._beat_t_s, self._mode_at_beat = beat, t_s, self.vehicle.mode
        still_listens = self.vehicle.armed and self._may_listen
        self._claimed = beat.engaged or (self._claimed and still_listens)

    def handle_end(self) -> None:
        """The navigator has ended, in whatever way."""
        self._ended = True

    def pass_on(self, t_s: float) -> None:
        """Another watchdog goes on from here, and has yet to hear the navigator."""
        self._listens_since_s = t_s

    def handle_mode_asked(self, mode: FlightMode, t_s: float) -> None:
        """The navigator asks for a mode: Hold will be its own, though not seen yet.

        What is wanted here too need not be asked for twice.
        """
        if mode is FlightMode.HOLD:
            self._hold_asked_t_s = t_s
        _, modes = _WANTED.get(self.state, (None, ()))
        if mode in modes:
            self._command_t_s = t_s

    def handle_vehicle(self, vehicle: VehicleView) -> None:
        """News of the autopilot."""
        self.vehicle = vehicle
        self._flown = self._flown or vehicle.landed is False

    def handle_answer(self, accepted: bool, t_s: float) -> None:
        """The autopilot's answer to the watchdog's own mode command."""
        self._accepted = accepted
        if not accepted and self.state is GuardState.HOLDING:
            self._enter(GuardState.LANDING, t_s)

    def words(self, before: GuardState, t_s: float) -> str:
        """What an operator reads of the state entered after `before`; up to 50 characters."""
        who = "vwnav ended" if self._ended else "vwnav is silent"
        match self.state:
            case GuardState.RELAY:
                return "vwnav is back, and flies again"
            case GuardState.BRAKING:
                return f"{who}: braking"
            case GuardState.HOLDING if before is GuardState.LANDING:
                return "drifts as it lands: holding, then landing again"
            case GuardState.HOLDING:
                return f"{who}: holding, then landing"
            case GuardState.LANDING if self._may_hold(t_s) and self.vehicle.mode is FlightMode.HOLD:
                return "holds its place: landing again"
            case GuardState.LANDING if self.vehicle.position_ok is False:
                return f"{who}, place not known: landing"
            case GuardState.LANDING:
                return f"{who}: landing"
            case GuardState.STOOD_DOWN:
                return f"{who}: another mode flies"

    def step(self, t_s: float) -> DeadManAction | None:
        """What to send now; call it at 20 Hz or more."""
        if self.state is GuardState.RELAY:
            self._watch(t_s)
        self._follow_mode(t_s)
        acting_s = t_s - self._takeover_t_s
        if self.state is GuardState.BRAKING and acting_s >= self.config.brake_s:
            self._enter(self._after_braking(), t_s)
        is_long = acting_s >= self.config.land_after_s and not self._steadies(t_s)
        if self.state is GuardState.HOLDING and (is_long or self.vehicle.position_ok is False):
            self._enter(GuardState.LANDING, t_s)
        blind = self.vehicle.lands_blind and not (self._down or self.vehicle.landed)
        if self.state is GuardState.LANDING and blind and not self._may_hold(t_s):
            self._steadied_t_s, self._land_seen = t_s, False
            self._enter(GuardState.HOLDING, t_s)
        wants_nothing = self._waits or self._down or self.vehicle.landed or not self.vehicle.armed
        if wants_nothing or not self.vehicle.mode_is_of_now:
            return None
        return self._action(t_s)

    def _watch(self, t_s: float) -> None:
        """Take over from a navigator that is silent or gone."""
        is_alive = not self._ended and self.silence_s(t_s) <= self.config.silence_s
        if is_alive or not self._claimed or not self.vehicle.armed:
            return
        if self.vehicle.is_choice_untold and not self._left_alone_in_hold():
            return
        self._takeover_t_s = t_s
        if self.vehicle.mode is FlightMode.OFFBOARD or self.vehicle.fell_back:
            self._enter(GuardState.BRAKING, t_s)
        elif self.vehicle.mode in _COMES_DOWN:
            self._enter(GuardState.LANDING, t_s)
        elif self._left_alone_in_hold():
            self._enter(self._after_braking(), t_s)
        else:
            self._enter(GuardState.STOOD_DOWN, t_s)

    def _follow_mode(self, t_s: float) -> None:
        """Stand down for whoever changed the mode; notice when it comes down, and is down.

        Commands wait for the word on who did; what it fell back to is still ours to end.
        """
        self._waits = False
        if self.state not in _STILL_OURS:
            return
        comes_down = self.vehicle.mode in _COMES_DOWN and not self._steadies(t_s)
        if self.state is not GuardState.LANDING and comes_down:
            self._enter(GuardState.LANDING, t_s)  # a failsafe may still end and leave it to us
        ours = _STILL_LANDING if self._land_seen else _STILL_OURS[self.state]
        if self._steadies(t_s):
            ours = ours | _COMES_DOWN  # which it leaves in a moment
        if self.vehicle.mode not in ours and not self.vehicle.fell_back:
            self._waits = self.vehicle.is_choice_untold
            self.state = self.state if self._waits else GuardState.STOOD_DOWN
        elif self.state is GuardState.LANDING:
            lands = self.vehicle.mode is FlightMode.LAND and not self._may_hold(t_s)
            self._land_seen = self._land_seen or lands
            self._down = self._down or self._has_come_down()

    def _has_come_down(self) -> bool:
        """It stands; one that has only been asked to take off may still do so, by itself."""
        may_lift_off = not self._flown and self.vehicle.mode not in _COMES_DOWN
        return self.vehicle.landed is True and not may_lift_off

    def _is_someone_elses(self) -> bool:
        return not self._may_listen and not self._left_alone_in_hold()

    @property
    def _may_listen(self) -> bool:
        """It does what it was asked for last, or would but for a failsafe that stays up."""
        told = self.vehicle.fell_back or self.vehicle.is_choice_untold
        return told or self.vehicle.mode in _STEERED | _COMES_DOWN

    def _may_hold(self, t_s: float) -> bool:
        """A Hold is the one that was asked for, though it is told late; none is asked for again."""
        return t_s - self._steadied_t_s < _STEADIES_AGAIN_S

    def _steadies(self, t_s: float) -> bool:
        """What landed blind has been asked to hold its place, and does not yet."""
        waits = t_s - self._steadied_t_s < _STEADIES_S
        return self.state is GuardState.HOLDING and waits and self.vehicle.mode in _COMES_DOWN

    def _left_alone_in_hold(self) -> bool:
        """A take-off, or a Hold that the navigator knew of: nobody would ever end it."""
        if self.vehicle.mode is FlightMode.TAKEOFF:
            return True
        knew = self._mode_at_beat in (FlightMode.TAKEOFF, FlightMode.HOLD)
        knew = knew or self._beat_t_s - self._hold_asked_t_s <= _MODE_SHOWS_S
        return self.vehicle.mode is FlightMode.HOLD and knew

    def _after_braking(self) -> GuardState:
        lost = self.vehicle.position_ok is False
        return GuardState.LANDING if lost else GuardState.HOLDING

    def _enter(self, state: GuardState, t_s: float) -> None:
        self.state, self._accepted = state, False
        self._command_t_s = t_s - self.config.command_period_s

    def _action(self, t_s: float) -> DeadManAction | None:
        wanted = _WANTED.get(self.state)
        if wanted is not None:
            action, modes = wanted
            done = self.vehicle.mode in modes
            if not done and t_s - self._command_t_s >= self.config.command_period_s:
                self._command_t_s = t_s
                return action
            if done or self._accepted:
                return None
        elif self.state is not GuardState.BRAKING:
            return None
        if t_s - self._setpoint_t_s < self.config.setpoint_period_s:
            return None
        if self.vehicle.mode is not FlightMode.OFFBOARD:
            return None
        self._setpoint_t_s = t_s
        return DeadManAction.ZERO_VELOCITY
