"""What hears the link onboard, as it is wired in flight: watchdog, port, driver, filter.

The autopilot is scripted, the clock simulated; the navigator has the aircraft and beats.
"""

import numpy as np
from autopilot_links import HOME, PX4, PX4_OFFBOARD, Clock, End, Scripted, Way
from pymavlink.dialects.v20 import all as mavlink

from vwnav.config import Config
from vwnav.estimation.beginning.starts import Start
from vwnav.estimation.ekf import Ekf
from vwnav.mavlink.autopilot import LinkedAutopilot
from vwnav.mavlink.framing import Framer, Packet
from vwnav.mavlink.ports.pymavlink_port import PymavlinkPort
from vwnav.types import Estimate, Telemetry
from vwnav.vehicle import VelocitySetpoint
from vwnav.watchdog.keepalive import KeepAlive
from vwnav.watchdog.loop import Watchdog, WatchdogConfig, WatchdogLinks

TICK_S = 0.02
_SETTLE_S = 3.0


class Both(End):
    """A channel of beats too."""

    def receive(self) -> bytes:
        return self.read()

    def send(self, data: bytes) -> None:
        self.write(data)

    def has_room(self) -> bool:
        return True


class Rig:
    """One aircraft; `said` is what has reached its autopilot in the last tick.

    Args:
        steers: the navigator sends setpoints.
    """

    def __init__(self, steers: bool) -> None:
        self.clock = Clock()
        self.down, self.up = Way(self.clock), Way(self.clock)
        self.peer = Scripted(self.clock, self.down, PX4)
        to_navigator, from_navigator, beats, answers = (Way(self.clock) for _ in range(4))
        nobody = Both(Way(self.clock), Way(self.clock))
        self.watchdog = Watchdog(
            WatchdogLinks(
                Both(self.down, self.up), Both(from_navigator, to_navigator), nobody,
                Both(beats, answers),
            ),
            WatchdogConfig(),
        )  # fmt: skip
        self.keepalive = KeepAlive(Both(answers, beats), self.clock)
        port = PymavlinkPort(End(to_navigator, from_navigator), self.clock)
        self.autopilot = LinkedAutopilot(port, self.clock, ground_station_ids=(255,))
        self.ekf = Ekf(Config().ekf)
        self.steers, self.beats = steers, True
        self.said: list[Packet] = []
        self.heard: list[Telemetry] = []
        self._framer = Framer()
        self._nobody = nobody
        self.autopilot.set_origin(*HOME)
        for _ in range(round(_SETTLE_S / TICK_S)):
            self.tick()
        self.peer.armed, self.peer.landed_state = True, 2
        self.peer.custom_mode = PX4_OFFBOARD
        self.ekf.initialise(Start(t_s=self.clock()))

    def tick(self, hostile: bytes = b"") -> None:
        """A fiftieth of a second, with some frames among the autopilot's own."""
        self.clock.t_s += TICK_S
        t_s = self.clock()
        if hostile:
            self.down.write(hostile)
        self._autopilot_speaks()
        if self.beats:
            self.keepalive.beat(True, "on route")
        self.watchdog.step(t_s)
        self.autopilot.step(t_s)
        self.heard = list(self.autopilot.take_measurements())
        for measured in self.heard:
            self.ekf.handle(measured)
        self._navigator_speaks(t_s)
        b"".join(iter(self._nobody.outward.read, b""))

    def _autopilot_speaks(self) -> None:
        data = b"".join(iter(self.up.read, b""))
        self.said = self._framer.split(data)
        self.peer.heard.clear()
        self.peer.step(data)

    def _navigator_speaks(self, t_s: float) -> None:
        self.autopilot._port.poll()
        if self.steers:
            self.autopilot.send_velocity(VelocitySetpoint(1.0, 2.0, 0.0, 0.0))
        place, level = np.array([10.0, -20.0, -30.0]), np.array([1.0, 0.0, 0.0, 0.0])
        self.autopilot.send_estimate(
            Estimate(t_s, place, np.zeros(3), 0.1 * np.eye(6), level, 0.1, 30.0, 1.0, t_s, 0)
        )


def words(said: list[Packet]) -> list[tuple[int | None, int, int, bytes]]:
    """What was said, without the count of messages; answers to strangers left out."""
    return [
        (packet.message_id, packet.system_id, packet.component_id, packet.data[10:-2])
        for packet in said
        if packet.message_id != mavlink.MAVLINK_MSG_ID_COMMAND_ACK
    ]
