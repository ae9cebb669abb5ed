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
        discard: closes what was opened after it had been given up.
    """

    def __init__(
        self,
        make: Callable[[], Opened],
        close_lost: Callable[[], None] | None = None,
        discard: Callable[[Opened], None] | None = None,
    ) -> None:
        self._make = make
        self._close_lost = close_lost
        self._discard = discard
        self._opened: Opened | None = None
        self._given_up = threading.Event()
        self._runs = False
        self._start()

    def take(self) -> Opened | None:
        """What was opened, once; None before."""
        if not self._runs:
            self._start()
        if self._opened is None:
            return None
        opened, self._opened = self._opened, None
        return opened

    def give_up(self) -> None:
        """Nobody wants it any more."""
        self._given_up.set()
        self._throw_away()

    def _start(self) -> None:
        """Where memory is short there may be no thread: `take` asks again."""
        with contextlib.suppress(RuntimeError):
            threading.Thread(target=self._work, name="opener", daemon=True).start()
            self._runs = True

    def _work(self) -> None:
        if self._close_lost is not None:
            with contextlib.suppress(OSError):  # it is gone
                self._close_lost()
            self._given_up.wait(_AGAIN_S)
        while not self._given_up.is_set():
            try:
                self._opened = self._make()
            except (OSError, ValueError):
                self._given_up.wait(_AGAIN_S)
                continue
            if self._given_up.is_set():
                self._throw_away()
            return

    def _throw_away(self) -> None:
        opened, self._opened = self._opened, None
        if opened is not None and self._discard is not None:
            self._discard(opened)
