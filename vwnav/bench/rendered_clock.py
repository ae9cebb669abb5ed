"""A flight in simulated time: its clock, matching that ends late, and a filter that is listened to.

Nothing here waits: the same flight gives the same results, however fast the machine is.
"""

import time
from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any

import numpy as np

from vwnav.bench.estimator_streams import Event
from vwnav.estimation.context import Ground
from vwnav.estimation.ekf import Ekf, EkfConfig, Innovation
from vwnav.estimation.inputs import Measurement


class SimulatedClock:
    """Time as the flight has it; who flies sets it."""

    def __init__(self) -> None:
        self.now_s = 0.0


class LateFuture(Future[Any]):
    """Holds its result already, and says so only when its time has come."""

    def __init__(self, clock: SimulatedClock, ready_s: float) -> None:
        super().__init__()
        self._clock = clock
        self._ready_s = ready_s

    def done(self) -> bool:
        """Whether the simulated time of its end has passed."""
        return self._clock.now_s >= self._ready_s


class LateExecutor(Executor):
    """Runs a call at once; its result comes later, by the simulated clock."""

    def __init__(
        self, clock: SimulatedClock, lateness_s: tuple[float, float], rng: np.random.Generator
    ) -> None:
        """`lateness_s`: between which times after the call its result comes, evenly drawn."""
        self._clock = clock
        self._lateness_s = lateness_s
        self._rng = rng

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Call `fn`; the future tells its result after the drawn time."""
        late_s = float(self._rng.uniform(*self._lateness_s))
        future = LateFuture(self._clock, self._clock.now_s + late_s)
        future.set_result(fn(*args, **kwargs))
        return future


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
        self.answers: list[tuple[Event, Innovation]] = []
        self.cost_s: list[float] = []

    def handle(self, seen: Measurement) -> Innovation:
        """As the filter does."""
        begin_s = time.process_time()
        answer = super().handle(seen)
        self.cost_s.append(time.process_time() - begin_s)
        self.answers.append((Event(self._clock.now_s, seen), answer))
        return answer
