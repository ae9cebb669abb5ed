"""What is asked of an autopilot, step by step: some requests are several commands with waits."""

import math
from collections.abc import Callable, Generator

from vwnav.mavlink.commands import CommandSender, Procedure
from vwnav.mavlink.modes import AutopilotKind, Command, mode_command
from vwnav.mavlink.parameters import ParameterTable
from vwnav.mavlink.preflight_parameters import TAKEOFF_HEIGHT
from vwnav.mavlink.telemetry.telemetry_state import TelemetryState
from vwnav.vehicle import FlightMode, VehicleState, VelocitySetpoint

NOT_HEARD = "the autopilot is not heard"
_CMD_NAV_TAKEOFF, _CMD_ARM = 22, 400
_TEXT_WAIT_S = 0.1  # the reason comes as a text, after the answer
_TEXT_AGE_S = 3.0
_GUIDED_WAIT_S = 1.5
_STREAM_START_S = 0.25
_STREAM_PERIOD_S = 0.06  # just longer than the control loop's own
_TAKEOFF_SHOWS_S = 3.0  # from the answer to the mode in a heartbeat
_PUT_BACK_AGAIN_S = 1.0
_PUT_BACK_TRIES = 3
_END_BY_THEMSELVES = (FlightMode.TAKEOFF, FlightMode.MISSION, FlightMode.RETURN)  # in Hold


class Procedures:
    """Makes the procedures that requests consist of; `commands` says what one is.

    Args:
        send_setpoint: sends one.
        clock: monotonic clock, in seconds.
    """

    def __init__(
        self,
        commands: CommandSender,
        parameters: ParameterTable,
        telemetry: TelemetryState,
        send_setpoint: Callable[[VelocitySetpoint], None],
        clock: Callable[[], float],
    ) -> None:
        self._commands = commands
        self._parameters = parameters
        self._telemetry = telemetry
        self._send_setpoint = send_setpoint
        self._clock = clock
        self._steered = VelocitySetpoint(0.0, 0.0, 0.0)
        self._steered_s = self._streamed_s = -math.inf
        self._owners_height_m: float | None = None
        self._putting_back: Generator[None, None, None] | None = None

    def steered(self, setpoint: VelocitySetpoint, t_s: float) -> None:
        """Whoever steers has sent a setpoint."""
        self._steered, self._steered_s = setpoint, t_s

    def step(self) -> None:
        """Carry on what has to be done whatever is asked for next."""
        if self._putting_back is not None and next(self._putting_back, True):
            self._putting_back = None

    def close(self) -> None:
        """The last chance to put the owner's parameter back: there is no time for an answer."""
        if self._owners_height_m is not None:
            for _ in range(_PUT_BACK_TRIES):
                self._parameters.tell(TAKEOFF_HEIGHT, self._owners_height_m)

    def arm(self) -> Procedure:
        """Arm; on ArduCopter in GUIDED."""
        state = self._state()
        if not state.connected:
            return NOT_HEARD
        if not state.armable:
            return self._in_words("not ready to arm")
        if self._kind is AutopilotKind.ARDUPILOT:
            refused = yield from self.set_mode(FlightMode.OFFBOARD)
            if refused:
                return refused
            yield from self._until(
                lambda: self._state().mode is FlightMode.OFFBOARD, _GUIDED_WAIT_S
            )
        return (yield from self._command(Command(_CMD_ARM, (1.0,)), lambda: self._state().armed))

    def stand_by(self) -> Procedure:
        """On the ground: PX4 into Hold, from where it can be armed.

        It is in Offboard again once it is down, and stays in Land or Return chosen on the ground.
        """
        if self._kind is AutopilotKind.ARDUPILOT or self._state().armed:
            return None
        return (yield from self.set_mode(FlightMode.HOLD))

    def disarm(self) -> Procedure:
        """Stop the motors."""
        disarm = Command(_CMD_ARM, (0.0,))
        was_armed = self._state().armed
        return (yield from self._command(disarm, lambda: was_armed and not self._state().armed))

    def takeoff(self, height_m: float) -> Procedure:
        """Climb to `height_m` above the ground."""
        if self._kind is AutopilotKind.ARDUPILOT:
            return (yield from self._command(Command(_CMD_NAV_TAKEOFF, (0.0,) * 6 + (height_m,))))
        refused = yield from self._borrow_takeoff_height(height_m)
        if refused is None:
            self._putting_back = self._put_back_after_takeoff()
            # NaN altitude: the one of MIS_TAKEOFF_ALT. A number would be above mean sea level.
            takeoff = Command(_CMD_NAV_TAKEOFF, (None,) * 7)
            refused = yield from self._command(
                takeoff, lambda: self._state().mode is FlightMode.TAKEOFF
            )
        if refused is None:
            self._telemetry.modes.expect(FlightMode.TAKEOFF, self._clock())
        else:
            self._putting_back = self._put_back()
        return refused

    def start_offboard(self) -> Procedure:
        """PX4 enters Offboard only on a stream that already runs, whose age it counts slowly."""
        before, refused = self._state(), None
        for _ in range(2):
            yield from self._streaming(self._until(lambda: False, _STREAM_START_S))
            refused = self._chosen_by_another(before, FlightMode.OFFBOARD)
            if refused is not None:
                return refused
            refused = yield from self._streaming(self.set_mode(FlightMode.OFFBOARD))
            if refused is None:
                return None
        return refused

    def set_mode(self, mode: FlightMode) -> Procedure:
        """Ask for a mode."""
        before = self._state()
        refused = yield from self._command(
            mode_command(self._kind, mode),
            lambda: self._state().mode is mode is not before.mode,
            lambda: self._chosen_by_another(before, mode),
        )
        if refused is None:
            self._telemetry.modes.expect(mode, self._clock())
        return refused

    @property
    def _kind(self) -> AutopilotKind:
        assert self._telemetry.kind is not None  # nothing is asked of one that is not known
        return self._telemetry.kind

    def _state(self) -> VehicleState:
        return self._telemetry.state(self._clock())

    def _command(
        self,
        command: Command,
        seen: Callable[[], bool] = lambda: False,
        overtaken: Callable[[], str | None] = lambda: None,
    ) -> Procedure:
        """One command, given up when the aircraft is disarmed meanwhile."""
        armed = self._state().armed

        def why_not_again() -> str | None:
            nonlocal armed
            if armed and not self._state().armed:
                return "it was disarmed meanwhile"
            armed = self._state().armed
            return overtaken()

        refused = yield from self._commands.command(command, seen, why_not_again)
        if refused is None:
            return None
        yield from self._until(lambda: False, _TEXT_WAIT_S)
        return self._in_words(refused)

    def _chosen_by_another(self, before: VehicleState, wanted: FlightMode) -> str | None:
        state = self._state()
        came_by_itself = state.mode is FlightMode.HOLD and before.mode in _END_BY_THEMSELVES
        asked = (before.mode, before.intended_mode, wanted)
        fell_back = state.is_fallback and state.intended_mode in asked
        # To which it had fallen back, and which a person has chosen since.
        chosen = before.is_fallback and state.mode is before.mode is state.intended_mode
        chosen = chosen or (state.has_sticks and not before.has_sticks)
        if chosen or not (
            state.mode in (before.mode, wanted, FlightMode.UNKNOWN) or fell_back or came_by_itself
        ):
            return f"somebody else chose the mode {state.mode.value}"
        return None

    def _until(self, condition: Callable[[], bool], wait_s: float) -> Procedure:
        since_s = self._clock()
        while not condition() and self._clock() - since_s < wait_s:
            yield
        return None

    def _streaming(self, procedure: Procedure) -> Procedure:
        """Carry it on under a stream of setpoints: the newest, or zero when nobody steers."""
        while True:
            now_s = self._clock()
            if now_s - max(self._steered_s, self._streamed_s) >= _STREAM_PERIOD_S:
                steers = now_s - self._steered_s <= _STREAM_START_S
                self._send_setpoint(self._steered if steers else VelocitySetpoint(0.0, 0.0, 0.0))
                self._streamed_s = now_s
            try:
                next(procedure)
            except StopIteration as end:
                return end.value  # type: ignore[no-any-return]
            yield

    def _borrow_takeoff_height(self, height_m: float) -> Procedure:
        """PX4 climbs to a height that is a parameter of its owner's: it is put back afterwards."""
        yield from self._parameters.read((TAKEOFF_HEIGHT,))
        present_m = self._parameters.values.get(TAKEOFF_HEIGHT)
        if present_m is None:
            return f"the take-off height ({TAKEOFF_HEIGHT}) is not told"
        if math.isclose(present_m, height_m, rel_tol=1e-4):
            return None
        if self._owners_height_m is None:
            self._owners_height_m = present_m
        self._putting_back = None
        if not (yield from self._parameters.write(TAKEOFF_HEIGHT, height_m)):
            return f"the take-off height ({TAKEOFF_HEIGHT}) could not be set"
        return None

    def _put_back_after_takeoff(self) -> Generator[None, None, None]:
        """Once the take-off has ended, or has not begun: before, PX4 may yet read it."""
        yield from self._until(self._takes_off, _TAKEOFF_SHOWS_S)
        yield from self._until(lambda: not self._takes_off(), math.inf)
        yield from self._put_back()

    def _takes_off(self) -> bool:
        state = self._state()
        return state.armed and state.mode is FlightMode.TAKEOFF

    def _put_back(self) -> Generator[None, None, None]:
        while self._owners_height_m is not None:
            if (yield from self._parameters.write(TAKEOFF_HEIGHT, self._owners_height_m)):
                self._owners_height_m = None
            else:
                yield from self._until(lambda: False, _PUT_BACK_AGAIN_S)

    def _in_words(self, reason: str) -> str:
        texts = self._telemetry.texts.warnings_since(self._clock() - _TEXT_AGE_S)
        return f"{reason} ({'; '.join(texts[-3:])})" if texts else reason
