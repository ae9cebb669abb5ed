"""A computer in simulated time: what work costs, how much of it there is, and when work ends.

Nothing here waits. Work is done at the moment at which it would have ended, so that a starved
processor, a slow search or a late image are changes of a table, and a run is the same each time.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from typing import Any


class SimulatedClock:
    """A clock that stands until it is set; call it for the time (s), like `time.monotonic`."""

    def __init__(self, now_s: float = 0.0) -> None:
        self.now_s = now_s

    def __call__(self) -> float:
        """The time now."""
        return self.now_s


@dataclass(slots=True, kw_only=True)
class Costs:
    """Seconds of work on an idle processor (a Raspberry Pi 5's, about); a scenario changes them.

    Attributes:
        link: one turn of the loop that talks with the autopilot.
        control: one tick of the mission.
        image: odometry of one image.
        match: an image on the map where it is thought to be.
        search: an image on the whole map.
    """

    link: float = 0.001
    control: float = 0.001
    image: float = 0.02
    match: float = 0.09
    search: float = 1.5


@dataclass(frozen=True, slots=True)
class Share:
    """From when on how much of the processor there is: 1 all of it, 0 none."""

    from_s: float
    share: float


class Processor:
    """Says when work ends; how much of it is to be had may be planned ahead.

    Each worker has a core of its own, as on the four of a Raspberry Pi: they compete with others'
    programs, not with each other.
    """

    def __init__(self) -> None:
        self._shares = [Share(float("-inf"), 1.0)]

    def starve(self, from_s: float, to_s: float, share: float) -> None:
        """Only so much of it from a time to another; plan in order of time."""
        self._shares += [Share(from_s, share), Share(to_s, 1.0)]

    def end_of(self, start_s: float, cost_s: float) -> float:
        """When work that starts then ends; it does not start while there is nothing to be had."""
        left_s, t_s = cost_s, start_s
        for share, until_s in self._spans(start_s):
            done_s = (until_s - t_s) * share
            if share > 0.0 and done_s >= left_s:
                return t_s + left_s / share
            left_s, t_s = left_s - done_s, until_s
        raise AssertionError("the last share has no end")

    def _spans(self, t_s: float) -> Iterator[tuple[float, float]]:
        """(share, its end) from a time on."""
        ends = [later.from_s for later in self._shares[1:]] + [float("inf")]
        for share, end_s in zip(self._shares, ends, strict=True):
            if end_s > t_s:
                yield share.share, end_s


class Worker:
    """A loop of a program: one piece of work after the other, each with its cost.

    Args:
        processor: where it runs.
        cost: seconds of the next piece.
        period_s: between two beginnings; after a stall it goes on from now, as a loop that sleeps
            until its next beat does.
    """

    def __init__(
        self, processor: Processor, cost: Callable[[], float], period_s: float, first_s: float
    ) -> None:
        self._processor = processor
        self._cost = cost
        self._period_s = period_s
        self._begin_s = first_s
        self._end_s: float | None = None

    def due(self, t_s: float) -> bool:
        """Whether a piece of work has ended now; to be called at every step."""
        if self._end_s is None:
            if t_s < self._begin_s:
                return False
            self._end_s = self._processor.end_of(t_s, self._cost())
        if t_s < self._end_s:
            return False
        self._begin_s = max(self._begin_s + self._period_s, self._end_s)
        self._end_s = None
        return True

    def sleep_until(self, t_s: float) -> None:
        """Stopped from outside: whatever it did goes on then."""
        self._begin_s = max(self._begin_s, t_s)
        if self._end_s is not None:
            self._end_s = max(self._end_s, t_s)


class LateFuture(Future[Any]):
    """Holds its result already, and says so only when its time has come."""

    def __init__(self, clock: SimulatedClock, ready_s: float) -> None:
        super().__init__()
        self._clock = clock
        self.ready_s = ready_s

    def done(self) -> bool:
        """Whether the simulated time of its end has passed."""
        return self._clock.now_s >= self.ready_s


class LateExecutor(Executor):
    """One thread of work in simulated time: a call is done at once, its result comes later.

    Args:
        cost: seconds of a call, by its arguments.

    Attributes:
        mistake: what becomes of a result, where the work goes wrong; None: it is right.
    """

    def __init__(
        self, clock: SimulatedClock, processor: Processor, cost: Callable[..., float]
    ) -> None:
        self._clock = clock
        self._processor = processor
        self._cost = cost
        self._newest: LateFuture | None = None
        self.mistake: Callable[[Any], Any] | None = None

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Call `fn`; the future tells what became of it when the work would have ended."""
        start_s = self._clock.now_s
        if self._newest is not None:
            start_s = max(start_s, self._newest.ready_s)
        end_s = self._processor.end_of(start_s, self._cost(*args, **kwargs))
        future = self._newest = LateFuture(self._clock, end_s)
        try:
            result = fn(*args, **kwargs)
            future.set_result(self.mistake(result) if self.mistake else result)
        except Exception as error:
            future.set_exception(error)
        return future

    def sleep_until(self, t_s: float) -> None:
        """Stopped from outside: what it works on ends no earlier."""
        if self._newest is not None:
            self._newest.ready_s = max(self._newest.ready_s, t_s)
