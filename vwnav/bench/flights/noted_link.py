"""The vehicle's end of its companion link, which notes what arrives there."""

from typing import Any

import numpy as np

from vwnav.bench.flights.track import Order, Sent, Track
from vwnav.sim.clock import SimulatedClock
from vwnav.sim.px4.link import ByteLink


class NotedLink(ByteLink):
    """The vehicle's end of its companion link; what arrives is noted.

    Args:
        track: gets it.
    """

    def __init__(self, end: Any, clock: SimulatedClock, track: Track) -> None:
        super().__init__(end, 1)
        self._clock = clock
        self._track = track

    def receive(self, t_s: float) -> list[Any]:
        """Every valid message that has arrived."""
        messages = super().receive(t_s)
        for message in messages:
            self._note(message, self._clock())
        return messages

    def _note(self, m: Any, t_s: float) -> None:
        kind, component = m.get_type(), m.get_srcComponent()
        if kind == "VISION_POSITION_ESTIMATE":
            c = m.covariance
            covariance = np.array([[c[0], c[1]], [c[1], c[6]]])
            place = np.array([m.x, m.y, m.z])
            sent = Sent(t_s, m.usec * 1e-6, place, covariance, m.reset_counter)
            self._track.sent.append(sent)
        elif kind == "SET_POSITION_TARGET_LOCAL_NED":
            self._track.orders.append(Order(t_s, "setpoint", component, 0, (m.vx, m.vy, m.vz)))
        elif kind in ("COMMAND_LONG", "COMMAND_INT"):
            parameters = (m.param1, m.param2, m.param3)
            self._track.orders.append(Order(t_s, "command", component, m.command, parameters))
