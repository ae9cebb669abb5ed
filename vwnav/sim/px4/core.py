"""The simulated PX4 with whoever talks to it, stepped by a clock that is handed in."""

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from vwnav.sim.px4.config import VehicleConfig
from vwnav.sim.px4.link import MavlinkLink
from vwnav.sim.px4.px4 import STEP_S, SimulatedPx4
from vwnav.sim.px4.session import Session
from vwnav.sim.px4.streams import Schedule

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Peer:
    """Whoever is at the other end of a link.

    Attributes:
        rates_hz: of the messages it gets by default, by their numbers.
        asks_time: whether TIMESYNC requests go to it (PX4 sends them to companions).
    """

    link: MavlinkLink
    rates_hz: dict[int, float]
    asks_time: bool


class VehicleCore:
    """A vehicle and its conversations.

    Args:
        clock: seconds, finer than the vehicle's steps; the vehicle boots now.

    Attributes:
        vehicle: another one after a reboot.
    """

    def __init__(
        self, config: VehicleConfig, peers: Sequence[Peer], clock: Callable[[], float]
    ) -> None:
        self._config = config
        self._peers = tuple(peers)
        self._clock = clock
        self._epoch_s = clock()
        self.vehicle = SimulatedPx4(config)
        self._sessions = self._open_sessions()

    @property
    def now_s(self) -> float:
        """Since its boot, by the clock; `vehicle.t_s` follows in steps."""
        return self._clock() - self._epoch_s

    @property
    def lag_s(self) -> float:
        """How far the vehicle is behind the clock."""
        return self.now_s - self.vehicle.t_s

    def wait(self, seconds: float) -> None:
        """Its time stands still for so long."""
        self._epoch_s += seconds

    def step(self) -> None:
        """Advance by `STEP_S`, hear and answer."""
        self.vehicle.step()
        self.hear()
        for session in self._sessions:
            session.say()

    def step_to_now(self, most: int) -> None:
        """Step until the vehicle's time is the clock's, `most` steps at once."""
        for _ in range(most):
            if self.vehicle.t_s + STEP_S > self.now_s:
                return
            self.step()

    def hear(self) -> None:
        """Handle all that has arrived, without stepping."""
        for session in self._sessions:
            session.hear()
        heard_s = max((peer.link.gcs_heard_s for peer in self._peers), default=-math.inf)
        self.vehicle.gcs_heard_s = heard_s if heard_s >= 0.0 else None
        if any(session.reboot_wanted for session in self._sessions):
            self.reboot()

    def _open_sessions(self) -> list[Session]:
        return [
            Session(
                peer.link,
                self.vehicle,
                Schedule(peer.rates_hz),
                lambda: self.now_s,
                peer.asks_time,
            )
            for peer in self._peers
        ]

    def reboot(self) -> None:
        """Start again with the parameters as they are."""
        _log.info("rebooting")
        self.vehicle = SimulatedPx4(self._config, self.vehicle.parameters)
        self._sessions = self._open_sessions()
        for peer in self._peers:
            peer.link.gcs_heard_s = -math.inf
        self._epoch_s = self._clock()
