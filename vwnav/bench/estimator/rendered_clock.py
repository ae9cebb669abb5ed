"""The filter of a flight in simulated time, listened to."""

import time

from vwnav.bench.estimator.streams import MeasurementEvent
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.context import Ground
from vwnav.estimation.ekf import Ekf
from vwnav.estimation.inputs import Measurement
from vwnav.estimation.kalman import Innovation
from vwnav.sim.clock import SimulatedClock


class HeardEkf(Ekf):
    """The filter itself; what it is told, and what it says of it, is written down.

    Attributes:
        answers: each measurement with the innovation, in order of arrival.
        cost_s: processor time of each.
    """

    def __init__(
        self, config: EkfConfig, ground: Ground | None = None, *, clock: SimulatedClock
    ) -> None:
        super().__init__(config, ground)
        self._clock = clock
        self.answers: list[tuple[MeasurementEvent, Innovation]] = []
        self.cost_s: list[float] = []

    def handle(self, seen: Measurement) -> Innovation:
        """As the filter does."""
        begin_s = time.process_time()
        answer = super().handle(seen)
        self.cost_s.append(time.process_time() - begin_s)
        self.answers.append((MeasurementEvent(self._clock.now_s, seen), answer))
        return answer
