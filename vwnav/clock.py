"""Which time it is: the wall's, or a simulation's that waits for who is late (`vwnav.pace`).

All that flies is handed a `Clock`. On an aircraft it is the wall's; there nobody is waited for.
"""

import time
from collections.abc import Callable
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any, Protocol


class Participant(Protocol):
    """One who acts at times of its own; a simulated time waits for it when it is late."""

    def until(self, t_s: float) -> None:
        """Up to `t_s` time may pass without a further word."""
        ...

    def leave(self) -> None:
        """Nobody needs to wait for it, until its next word."""
        ...


class Clock(Protocol):
    """A monotonic time in seconds; call it for the time now."""

    @property
    def file(self) -> Path | None:
        """What another process opens to have the same time; None: it has it already."""
        ...

    def __call__(self) -> float:
        """The time now."""
        ...

    def wait_until(self, t_s: float) -> None:
        """Sleep until it is `t_s`; not at all when that has passed."""
        ...

    def join(self, name: str) -> Participant:
        """Take part: what `name` (16 ASCII characters) does must not be late."""
        ...


class Unawaited:
    """A `Participant` whom nobody waits for."""

    def until(self, t_s: float) -> None:
        """Time passes anyway."""

    def leave(self) -> None:
        """Nobody waited."""


class WallClock:
    """The monotonic clock of this machine."""

    file: Path | None = None

    def __call__(self) -> float:
        """The time now."""
        return time.monotonic()

    def wait_until(self, t_s: float) -> None:
        """Sleep until it is `t_s`."""
        time.sleep(max(0.0, t_s - time.monotonic()))

    def join(self, name: str) -> Participant:
        """Nobody waits for `name`."""
        return Unawaited()


class AwaitedExecutor(Executor):
    """Hands calls on to another executor, one at a time; time waits for one that takes long.

    Args:
        participant: who takes so long.
        usual_s: what a call may take before it is late.
    """

    def __init__(
        self, inner: Executor, clock: Clock, participant: Participant, usual_s: float
    ) -> None:
        self._inner = inner
        self._clock = clock
        self._participant = participant
        self._usual_s = usual_s

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Have `fn` called."""
        self._participant.until(self._clock() + self._usual_s)
        future = self._inner.submit(fn, *args, **kwargs)
        future.add_done_callback(lambda _: self._participant.leave())
        return future
