"""What may take seconds to open, opened beside whoever must not wait for it.

A name is looked up for half a minute where the network is down, a connection to a far end that is
off takes as long, and a serial port that is closed may wait for what it has not yet sent.
"""

import contextlib
import threading
from collections.abc import Callable
from typing import Generic, TypeVar

Opened = TypeVar("Opened")
_AGAIN_S = 1.0


class Opener(Generic[Opened]):
    """A thread that opens once a second until it succeeds.

    Args:
        make: opens. OSError and ValueError mean that it cannot be opened now.
        close_lost: closes what was lost, before; what was lost is opened a second later.
    """

    def __init__(
        self, make: Callable[[], Opened], close_lost: Callable[[], None] | None = None
    ) -> None:
        self._make = make
        self._close_lost = close_lost
        self._opened: Opened | None = None
        self._given_up = threading.Event()
        threading.Thread(target=self._work, name="opener", daemon=True).start()

    def take(self) -> Opened | None:
        """What was opened, once; None before."""
        if self._opened is None:
            return None
        opened, self._opened = self._opened, None
        return opened

    def give_up(self) -> None:
        """Nobody wants it any more."""
        self._given_up.set()

    def _work(self) -> None:
        if self._close_lost is not None:
            with contextlib.suppress(OSError):  # it is gone
                self._close_lost()
            self._given_up.wait(_AGAIN_S)
        while not self._given_up.is_set():
            try:
                self._opened = self._make()
                return
            except (OSError, ValueError):
                self._given_up.wait(_AGAIN_S)
