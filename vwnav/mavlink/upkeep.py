"""What a link needs all the time: joined clocks, message rates, and one common origin."""

import logging
from collections import deque
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass

import numpy as np

from vwnav.geometry.geodesy import LocalFrame
from vwnav.mavlink.commands import CommandSender
from vwnav.mavlink.link_budget import UNREAD, LinkBudget, Stream
from vwnav.mavlink.modes import Command
from vwnav.mavlink.ports.port import Fields, Send
from vwnav.mavlink.telemetry.telemetry_state import TelemetryState
from vwnav.sender_clock import SenderClock
from vwnav.types import Array

_log = logging.getLogger(__name__)
_TIMESYNC_S = 0.2
_QUESTIONS = 20  # TIMESYNC questions whose answers are waited for
_ASK_S = 0.02  # one message after another: a serial link's buffer is small
_LOOK_S = 2.0  # so long a message's rate is counted
# For a message that never comes at the rate asked for, and for one that a flight can do without:
# an ArduPilot that does not know it says so to every ground station, each time.
_SLOWEST_ASK_S, _SPARED_ASK_S = 8.0, 60.0
_ENOUGH = 0.6  # of the rate asked for: PX4 divides its own
_SILENCE = -1.0  # as an interval: do not send it
_CMD_MESSAGE_INTERVAL, _CMD_REQUEST_MESSAGE = 511, 512
_GPS_GLOBAL_ORIGIN = 49
_ORIGIN_TRIES = 6
_UNCONFIRMED_TRIES = 30  # an autopilot that is still starting has no filter to take the origin
_ORIGIN_TOO_FAR_M = 20e3  # numbers of single precision are coarse there
_ORIGIN_PERIOD_S = 0.3
_ORIGIN_DIFFERS_M = 0.5
_ORIGIN_LOOK_S = 5.0


class Timesync:
    """Asks for the autopilot's clock, and answers when it asks for ours."""

    def __init__(self, send: Send, clock: Callable[[], float], boot_clock: SenderClock) -> None:
        self._send = send
        self._clock = clock
        self._boot_clock = boot_clock
        self._asked_ns: deque[int] = deque(maxlen=_QUESTIONS)
        self._asked_s = -np.inf

    def step(self, t_s: float) -> None:
        """Ask, five times a second."""
        if t_s - self._asked_s < _TIMESYNC_S:
            return
        self._asked_s = t_s
        now_ns = int(self._clock() * 1e9)
        self._asked_ns.append(now_ns)
        self._send("TIMESYNC", {"tc1": 0, "ts1": now_ns})

    def handle(self, fields: Fields, received_s: float) -> None:
        """Answer the autopilot's question (it stamps our estimates by it), learn from answers."""
        if fields["tc1"] == 0:
            self._send("TIMESYNC", {"tc1": int(received_s * 1e9), "ts1": fields["ts1"]})
        elif fields["ts1"] in self._asked_ns:  # others ask too, and their answers come by here
            self._asked_ns.remove(fields["ts1"])
            answered_s = self._boot_clock.near(fields["tc1"] / 1e9)
            self._boot_clock.handle_round_trip(fields["ts1"] / 1e9, answered_s, received_s)


@dataclass(slots=True)
class _Watched:
    """When a stream is asked for next, and how long is waited after that."""

    due_s: float
    wait_s: float = _LOOK_S
    heard: int = 0


class StreamKeeper:
    """Asks for messages until they come, and anew when they stop: a restarted autopilot forgets.

    What the autopilot answers is not looked at: an answer does not say which message it is about.
    """

    def __init__(self, commands: CommandSender, budget: LinkBudget) -> None:
        self._commands = commands
        self._streams = budget.streams
        self._watched = {stream.name: _Watched(-np.inf) for stream in budget.streams}
        self._unread = UNREAD if budget.is_tight else ()
        self._to_silence = list(self._unread)
        self._asked_s = -np.inf
        self._looked_s = -np.inf
        self._rates_hz: dict[str, float] = {}

    @property
    def rates_hz(self) -> Mapping[str, float]:
        """How often each message came in the last two seconds that were looked at."""
        return self._rates_hz

    def count(self, name: str) -> None:
        """A message has come."""
        watched = self._watched.get(name)
        if watched is not None:
            watched.heard += 1

    def step(self, t_s: float) -> None:
        """Look at what comes, and ask for at most one message."""
        if t_s - self._looked_s >= _LOOK_S:
            self._look(t_s)
        if t_s - self._asked_s < _ASK_S:
            return
        due = next((each for each in self._streams if self._is_due(each, t_s)), None)
        if due is not None:
            watched = self._watched[due.name]
            watched.due_s = t_s + watched.wait_s
            slowest_s = _SLOWEST_ASK_S if due.least_hz else _SPARED_ASK_S
            watched.wait_s = min(2.0 * watched.wait_s, slowest_s)
            self._ask(due.number, 1e6 / due.rate_hz, t_s)
        elif self._to_silence:
            self._ask(self._to_silence.pop(0), _SILENCE, t_s)

    def restart(self) -> None:
        """Ask for everything anew: the autopilot has started anew."""
        for watched in self._watched.values():
            watched.due_s, watched.wait_s = -np.inf, _LOOK_S
        self._to_silence = list(self._unread)

    def _is_due(self, stream: Stream, t_s: float) -> bool:
        """A message that stands in for another one waits until that has not come."""
        spare = stream.instead_of is not None and self._rates_hz.get(stream.instead_of) != 0.0
        return t_s >= self._watched[stream.name].due_s and not spare

    def _ask(self, number: int, interval_us: float, t_s: float) -> None:
        self._asked_s = t_s
        self._commands.tell(Command(_CMD_MESSAGE_INTERVAL, (float(number), interval_us)))

    def _look(self, t_s: float) -> None:
        span_s = t_s - self._looked_s
        self._looked_s = t_s
        if not np.isfinite(span_s):
            return
        self._rates_hz = {name: each.heard / span_s for name, each in self._watched.items()}
        if not any(self._rates_hz.values()):
            return  # the link is silent: nothing is missed before it is back
        for stream in self._streams:
            watched = self._watched[stream.name]
            if watched.heard / span_s >= _ENOUGH * stream.rate_hz:
                watched.due_s, watched.wait_s = np.inf, _LOOK_S
            elif watched.due_s == np.inf:
                watched.due_s = t_s
            watched.heard = 0


class OriginAgreement:
    """Reads the autopilot's origin, or sets it, and finds where ours lies about it.

    PX4 1.18 must have the origin before the first vision message, or its position jumps by
    thousands of kilometres: until there is agreement, `TelemetryState.origin_offset_ned_m` is None.
    An origin that is there already, of an earlier flight or of GPS, is kept for the same reason.

    On the ground it is looked for now and then: one that has started anew has forgotten it, where
    its clock did not show that, and a ground station may set another one.
    """

    def __init__(
        self,
        send: Send,
        system_id: Callable[[], int],
        commands: CommandSender,
        telemetry: TelemetryState,
        clock: Callable[[], float],
        patience_s: Callable[[], float],
    ) -> None:
        self._send = send
        self._system_id = system_id
        self._commands = commands
        self._telemetry = telemetry
        self._clock = clock
        self._patience_s = patience_s
        self._told: Array | None = None  # our origin about the one that it told last

    def keep(self, frame: LocalFrame) -> Generator[None, None, None]:
        """Agree upon the origin of `frame`, and see to it that it stays so; never ends."""
        yield from self._agree(frame)
        while True:
            yield from self._wait(_ORIGIN_LOOK_S)
            if not self._telemetry.armed:
                yield from self._look_again(frame)

    def _agree(self, frame: LocalFrame) -> Generator[None, None, None]:
        """Nothing is sent about it until it stands."""
        self._telemetry.origin_offset_ned_m = None
        offset_ned_m = yield from self._ask(frame)
        tries = 0
        while _is_far(offset_ned_m) and not (self._telemetry.armed and self._told is not None):
            tries += 1
            if tries > (_UNCONFIRMED_TRIES if offset_ned_m is None else _ORIGIN_TRIES):
                break
            self._send("SET_GPS_GLOBAL_ORIGIN", self._fields(frame))
            offset_ned_m = yield from self._ask(frame)
        if offset_ned_m is None:
            _log.warning("the autopilot does not confirm its origin; estimates are sent anyway")
            self._telemetry.origin_offset_ned_m = np.zeros(3) if self._told is None else self._told
        else:
            self._take(offset_ned_m)

    def _look_again(self, frame: LocalFrame) -> Generator[None, None, None]:
        """An answer may be lost once; where nothing is heard at all nothing is known.

        Who is armed meanwhile flies on the one that was told last.
        """
        asked_s = self._clock()
        offset_ned_m = yield from self._ask(frame)
        if offset_ned_m is None:
            offset_ned_m = yield from self._ask(frame)
        if offset_ned_m is not None:
            self._take(offset_ned_m)
        elif self._telemetry.armed:
            return
        elif self._told is None:
            self._send("SET_GPS_GLOBAL_ORIGIN", self._fields(frame))
        elif self._telemetry.heard_s > asked_s:
            yield from self._agree(frame)

    def _take(self, offset_ned_m: Array) -> None:
        before, self._told = self._telemetry.origin_offset_ned_m, offset_ned_m
        if before is not None and np.linalg.norm(offset_ned_m - before) < _ORIGIN_DIFFERS_M:
            return
        self._telemetry.origin_offset_ned_m = offset_ned_m
        distance_m = np.linalg.norm(offset_ned_m)
        if distance_m >= _ORIGIN_DIFFERS_M:
            _log.warning("the autopilot keeps its own origin, %.1f m from ours", distance_m)

    def _ask(self, frame: LocalFrame) -> Generator[None, None, Array | None]:
        """Our origin about the one that the autopilot tells; None where it tells none."""
        self._telemetry.origin = None
        self._commands.tell(Command(_CMD_REQUEST_MESSAGE, (float(_GPS_GLOBAL_ORIGIN),)))
        yield from self._wait(max(_ORIGIN_PERIOD_S, self._patience_s()))
        origin = self._telemetry.origin
        if origin is None:
            return None
        return LocalFrame(*origin).to_ned(frame.lat_deg, frame.lon_deg, frame.alt_amsl_m)

    def _wait(self, seconds: float) -> Generator[None, None, None]:
        since_s = self._clock()
        while self._clock() - since_s < seconds:
            yield

    def _fields(self, frame: LocalFrame) -> dict[str, int]:
        return {
            "target_system": self._system_id(),
            "latitude": round(frame.lat_deg * 1e7),
            "longitude": round(frame.lon_deg * 1e7),
            "altitude": round(frame.alt_amsl_m * 1e3),
            "time_usec": 0,
        }


def _is_far(offset_ned_m: Array | None) -> bool:
    return offset_ned_m is None or float(np.hypot(*offset_ned_m[:2])) > _ORIGIN_TOO_FAR_M
