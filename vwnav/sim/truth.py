"""Ground truth of any simulator that sends HIL_STATE_QUATERNION or SIM_STATE over MAVLink.

For the renderer and the score only: nothing that navigates may read it.
"""

import math
import threading
import time
from bisect import bisect_left
from collections import deque
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import development as mavlink

from vwnav.clock import Clock, WallClock
from vwnav.sender_clock import SenderClock
from vwnav.sim.mavlink.link import datagram_parser
from vwnav.sim.mavlink.truth_line import Source, TruthLine
from vwnav.sim.truth_state import TruthState, between, from_hil_state_quaternion, from_sim_state

_HISTORY_S = 5.0
_SOURCE_SYSTEM, _SOURCE_COMPONENT = 245, 191
_AUTOPILOT = mavlink.MAV_COMP_ID_AUTOPILOT1
_HIL_STATE_QUATERNION, _SIM_STATE, _SYSTEM_TIME = 115, 108, 2
# ArduPilot answers a request for the other one with a text to every ground station, each time.
_TRUTH_OF = {
    mavlink.MAV_AUTOPILOT_PX4: (_HIL_STATE_QUATERNION,),
    mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: (_SIM_STATE, _SYSTEM_TIME),
}
_ASK_EVERY_S = 1.0
_STAMPS_GONE_S = 1.0  # no SYSTEM_TIME for so long: states are dated by their arrival
_SILENT_S = 3.0  # of the vehicle that is followed: another one is
_QUESTION_EVERY_S = 0.2
_QUESTIONS = 20  # TIMESYNC questions whose answers are waited for


class TruthReader:
    """Reads truth in a thread of its own, until `close`.

    Of several vehicles on one port it follows the first that tells a state, until that is silent.
    States are dated by the simulator's own time, joined to ours as an autopilot's is: one that is
    read late on a busy machine was so when it says. SIM_STATE has no time: ArduPilot sends what is
    due at one moment together, SYSTEM_TIME first (its `ap_message` order), and that dates it.

    Args:
        url: as `TruthLine` reads it.
        rate_hz: the rate it asks the simulator for.
        clock: stamps what arrives.

    Raises:
        ConfigError: the URL is none of these.
        LinkError: the port is taken, or nobody has come to listen at a tcpout URL.
    """

    def __init__(self, url: str, rate_hz: float = 100.0, clock: Clock | None = None) -> None:
        self._rate_hz = rate_hz
        self._clock = clock if clock is not None else WallClock()
        self._line = TruthLine(url)
        self._parsers: dict[Source, Any] = {}
        self._packer = mavlink.MAVLink(
            None, srcSystem=_SOURCE_SYSTEM, srcComponent=_SOURCE_COMPONENT
        )
        self._states: deque[TruthState] = deque()
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._followed, self._followed_s = 0, -math.inf  # whose states are read; the newest came
        self._vehicle: tuple[int, int] | None = None
        self._wanted: tuple[int, ...] = (_HIL_STATE_QUATERNION, _SIM_STATE)
        self._sender = SenderClock()
        self._asked_ns: deque[int] = deque(maxlen=_QUESTIONS)
        self._stamp_s: float | None = None  # of SYSTEM_TIME, until a state has taken it
        self._stamped_s = -math.inf
        self._thread = threading.Thread(target=self._run, name="truth", daemon=True)
        self._thread.start()

    def latest(self) -> TruthState | None:
        """The newest state, None before the first."""
        with self._lock:
            return self._states[-1] if self._states else None

    def at(self, t_s: float) -> TruthState | None:
        """The state at a time of the last five seconds, interpolated; the nearest one outside.

        None before the first state.
        """
        with self._lock:
            states = list(self._states)
        if not states:
            return None
        i = bisect_left(states, t_s, key=lambda state: state.t_s)
        if i == 0:
            return states[0]
        if i == len(states):
            return states[-1]
        return between(states[i - 1], states[i], t_s)

    def wait(self, timeout_s: float) -> TruthState | None:
        """The newest state as soon as there is one, None after `timeout_s`."""
        end_s = time.monotonic() + timeout_s
        while (state := self.latest()) is None and time.monotonic() < end_s:
            time.sleep(0.01)
        return state

    def close(self) -> None:
        """Stop reading and free the port."""
        self._stop.set()
        self._thread.join()
        self._line.close()

    def _run(self) -> None:
        asked_s = questioned_s = -math.inf
        while not self._stop.is_set():
            now_s = self._clock()
            if now_s - questioned_s >= _QUESTION_EVERY_S:
                questioned_s = now_s
                self._question(now_s)
            if now_s - asked_s >= _ASK_EVERY_S:
                asked_s = now_s
                self._ask(now_s)
            data, source = self._line.read()
            if data:
                self._handle(data, source, self._clock())

    def _handle(self, data: bytes, source: Source, now_s: float) -> None:
        parser = self._parsers.get(source)
        if parser is None or not self._line.is_stream:
            parser = datagram_parser(parser, data)
        for message in parser.parse_buffer(data) or []:
            kind = message.get_type()
            if kind == "BAD_DATA":
                continue
            self._parsers[source] = parser
            if self._is_anothers(message, now_s):
                continue
            self._line.talk_to(source)
            if kind == "HEARTBEAT":
                self._meet(message)
            elif kind == "TIMESYNC":
                self._learn(message, now_s)
            elif kind == "HIL_STATE_QUATERNION":
                stamp_s = message.time_usec * 1e-6 if message.time_usec else None
                self._add(from_hil_state_quaternion, message, self._time(stamp_s, now_s))
            elif kind == "SYSTEM_TIME" and message.get_srcComponent() == _AUTOPILOT:
                self._stamp_s, self._stamped_s = message.time_boot_ms * 1e-3, now_s
            elif kind == "SIM_STATE":
                self._add(from_sim_state, message, self._time_of_sim_state(now_s))

    def _is_anothers(self, message: Any, now_s: float) -> bool:
        """Of a second vehicle on a port that several send to, PX4's 14550 for one."""
        system = message.get_srcSystem()
        if system != self._followed and now_s - self._followed_s < _SILENT_S:
            return True
        if message.get_msgId() in (_HIL_STATE_QUATERNION, _SIM_STATE):
            self._followed, self._followed_s = system, now_s
        return False

    def _meet(self, heartbeat: Any) -> None:
        """A vehicle, not the ground stations, gimbals and companions beside it."""
        source = (heartbeat.get_srcSystem(), heartbeat.get_srcComponent())
        if heartbeat.autopilot == mavlink.MAV_AUTOPILOT_INVALID or source[1] != _AUTOPILOT:
            return
        self._vehicle = source
        self._wanted = _TRUTH_OF.get(heartbeat.autopilot, (_HIL_STATE_QUATERNION, _SIM_STATE))

    def _add(
        self, read: Callable[[Any, float], TruthState | None], message: Any, t_s: float | None
    ) -> None:
        state = None if t_s is None else read(message, t_s)
        if state is None:
            return
        with self._lock:
            if self._states and state.t_s <= self._states[-1].t_s:
                self._states.pop()
            self._states.append(state)
            while self._states[0].t_s < state.t_s - _HISTORY_S:
                self._states.popleft()

    def _time(self, stamp_s: float | None, now_s: float) -> float | None:
        """Of a state on our clock: its arrival where it has no stamp, None for a wrong one."""
        return now_s if stamp_s is None else self._sender.date(stamp_s, now_s)

    def _time_of_sim_state(self, now_s: float) -> float | None:
        """None for one without a stamp of its own, while others have one."""
        stamp_s, self._stamp_s = self._stamp_s, None
        if stamp_s is None and now_s - self._stamped_s < _STAMPS_GONE_S:
            return None
        return self._time(stamp_s, now_s)

    def _question(self, now_s: float) -> None:
        """Ask what time it is there (TIMESYNC)."""
        self._asked_ns.append(round(now_s * 1e9))
        self._send(mavlink.MAVLink_timesync_message(0, self._asked_ns[-1]))

    def _learn(self, answer: Any, now_s: float) -> None:
        """ArduPilot hands what we ask on to others, and they answer, too."""
        is_its = answer.get_srcComponent() == _AUTOPILOT and answer.tc1 != 0
        if is_its and answer.ts1 in self._asked_ns:
            self._asked_ns.remove(answer.ts1)
            self._sender.handle_round_trip(answer.ts1 / 1e9, answer.tc1 / 1e9, now_s)

    def _ask(self, now_s: float) -> None:
        """A heartbeat, and requests while the truth is missing or slow."""
        self._send(
            mavlink.MAVLink_heartbeat_message(
                mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3
            )
        )
        with self._lock:
            recent = sum(state.t_s > now_s - _ASK_EVERY_S for state in self._states)
        if self._vehicle is None or recent > 0.7 * self._rate_hz:
            return
        for number in self._wanted:
            self._send(
                mavlink.MAVLink_command_long_message(
                    *self._vehicle,
                    mavlink.MAV_CMD_SET_MESSAGE_INTERVAL,
                    0,
                    number,
                    1e6 / self._rate_hz,
                    *([0.0] * 5),
                )
            )

    def _send(self, message: Any) -> None:
        packet = message.pack(self._packer)
        self._packer.seq = (self._packer.seq + 1) % 256
        self._line.send(packet)
