"""A stderr that makes nobody wait: a terminal may stand still, and so may the disk of a log.

Ctrl-S, `| less`, a remote terminal out of reach, a card that stalls: a write to it comes back when
it goes on. Whoever flies or guards an aircraft hands over what it has to say, and one thread writes
it and waits. Nothing of Python's goes past it in flight: screen, log, warnings, tracebacks.
"""

import logging
import os
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, suppress
from typing import TextIO

_MOST_WAITING = 1000  # texts: a line of a log, or one of the screen's
_LEAVES_S = 2.0  # for what waits when the program ends


class NeverWaits:
    """A text stream in front of another one, to which a thread of its own writes.

    What does not fit any more is left out, all of it until what waits has been written, and then
    it is said how many lines that were. Of a line that is rewritten in place the newest waits. What
    cannot be written (a closed terminal, a full disk) is lost, and ends nothing.

    Args:
        stream: where it is written to, with a descriptor.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._waiting: deque[str | Callable[[], str]] = deque()
        self._left_out = 0
        self._in_line = self._closing = False
        self._news = threading.Condition()
        self._thread = threading.Thread(target=self._work, name="stderr", daemon=True)
        self._thread.start()

    def __getattr__(self, name: str) -> object:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Hand over a text."""
        self._put(text, text.count("\n"))
        return len(text)

    def write_later(self, line: Callable[[], str]) -> None:
        """Hand over a line that is made by the thread that writes it, and begins a new one."""
        self._put(line, 1)

    def flush(self) -> None:
        """Nobody waits for it."""

    def close(self, timeout_s: float) -> None:
        """Write what waits, as long as there is time."""
        with self._news:
            self._closing = True
            self._news.notify()
        self._thread.join(timeout_s)

    def _put(self, text: str | Callable[[], str], lines: int) -> None:
        with self._news:
            if self._waiting and _rewrites(text) and _is_rewritten(self._waiting[-1]):
                self._waiting.pop()
            if self._left_out or len(self._waiting) >= _MOST_WAITING:
                self._left_out += lines
            else:
                self._waiting.append(text)
            self._news.notify()

    def _work(self) -> None:
        while (text := self._next()) is not None:
            with suppress(OSError, ValueError):  # closed, since or before
                self._write_out(text)

    def _next(self) -> str | Callable[[], str] | None:
        with self._news:
            self._news.wait_for(lambda: self._waiting or self._left_out or self._closing)
            if self._waiting:
                return self._waiting.popleft()
            left_out, self._left_out = self._left_out, 0
        return (lambda: f"{left_out} lines were left out: they had to wait\n") if left_out else None

    def _write_out(self, text: str | Callable[[], str]) -> None:
        """Past Python's own buffer: the interpreter, when it ends, would wait for its lock."""
        if callable(text):
            text = "\n" * self._in_line + text()
        data = text.encode(self._stream.encoding, "backslashreplace")
        while data:
            data = data[os.write(self._stream.fileno(), data) :]
        self._in_line = not text.endswith("\n")


def _rewrites(text: str | Callable[[], str]) -> bool:
    return isinstance(text, str) and text.startswith("\r")


def _is_rewritten(text: str | Callable[[], str]) -> bool:
    """By what begins its line anew."""
    return isinstance(text, str) and text.startswith("\r") and "\n" not in text


class _LogHandler(logging.Handler):
    """Has records made into lines later, too: a traceback reads its source lines from the disk."""

    def __init__(self, stream: NeverWaits, form: str) -> None:
        super().__init__()
        self._stream = stream
        self.setFormatter(logging.Formatter(form))

    def emit(self, record: logging.LogRecord) -> None:
        """Hand it over."""
        self._stream.write_later(lambda: f"{self.format(record)}\n")


@contextmanager
def stderr_that_never_waits(log_form: str = "%(message)s") -> Iterator[None]:
    """From here on stderr and the log make nobody wait; at the end what waits has two seconds.

    Args:
        log_form: of a line of the log, as `logging` has it.
    """
    if sys.stderr is None:  # was closed before we started
        yield
        return
    stream, log = NeverWaits(sys.stderr), logging.getLogger()
    handler = _LogHandler(stream, log_form)
    log.addHandler(handler)
    try:
        with redirect_stderr(stream):
            yield
    finally:
        log.removeHandler(handler)
        stream.close(_LEAVES_S)
