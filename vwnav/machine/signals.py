"""What ends a program from outside, noted and not raised."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager

_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


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
