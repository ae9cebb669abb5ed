"""A relay between an autopilot and the program under test, which a fault may spoil."""

import random
import threading
import time
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from vwnav.mavlink.framing import Framer, Packet
from vwnav.mavlink.links import LinkAddress, UdpLink, open_link, parse_link
from vwnav.sim.memory_link import MemoryLink

_IDLE_S = 0.001
# HEARTBEAT, SCALED_PRESSURE, ATTITUDE, LOCAL_POSITION_NED, GPS_GLOBAL_ORIGIN, and of the program
# SET_POSITION_TARGET_LOCAL_NED, VISION_POSITION_ESTIMATE.
HEARD = frozenset({0, 29, 30, 32, 49, 84, 102})
_READS_IN_A_ROW = 64


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
