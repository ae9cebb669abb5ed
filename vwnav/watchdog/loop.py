"""The watchdog between navigator and autopilot: relays, guards, and acts by `DeadMan`.

`Watchdog.step` handles all that has arrived and never waits: `watchdog.process` calls it whenever
something arrives, a simulation whenever its time advances.
"""

import logging
import math
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from vwnav.mavlink.framing import Framer, Packet
from vwnav.mavlink.links import Link
from vwnav.watchdog.dead_man import DeadMan
from vwnav.watchdog.filter import ESTIMATES, Rights, decode, may_pass, mode_asked, told_by
from vwnav.watchdog.keepalive import Beat, Channel, GuardState, WatchdogReport
from vwnav.watchdog.outbox import Outbox
from vwnav.watchdog.relay_guard import RelayedPosition, RelayedVelocity, RelayGuard
from vwnav.watchdog.successor import NavigatorProcess, Resume, Successor, UselessNavigator
from vwnav.watchdog.visitors import Guarding
from vwnav.watchdog.voice import CUT_S, AutopilotEar, Voice

_log = logging.getLogger(__name__)
_READS_IN_A_ROW = 32
_RELAYED_BYTES = 1024  # of a datagram MAVSDK takes 2048 bytes, and loses the rest
_CALL_PERIOD_S = 1.0
_LAST_WORD_S = 3.0  # without a heartbeat after the navigator's end: what was heard last holds
_SWITCHED_OFF_S = 60.0  # an autopilot that silent while nobody navigates
_ENDED_TEXT = "vwnav hangs: ended, a second one gives estimates"


@dataclass(frozen=True, slots=True, kw_only=True)
class WatchdogConfig:
    """How it watches.

    Attributes:
        calls_first: the autopilot waits to be spoken to.
        limit_s: longest time it goes on without the navigator.
        process: its own, for the navigator.
    """

    calls_first: bool = False
    limit_s: float = 900.0
    process: int = 0


@dataclass(frozen=True, slots=True)
class WatchdogLinks:
    """The ways in and out: autopilot, navigator, who listens along, and the beats."""

    autopilot: Link
    navigator: Link
    observer: Link
    beats: Channel


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """All that a watchdog goes by: a spare one in its place goes on from it."""

    ear: AutopilotEar = field(default_factory=AutopilotEar)
    guard: DeadMan = field(default_factory=DeadMan)
    estimates: RelayGuard = field(default_factory=RelayGuard)
    useless: UselessNavigator = field(default_factory=UselessNavigator)
    ended_t_s: float = -math.inf

    def pass_on(self, t_s: float) -> "Known":
        """To the one that begins now: while nobody listened, silence was nobody's but our own."""
        self.ear.pass_on()
        self.guard.pass_on(t_s)
        return self


class Watchdog:
    """One owner of leaving the aircraft: it stays until that is down or in other hands.

    Attributes:
        finished: it is, and nothing is left to do.
        has_spare: another one waits to take its place; the navigator is told.

    Args:
        successor: takes the navigator's place for estimates alone.
        navigator: ended when it hangs in flight and a successor stands by; it has the camera, and
            would tell on waking what it believed before.
        known: by the one in whose place this one is, passed on.
    """

    def __init__(
        self,
        links: WatchdogLinks,
        config: WatchdogConfig,
        successor: Successor | None = None,
        navigator: NavigatorProcess | None = None,
        known: Known | None = None,
    ) -> None:
        self._links, self._config = links, config
        self._successor, self._navigator = successor, navigator
        known = Known() if known is None else known
        self._ear, self._guard, self._estimates = known.ear, known.guard, known.estimates
        self._useless, self._ended_t_s = known.useless, known.ended_t_s
        self._from_navigator, self._from_observer = Framer(), Framer()
        self._voice, self._outbox = Voice(), Outbox()
        self._call_t_s = self._origin_t_s = -math.inf
        self.has_spare = True
        self.finished = False

    @property
    def state(self) -> GuardState:
        """What it does."""
        return self._guard.state

    @property
    def known(self) -> Known:
        """What it goes by at present; it goes on changing, so copy it."""
        guards = self._guard, self._estimates, self._useless
        return Known(self._ear, *guards, self._ended_t_s)

    @property
    def is_acting(self) -> bool:
        """It flies the aircraft, and should be stepped at 50 Hz or more."""
        return self._guard.has_taken_over

    def step(self, t_s: float) -> None:
        """Hand on, watch and act; call it at 50 Hz or more until `finished`."""
        before, had_it = self._guard.state, self._guard.has_taken_over
        self._useless.listen(t_s)
        self._notice_cut(t_s)
        self._relay_autopilot(t_s)
        self._answer_beats(t_s)
        self._guard.handle_vehicle(self._ear.vehicle(t_s))
        action = self._guard.step(t_s)
        blind = not self._ear.vehicle(t_s).mode_is_of_now
        if blind or (self._guard.has_taken_over and not had_it):
            self._outbox.drop_handed_on()
        self._relay_navigator(t_s)
        self._relay_observer(t_s)
        if action is not None:
            self._outbox.put_own(self._voice.say(action, self._ear, t_s), t_s)
        self._call(t_s)
        self._outbox.flush(self._links.autopilot, t_s)
        self._tell_change(before, t_s)
        self._end_what_hangs(t_s)
        self._follow_navigator(t_s)

    def guarding(self, t_s: float) -> Guarding:
        """What it does, for who asks."""
        last = self._estimates.last
        told = last is not None and t_s - last.t_s <= CUT_S
        ended, armed = self._guard.navigator_ended, self._ear.vehicle(t_s).armed
        return Guarding(self._guard.state, ended, armed, told)

    def handle_navigator_end(self, t_s: float) -> None:
        """The navigator's process has ended, in whatever way."""
        self._useless.has_ended()
        self._follow_end(t_s)

    def close(self) -> None:
        """Give the ways back, and end the successor."""
        if self._successor is not None:
            self._successor.close()
        for link in (self._links.autopilot, self._links.navigator, self._links.observer):
            link.close()
        self._links.beats.close()

    def _follow_end(self, t_s: float) -> None:
        if not self._guard.navigator_ended:
            _log.warning("the navigator has ended")
            self._guard.handle_end()
            self._ended_t_s = t_s

    def _relay_autopilot(self, t_s: float) -> None:
        for _ in range(_READS_IN_A_ROW):
            data = self._links.autopilot.read()
            if not data:
                return
            for begin in range(0, len(data), _RELAYED_BYTES):
                piece = data[begin : begin + _RELAYED_BYTES]
                self._links.navigator.write(piece)
                self._links.observer.write(piece)
            for answer in self._ear.listen(data, t_s):
                self._guard.handle_answer(answer, t_s)

    def _relay_navigator(self, t_s: float) -> None:
        for _ in range(_READS_IN_A_ROW):
            data = self._links.navigator.read()
            if not data:
                return
            for packet in self._from_navigator.split(data):
                if self._passes(packet, t_s):
                    self._outbox.put(packet, t_s)

    def _relay_observer(self, t_s: float) -> None:
        """Somebody who listens along; may ask for messages, never for anything that flies."""
        for _ in range(_READS_IN_A_ROW):
            data = self._links.observer.read()
            if not data:
                return
            for packet in self._from_observer.split(data):
                if may_pass(packet, Rights.LISTENS, self._ear.kind):
                    self._outbox.put(packet, t_s)

    def _passes(self, packet: Packet, t_s: float) -> bool:
        if not may_pass(packet, self._rights(t_s), self._ear.kind):
            return False
        if packet.message_id == mavlink.MAVLINK_MSG_ID_SET_GPS_GLOBAL_ORIGIN:
            self._ear.handle_origin_sent(packet)
        if (mode := mode_asked(packet, self._ear.kind)) is not None:
            self._guard.handle_mode_asked(mode, t_s)
        return packet.message_id not in ESTIMATES or self._is_good_estimate(packet, t_s)

    def _rights(self, t_s: float) -> Rights:
        """Of the navigator: no successor flies, nor one whose aircraft others have, or may have."""
        others = self._guard.navigator_ended or self._guard.state is GuardState.STOOD_DOWN
        if others or not self._ear.vehicle(t_s).mode_is_of_now:
            return Rights.ESTIMATES
        return Rights.GIVES_UP if self._guard.has_taken_over else Rights.FLIES

    def _is_good_estimate(self, packet: Packet, t_s: float) -> bool:
        message = decode(packet)
        if message is None:
            return False
        was_good = self._estimates.lost_since_s is None
        good = self._admits(message, t_s)
        if good:
            self._useless.heard()
        if was_good != (is_good := self._estimates.lost_since_s is None):
            _log.warning(
                "estimates are %s",
                "handed on again" if is_good else f"held back: {self._estimates.reason}",
            )
        return good

    def _admits(self, message: Any, t_s: float) -> bool:
        armed = self._may_be_armed(t_s)
        match told_by(message):
            case RelayedPosition() as position, None:
                return self._estimates.admit_position(position, t_s, armed)
            case None, RelayedVelocity() as velocity:
                return self._estimates.admit_velocity(velocity, t_s)
            case RelayedPosition() as position, RelayedVelocity() as velocity:
                return self._estimates.admit_both(position, velocity, t_s, armed)
        return False

    def _may_be_armed(self, t_s: float) -> bool:
        """One not heard yet may fly: a spare watchdog comes up in between two heartbeats."""
        return self._ear.kind is None or self._ear.vehicle(t_s).armed

    def _notice_cut(self, t_s: float) -> None:
        """Before news are read: what was made while nothing came is not to be the first word."""
        is_cut = CUT_S < t_s - self._ear.heard_t_s < math.inf
        if not is_cut or not self._may_be_armed(t_s):
            return
        if self._estimates.lost_since_s is None:
            _log.warning("estimates are held back: the autopilot is not heard")
        self._estimates.lose("the autopilot was not heard", t_s)

    def _answer_beats(self, t_s: float) -> None:
        while data := self._links.beats.receive():
            beat = Beat.unpack(data)
            if beat is None:
                continue
            if beat.ended:
                self._useless.says_it_ends(t_s)
                self._follow_end(t_s)
                continue
            self._useless.heard()
            self._follow_autopilot(beat.system_id)
            if self._guard.navigator_ended and self._successor is not None:
                self._successor.handle_beat()
            self._guard.handle_beat(beat, t_s)
            age_s = self._ear.heartbeat_age_s(t_s)
            is_good, who = self._estimates.lost_since_s is None, self._config.process
            told = beat.sequence, age_s, is_good, who, self.has_spare
            self._links.beats.send(WatchdogReport(self._guard.state, *told).pack())

    def _follow_autopilot(self, system_id: int) -> None:
        """The navigator's, where another one was heard first: by one that takes over in flight."""
        if system_id not in (0, self._ear.system_id):
            self._ear = AutopilotEar(system_id)

    def _call(self, t_s: float) -> None:
        """Show ourselves to an autopilot that waits to be spoken to."""
        is_heard = self._ear.heartbeat_age_s(t_s) <= _CALL_PERIOD_S
        if self._config.calls_first and not is_heard and t_s - self._call_t_s >= _CALL_PERIOD_S:
            self._call_t_s = t_s
            self._outbox.put_own(self._voice.heartbeat(), t_s)

    def _end_what_hangs(self, t_s: float) -> None:
        """A navigator that lives and is of no use any more, where there is a second one."""
        begun = self._guard.last_beat is not None and self._flies(t_s)
        if self._navigator is None or self._successor is None or not begun:
            return
        why = self._useless.reason_to_end(t_s)
        if why and (self._successor.stands_by or self._guard.navigator_ended):
            _log.warning("the navigator %s: it is ended, and a second one gives the estimates", why)
            self._navigator.end()
            self._outbox.put(self._voice.text(_ENDED_TEXT, self._ear), t_s)

    def _flies(self, t_s: float) -> bool:
        """As it says itself, lately."""
        vehicle = self._ear.vehicle(t_s)
        is_heard = self._ear.heartbeat_age_s(t_s) <= _LAST_WORD_S
        return is_heard and vehicle.armed and not vehicle.landed

    def _follow_navigator(self, t_s: float) -> None:
        """Keep the successor ready, wake it when it is needed, and know when to leave."""
        ended = self._guard.navigator_ended
        self.finished = ended and self._may_leave(t_s)
        if self._successor is None or self.finished or self._guard.last_beat is None:
            return
        self._ask_for_origin(t_s)
        needed = ended and self._ear.vehicle(t_s).armed
        self._successor.step(self._resume() if needed else None, t_s)

    def _ask_for_origin(self, t_s: float) -> None:
        """The last place is about it, and one that takes over in flight has not heard it."""
        is_missing = self._ear.origin is None and self._ear.vehicle(t_s).armed
        if is_missing and t_s - self._origin_t_s >= _CALL_PERIOD_S:
            self._origin_t_s = t_s
            self._outbox.put(self._voice.ask_for_origin(self._ear), t_s)

    def _may_leave(self, t_s: float) -> bool:
        alone_s = t_s - self._ended_t_s
        vehicle = self._ear.vehicle(t_s)
        silent_s = min(alone_s, self._ear.heartbeat_age_s(t_s))
        if alone_s > self._config.limit_s or silent_s > _SWITCHED_OFF_S:
            return True
        heard_since = self._ear.heartbeat_t_s > self._ended_t_s
        was_heard = self._ear.heartbeat_t_s > -math.inf
        if was_heard and not heard_since and alone_s < _LAST_WORD_S:
            return False  # it may have been armed since it was last heard
        return not vehicle.armed or (self._successor is None and self._guard.is_handed_over)

    def _resume(self) -> Resume:
        guard, ear = self._estimates, self._ear
        learned = self._guard.learned
        return Resume(guard.last, guard.velocity_ne_m_s, ear.origin, learned, ear.system_id)

    def _tell_change(self, before: GuardState, t_s: float) -> None:
        """In the log and, of an aircraft that flies, to the ground stations."""
        state, beat = self._guard.state, self._guard.last_beat
        if state is before:
            return
        what = before.name, state.name, self._guard.vehicle.mode.name
        silent_s, phase = self._guard.silence_s(t_s), "" if beat is None else beat.phase
        _log.warning("%s -> %s, mode %s, navigator silent for %.2f s (%s)", *what, silent_s, phase)
        if self._flies(t_s):
            self._outbox.put_own(self._voice.text(self._guard.words(before, t_s), self._ear), t_s)
