"""Which mode the autopilot flies, and who chose it: a person, we, or a failsafe of its own."""

import math
from dataclasses import dataclass

from vwnav.mavlink.modes import AutopilotKind, flight_mode
from vwnav.mavlink.ports.port import Fields
from vwnav.vehicle import FlightMode

_CRITICAL = 5  # MAV_STATE: ArduPilot flies a failsafe
_CUT_S = 1.5  # silence after which a mode that is told anew may have been chosen anew
_STALE_S = 4.5  # while modes are told without it: PX4 says it every 2 s at least
_UNDECIDED_S = 2.5  # so long PX4 may take to say who asked for a new mode: it does every 2 s
_SETTLES_S = 0.3  # after a command was accepted, older modes may still be on their way
_CLEARS_S = 1.5  # ArduCopter's EKF failsafe is over 1 s after the position is back


@dataclass(frozen=True, slots=True)
class _Intent:
    """PX4's CURRENT_MODE: what it flies, and what it was asked for."""

    t_s: float
    flown: FlightMode
    asked: FlightMode


@dataclass(frozen=True, slots=True)
class _Commanded:
    """A mode that the autopilot has accepted, while it flew the one `before`."""

    t_s: float
    mode: FlightMode
    before: FlightMode


class ModeTrack:
    """Feed it HEARTBEAT, CURRENT_MODE and the state of the estimator of one autopilot."""

    def __init__(self) -> None:
        self._told = FlightMode.UNKNOWN
        self._told_s = self._changed_s = -math.inf
        self._intent: _Intent | None = None
        self._commanded: _Commanded | None = None
        self._critical = self._is_ardupilot = self._is_blind = False
        self._position_s = -math.inf  # since when it has had a position; inf: it has none

    def handle_heartbeat(self, kind: AutopilotKind, fields: Fields, received_s: float) -> None:
        """Take a HEARTBEAT in."""
        self._is_ardupilot = kind is AutopilotKind.ARDUPILOT
        self._critical = self._is_ardupilot and fields["system_status"] >= _CRITICAL
        self._tell(flight_mode(kind, fields["custom_mode"]), received_s)

    def handle_current_mode(self, kind: AutopilotKind, fields: Fields, received_s: float) -> None:
        """Take a CURRENT_MODE in."""
        self._tell(flight_mode(kind, fields["custom_mode"]), received_s)
        asked = fields["intended_custom_mode"]  # 0: not known
        if asked:
            self._intent = _Intent(received_s, self._told, flight_mode(kind, asked))

    def handle_position(self, is_known: bool, received_s: float) -> None:
        """Take in whether its own filter has a horizontal position."""
        self._position_s = min(self._position_s, received_s) if is_known else math.inf
        self._see_landing()

    def lands_blind(self, t_s: float) -> bool:
        """Whether it comes down as the wind has it, though it has a position again.

        ArduCopter that has none when LAND begins, or loses it in LAND, lands level, and goes on so
        until another mode is asked for (`ModeLand::nogps_run`, `do_not_use_GPS`).
        """
        return self._is_blind and t_s - self._position_s >= _CLEARS_S

    def expect(self, mode: FlightMode, t_s: float) -> None:
        """The autopilot has accepted `mode`, though heartbeats may show the old one once more."""
        self._commanded = _Commanded(t_s, mode, self._told)

    @property
    def told_s(self) -> float:
        """When a mode was told last, by either message."""
        return self._told_s

    @property
    def tells_intent(self) -> bool:
        """PX4 has told what was asked for: it does from 1.15 on."""
        return self._intent is not None

    @property
    def mode(self) -> FlightMode:
        """The one told last, but for one that was sent before the command just accepted.

        Heartbeats come once a second, later from a busy machine or after a cut: the old mode is
        believed again only when it was told anew.
        """
        return self._told if self._commanded is None else self._commanded.mode

    def intended(self, t_s: float) -> FlightMode:
        """Which was asked for; PX4 says it a moment after the mode itself has changed.

        UNKNOWN in that moment, and the flown mode where nothing is told of it, or no more: a person
        who chooses the mode that is flown anyhow changes nothing else.
        """
        mode, intent = self.mode, self._intent
        if intent is None or mode is not self._told:
            return mode
        is_stale = self._told_s - intent.t_s > _STALE_S
        if intent.flown is mode and intent.t_s >= self._changed_s and not is_stale:
            return intent.asked
        return FlightMode.UNKNOWN if t_s - self._changed_s < _UNDECIDED_S else mode

    def is_failsafe(self, t_s: float) -> bool:
        """Whether the autopilot itself has chosen what it flies."""
        return self._critical or self.intended(t_s) not in (self.mode, FlightMode.UNKNOWN)

    def _tell(self, mode: FlightMode, received_s: float) -> None:
        if mode is not self._told or received_s - self._told_s > _CUT_S:
            self._changed_s = received_s
        self._told, self._told_s = mode, received_s
        self._see_landing()
        commanded = self._commanded
        if commanded is not None and (
            mode is not commanded.before or received_s > commanded.t_s + _SETTLES_S
        ):
            self._commanded = None

    def _see_landing(self) -> None:
        has_none = self._position_s == math.inf
        lands = self._is_ardupilot and self._told is FlightMode.LAND
        self._is_blind = lands and (self._is_blind or has_none)
