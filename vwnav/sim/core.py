"""The simulated vehicle with whoever talks to it, stepped by a clock that is handed in."""

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum

from vwnav.sim.config import VehicleConfig
from vwnav.sim.copter import messages as copter_messages
from vwnav.sim.copter.copter import SimulatedCopter
from vwnav.sim.copter.session import CopterSession
from vwnav.sim.mavlink.link import MavlinkLink
from vwnav.sim.multirotor.simulated import STEP_S
from vwnav.sim.px4 import estimate_messages, messages
from vwnav.sim.px4 import streams as px4_streams
from vwnav.sim.px4.px4 import SimulatedPx4
from vwnav.sim.px4.session import Px4Session

_log = logging.getLogger(__name__)

Vehicle = SimulatedPx4 | SimulatedCopter
Session = Px4Session | CopterSession
PX4_BUILDERS = messages.BUILDERS | estimate_messages.BUILDERS


class Role(Enum):
    """Of whoever is at the other end of a link: it decides what is sent unasked."""

    COMPANION = "companion"
    GROUND = "ground station"
    TRUTH = "reader of the truth"


@dataclass(frozen=True, slots=True)
class Peer:
    """Whoever is at the other end of a link."""

    link: MavlinkLink
    role: Role


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
        self.vehicle = _boot(config, None)
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
        return [_open(peer, self.vehicle, lambda: self.now_s) for peer in self._peers]

    def reboot(self) -> None:
        """Start again with the parameters as they are."""
        _log.info("rebooting")
        self.vehicle = _boot(self._config, self.vehicle)
        self._sessions = self._open_sessions()
        for peer in self._peers:
            peer.link.gcs_heard_s = -math.inf
        self._epoch_s = self._clock()


def _boot(config: VehicleConfig, before: Vehicle | None) -> Vehicle:
    """A vehicle of the configured manners, with the parameters of the one before."""
    if config.manners == "copter":
        kept = before.parameters if isinstance(before, SimulatedCopter) else None
        return SimulatedCopter(config, kept)
    return SimulatedPx4(config, before.parameters if isinstance(before, SimulatedPx4) else None)


def _open(peer: Peer, vehicle: Vehicle, clock: Callable[[], float]) -> Session:
    """The conversation that a vehicle has with a peer."""
    truth_hz = vehicle.config.truth_rate_hz
    if isinstance(vehicle, SimulatedCopter):
        is_truth = peer.role is Role.TRUTH
        rates_hz = copter_messages.truth_rates(truth_hz) if is_truth else copter_messages.UNASKED_HZ
        return CopterSession(peer.link, vehicle, copter_messages.schedule_of(rates_hz), clock)
    rates_hz = {
        Role.COMPANION: px4_streams.COMPANION_RATES,
        Role.GROUND: px4_streams.GROUND_RATES,
        Role.TRUTH: px4_streams.truth_rates(truth_hz),
    }[peer.role]
    asks_time = peer.role is Role.COMPANION
    schedule = px4_streams.schedule_of(rates_hz, PX4_BUILDERS)
    return Px4Session(peer.link, vehicle, schedule, clock, asks_time)
