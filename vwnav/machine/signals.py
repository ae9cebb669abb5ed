"""What ends a program from outside: in flight it is noted, elsewhere it is raised."""

import multiprocessing
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType

_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_ONE_END_S = 1.0  # signals so close together are one: the second would break off the clearing up


class Terminated(SystemExit):
    """A service was stopped, or a terminal closed: the exit code is the shell's for it.

    Args:
        number: of the signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__(128 + number)
        self.name = signal.Signals(number).name


def raise_signals() -> None:
    """From now on `kill` and a closed terminal raise `Terminated` in the main thread.

    So whoever clears up after Ctrl-C does it after these, too, and the processes that were started
    to share the work are told to end. One that we were started to ignore stays ignored.
    """
    last_s = -_ONE_END_S

    def end(number: int, _frame: FrameType | None) -> None:
        nonlocal last_s
        since_s, last_s = time.monotonic() - last_s, time.monotonic()
        if since_s >= _ONE_END_S:
            for each in multiprocessing.active_children():
                each.terminate()
            raise Terminated(number)

    for each in _ENDING[1:]:
        if signal.getsignal(each) is signal.SIG_DFL:
            signal.signal(each, end)


@contextmanager
def raised_signals() -> Iterator[None]:
    """`raise_signals` while it lasts, and a line on stderr that says which one it was."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {each: signal.getsignal(each) for each in _ENDING[1:]}
    raise_signals()
    try:
        yield
    except Terminated as ended:
        with suppress(OSError):  # of the terminal that was closed
            print(f"vwnav: ended by {ended.name}", file=sys.stderr)
        raise
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)


@contextmanager
def heeding_signals(heed: Callable[[], None]) -> Iterator[None]:
    """A service that is stopped, or a terminal that is closed, is heeded as Ctrl-C is.

    None of them raises: they come in twos (a terminal's shell sends SIGHUP, and so does the system,
    a millisecond later), and the second one would end the flight in the midst of the first. One
    that we were started to ignore (`nohup`, a shell's `&`) stays ignored.

    Args:
        heed: what they do; it only notes it.
    """
    heeded = [each for each in _ENDING if signal.getsignal(each) is not signal.SIG_IGN]
    before = {each: signal.signal(each, lambda *_: heed()) for each in heeded}
    try:
        yield
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)
