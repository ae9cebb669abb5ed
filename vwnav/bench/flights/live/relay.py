"""Between the programs and a simulator: a relay that can be broken, and who plays the pilot."""

import random
import threading
import time
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from vwnav.mavlink.framing import Framer, Packet
from vwnav.mavlink.links import LinkAddress, UdpLink, open_link, parse_link
from vwnav.mavlink.modes import AutopilotKind, mode_command
from vwnav.sim.memory_link import MemoryLink
from vwnav.vehicle import FlightMode

_IDLE_S = 0.001
# HEARTBEAT, SCALED_PRESSURE, ATTITUDE, LOCAL_POSITION_NED, GPS_GLOBAL_ORIGIN, and of the program
# SET_POSITION_TARGET_LOCAL_NED, VISION_POSITION_ESTIMATE.
HEARD = frozenset({0, 29, 30, 32, 49, 84, 102})
_READS_IN_A_ROW = 64
_PERIOD_S = 0.05  # of the sticks
_HEARTBEAT_S = 1.0
_STATION = (255, 190)
_MIDDLE_US, _UNTOUCHED_US = 1500, 65535
# ArduPilot's simulator has a receiver of its own, which is heard 3 s after the sticks fell silent.
_OWN_RECEIVER, _SILENT, _AS_BEFORE = b"SIM_RC_FAIL", 1.0, 0.0
# Flown with sticks and a position: PX4 Position (main, sub), ArduCopter Loiter.
_STICK_MODES = {AutopilotKind.PX4: (3.0, 0.0), AutopilotKind.ARDUPILOT: (5.0, 0.0)}


class Relay:
    """Hands packets on, both ways, through a `MemoryLink`: what spoils that one spoils this.

    Args:
        url: of the autopilot, as MAVSDK writes it, or without "//".
        hear: is called with what is heard of `HEARD`, from the relay's thread: the autopilot's
            messages, and those of the program.

    Attributes:
        autopilot_link: `a` is the autopilot's end, `b` the program's.

    Raises:
        LinkError: the URL is none, or cannot be opened.
    """

    def __init__(self, url: str, hear: Callable[[Any], None] = lambda _: None) -> None:
        scheme, _, rest = url.partition(":")
        self._far = open_link(parse_link(f"{scheme}://{rest.removeprefix('//')}"))
        self._near = UdpLink(LinkAddress("udpin", "127.0.0.1", 0))
        self.autopilot_link = MemoryLink(time.monotonic, random.Random(1))
        self._hear = hear
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="relay", daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        """Where the program connects to."""
        return f"udpout://127.0.0.1:{self._near.port}"

    def close(self) -> None:
        """Stop, and give the ports back."""
        self._stop.set()
        self._thread.join()
        self._far.close()
        self._near.close()

    def _run(self) -> None:
        down, up = Framer(), Framer()
        link = self.autopilot_link
        while not self._stop.is_set():
            for _ in range(_READS_IN_A_ROW):
                from_autopilot, from_program = self._far.read(), self._near.read()
                if not from_autopilot and not from_program:
                    break
                for packet in down.split(from_autopilot):
                    self._listen(packet)
                    link.a.write(packet.data)
                for packet in up.split(from_program):
                    self._listen(packet)
                    link.b.write(packet.data)
            while data := link.b.read():
                self._near.write(data)
            while data := link.a.read():
                self._far.write(data)
            time.sleep(_IDLE_S)

    def _listen(self, packet: Packet) -> None:
        if packet.message_id not in HEARD:
            return
        for message in self._parser.parse_buffer(packet.data) or []:
            is_autopilot = message.get_srcComponent() == mavlink.MAV_COMP_ID_AUTOPILOT1
            is_other_heartbeat = message.get_type() == "HEARTBEAT" and not is_autopilot
            if message.get_type() != "BAD_DATA" and not is_other_heartbeat:
                self._hear(message)


class MavlinkPilot:
    """A ground station with a joystick; centred sticks are sent until it is closed.

    Args:
        url: of a link of the autopilot's that nobody else uses.
        hand_on: takes the station's heartbeats to the program, as an autopilot that routes would:
            a station that was never heard commands nothing.
        flown: system of the autopilot that is flown, of several on that link; 0 while not known.

    Raises:
        LinkError: it cannot be opened.
    """

    def __init__(
        self, url: str, hand_on: Callable[[bytes], None], flown: Callable[[], int]
    ) -> None:
        self._hand_on, self._flown = hand_on, flown
        self._link = open_link(parse_link(url))
        self._packer = mavlink.MAVLink(None, srcSystem=_STATION[0], srcComponent=_STATION[1])
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        self._autopilot: tuple[int, AutopilotKind] | None = None
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._radio_on = True
        self._thread = threading.Thread(target=self._run, name="pilot", daemon=True)
        self._thread.start()

    @property
    def hears(self) -> bool:
        """Whether the autopilot has been heard on his link."""
        return self._autopilot is not None

    def take_over(self) -> None:
        """Flip the switch to the mode that is flown with sticks."""
        if self._autopilot is not None:
            main, sub = _STICK_MODES[self._autopilot[1]]
            self._command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, main, sub)

    def ask(self, mode: FlightMode) -> None:
        """Ask for Offboard, Hold, Return or Land."""
        if self._autopilot is not None:
            command = mode_command(self._autopilot[1], mode)
            self._command(command.number, *(value or 0.0 for value in command.params))

    def switch_radio_off(self) -> None:
        """Nothing is heard of the sticks any more, until it is closed."""
        self._radio_on = False
        self._set_own_receiver(_SILENT)

    def close(self) -> None:
        """Let go."""
        self._stop.set()
        self._thread.join()
        if not self._radio_on:
            self._set_own_receiver(_AS_BEFORE)
        self._link.close()

    def _run(self) -> None:
        beat_s = 0.0
        while not self._stop.wait(_PERIOD_S):
            while data := self._link.read():
                for message in self._parser.parse_buffer(data) or []:
                    self._meet(message)
            now_s = time.monotonic()
            if now_s - beat_s >= _HEARTBEAT_S:
                beat_s = now_s
                gcs, none = mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID
                beat = mavlink.MAVLink_heartbeat_message(gcs, none, 0, 0, 4, 3)
                self._send(beat)
                self._hand_on(bytes(beat.get_msgbuf()))
            if self._radio_on:
                self._move_sticks()

    def _meet(self, message: Any) -> None:
        known = {kind.value for kind in AutopilotKind}
        is_autopilot = message.get_type() == "HEARTBEAT" and message.autopilot in known
        if is_autopilot and message.get_srcSystem() == self._flown():
            self._autopilot = message.get_srcSystem(), AutopilotKind(message.autopilot)

    def _move_sticks(self) -> None:
        """In the middle: held in place by the mode that is flown with them."""
        if self._autopilot is None:
            return
        system, kind = self._autopilot
        if kind is AutopilotKind.PX4:
            self._send(mavlink.MAVLink_manual_control_message(system, 0, 0, 500, 0, 0))
        else:
            sticks = [_MIDDLE_US] * 4 + [_UNTOUCHED_US] * 4
            self._send(mavlink.MAVLink_rc_channels_override_message(system, 1, *sticks))

    def _set_own_receiver(self, fails: float) -> None:
        if self._autopilot is None or self._autopilot[1] is not AutopilotKind.ARDUPILOT:
            return
        system, int8 = self._autopilot[0], mavlink.MAV_PARAM_TYPE_INT8
        self._send(mavlink.MAVLink_param_set_message(system, 1, _OWN_RECEIVER, fails, int8))

    def _command(self, number: int, *params: float) -> None:
        assert self._autopilot is not None
        padded = (*params, *([0.0] * (7 - len(params))))
        self._send(mavlink.MAVLink_command_long_message(self._autopilot[0], 1, number, 0, *padded))

    def _send(self, message: Any) -> None:
        with self._lock:
            self._link.write(bytes(message.pack(self._packer)))
            self._packer.seq = (self._packer.seq + 1) % 256
