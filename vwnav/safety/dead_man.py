"""What to do when the navigator falls silent in the air: a state machine without I/O.

Silence in an engaged flight -> zero velocity -> Hold -> Land, until somebody else takes the
aircraft. MAVSDK repeats setpoints by itself and PX4 returns to Offboard by itself when setpoints
come back, so falling silent too would not be enough: a mode must be commanded.
"""

from dataclasses import dataclass, field
from enum import Enum

from vwnav.safety.keepalive import Beat, GuardState
from vwnav.types import FlightMode


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
    """

    mode: FlightMode = FlightMode.UNKNOWN
    armed: bool = False
    position_ok: bool | None = None


class Action(Enum):
    """What is to be sent now."""

    ZERO_VELOCITY = "zero velocity"
    HOLD = "hold"
    LAND = "land"


# Modes that the aircraft may be in while each state is ours; any other one means that the pilot
# or a failsafe of the autopilot has it, and the watchdog keeps out of the way.
_STILL_OURS = {
    GuardState.BRAKING: {FlightMode.OFFBOARD},
    GuardState.HOLDING: {FlightMode.OFFBOARD, FlightMode.TAKEOFF, FlightMode.HOLD},
    GuardState.LANDING: {
        FlightMode.OFFBOARD,
        FlightMode.TAKEOFF,
        FlightMode.HOLD,
        FlightMode.LAND,
        FlightMode.DESCEND,
    },
}
_COMES_DOWN = (FlightMode.LAND, FlightMode.DESCEND)


@dataclass
class DeadMan:
    """Feed it beats, vehicle views and answers, and do what `step` says."""

    config: DeadManConfig = field(default_factory=DeadManConfig)
    state: GuardState = GuardState.RELAY
    vehicle: VehicleView = field(default_factory=VehicleView)
    _beat: Beat | None = None
    _beat_t_s: float = 0.0
    _mode_at_beat: FlightMode = FlightMode.UNKNOWN
    _takeover_t_s: float = 0.0
    _setpoint_t_s: float = 0.0
    _command_t_s: float = 0.0
    _accepted: bool = False

    @property
    def blocks_setpoints(self) -> bool:
        """The navigator's setpoints and its claims to Offboard are not to be handed on."""
        return self.state is not GuardState.RELAY

    @property
    def last_beat(self) -> Beat | None:
        """The newest beat, None before the first."""
        return self._beat

    def silence_s(self, t_s: float) -> float:
        """Time since the newest beat."""
        return t_s - self._beat_t_s

    def handle_beat(self, beat: Beat, t_s: float) -> None:
        """A sign of life; it ends a takeover only with a claim newer than the takeover."""
        claims_again = self._beat is not None and beat.epoch > self._beat.epoch and beat.engaged
        if self.blocks_setpoints and not claims_again:
            return
        self.state = GuardState.RELAY
        self._beat, self._beat_t_s, self._mode_at_beat = beat, t_s, self.vehicle.mode

    def handle_vehicle(self, vehicle: VehicleView) -> None:
        """News of the autopilot."""
        self.vehicle = vehicle

    def handle_answer(self, accepted: bool, t_s: float) -> None:
        """The autopilot's answer to the watchdog's own mode command."""
        self._accepted = accepted
        if not accepted and self.state is GuardState.HOLDING:
            self._enter(GuardState.LANDING, t_s)

    def step(self, t_s: float) -> Action | None:
        """What to send now; call it at 20 Hz or more."""
        if self.state is GuardState.RELAY:
            self._watch(t_s)
        if self.state in _STILL_OURS and self.vehicle.mode not in _STILL_OURS[self.state]:
            self.state = GuardState.STOOD_DOWN
        if self.state is GuardState.BRAKING and t_s - self._takeover_t_s >= self.config.brake_s:
            self._enter(self._after_braking(), t_s)
        if (
            self.state is GuardState.HOLDING
            and t_s - self._takeover_t_s >= self.config.land_after_s
        ):
            self._enter(GuardState.LANDING, t_s)
        return self._action(t_s)

    def _watch(self, t_s: float) -> None:
        if self._beat is None or not self._beat.engaged or not self.vehicle.armed:
            return
        if self.silence_s(t_s) <= self.config.silence_s:
            return
        self._takeover_t_s = t_s
        if self.vehicle.mode is FlightMode.OFFBOARD:
            self._enter(GuardState.BRAKING, t_s)
        elif self._left_alone_in_hold():
            self._enter(self._after_braking(), t_s)

    def _left_alone_in_hold(self) -> bool:
        """A take-off, or a Hold that the navigator knew of: nobody would ever end it."""
        if self.vehicle.mode is FlightMode.TAKEOFF:
            return True
        knew = self._mode_at_beat in (FlightMode.TAKEOFF, FlightMode.HOLD)
        return self.vehicle.mode is FlightMode.HOLD and knew

    def _after_braking(self) -> GuardState:
        lost = self.vehicle.position_ok is False
        return GuardState.LANDING if lost else GuardState.HOLDING

    def _enter(self, state: GuardState, t_s: float) -> None:
        self.state, self._accepted = state, False
        self._command_t_s = t_s - self.config.command_period_s

    def _action(self, t_s: float) -> Action | None:
        wanted = {
            GuardState.HOLDING: (Action.HOLD, (FlightMode.HOLD,)),
            GuardState.LANDING: (Action.LAND, _COMES_DOWN),
        }.get(self.state)
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
        return Action.ZERO_VELOCITY
