"""The watchdog that waits behind the one that guards, whoever else is left.

The one that guards starts it, and writes down what it knows ten times a second, in memory that both
have. Once it has died, or written nothing for two seconds, the spare one goes on from there: with
the same ports, the same aircraft in the same state, and a spare one of its own. That is as true
when the navigator has ended, and nobody else would land the aircraft.
"""

import logging
import mmap
import os
import select
import signal
import struct
import subprocess
import sys
import tempfile
import time
import zlib
from collections.abc import Callable, Sequence

from vwnav.machine.process_watch import ProcessWatch
from vwnav.machine.silence import Silence

_log = logging.getLogger(__name__)
PROGRAM = sys.executable, "-m", "vwnav.watchdog"
HANGS_S = 2.0  # without a word written
MOST_STARTS = 5
_PERIOD_S = 0.1
_FIRST_BACK_OFF_S = 0.25
_PAGE_BYTES = 1 << 16
_HEAD = struct.Struct("<QII")  # which one it is, its length, and a checksum of it


class LastWord:
    """What one process writes down and another one reads, the newest word alone.

    There are two pages, written in turns: a writer that is killed leaves one of them whole.

    Args:
        descriptor: of one that another process has made; None makes one.
    """

    def __init__(self, descriptor: int | None = None) -> None:
        self.descriptor = _memory() if descriptor is None else descriptor
        self._pages = mmap.mmap(self.descriptor, 2 * _PAGE_BYTES)
        self._number = 0

    def write(self, data: bytes) -> None:
        """Instead of what was written before.

        Raises:
            ValueError: it does not fit on a page.
        """
        if len(data) > _PAGE_BYTES - _HEAD.size:
            raise ValueError(f"{len(data)} bytes do not fit on a page")
        self._number += 1
        at = self._number % 2 * _PAGE_BYTES
        begin = at + _HEAD.size
        self._pages[begin : begin + len(data)] = data
        self._pages[at:begin] = _HEAD.pack(self._number, len(data), _checksum(self._number, data))

    def read(self) -> tuple[int, bytes]:
        """Which word it is, and the word; 0 and b"" where there is none yet."""
        return max(self._page(0), self._page(_PAGE_BYTES))

    def close(self) -> None:
        """Give it back; the other one keeps it."""
        self._pages.close()
        os.close(self.descriptor)

    def _page(self, at: int) -> tuple[int, bytes]:
        number, length, checksum = _HEAD.unpack_from(self._pages, at)
        begin = at + _HEAD.size
        data = self._pages[begin : begin + min(length, _PAGE_BYTES - _HEAD.size)]
        return (number, data) if _checksum(number, data) == checksum else (0, b"")


def _checksum(number: int, data: bytes) -> int:
    return zlib.crc32(data, number & 0xFFFFFFFF)


def _memory() -> int:
    """A descriptor of memory that has no name, and goes with the last one who has it."""
    if sys.platform == "linux":
        descriptor = os.memfd_create("vwnav watchdog")
    else:
        with tempfile.TemporaryFile() as file:
            descriptor = os.dup(file.fileno())
    os.truncate(descriptor, 2 * _PAGE_BYTES)
    return descriptor


class Spare:
    """The side of the one that guards: keeps a spare one, and tells it what it knows.

    Args:
        command: its command line, but for `--spare` and what follows that.
        starts_left: how many may still be started, by this one and by those that follow it.
    """

    def __init__(self, command: Sequence[str], starts_left: int) -> None:
        self._command, self._starts_left = list(command), starts_left
        self._word = LastWord()
        self._process: subprocess.Popen[bytes] | None = None
        self._start_at_s = self._write_at_s = 0.0
        self._back_off_s = _FIRST_BACK_OFF_S
        self._state: object = None

    @property
    def is_there(self) -> bool:
        """There is one, or will be."""
        return self._process is not None or self._starts_left > 0

    def step(self, known: Callable[[], bytes], state: object, t_s: float) -> None:
        """Tell it, and start another one where it has ended.

        Args:
            known: makes what is told.
            state: what of it is told at once when it changes.
            t_s: of the machine's clock.
        """
        if t_s >= self._write_at_s or state != self._state:
            self._write_at_s, self._state = t_s + _PERIOD_S, state
            self._word.write(known())
        if self._process is not None and self._process.poll() is not None:
            _log.warning("the spare watchdog has ended with code %d", self._process.returncode)
            self._process = None
        if self._process is None and self._starts_left > 0 and t_s >= self._start_at_s:
            self._start(t_s)

    def close(self) -> None:
        """We leave in good order, and nobody is to take our place: it has nothing to lose."""
        if self._process is not None:
            self._process.kill()
        self._word.close()

    def _start(self, t_s: float) -> None:
        self._starts_left -= 1
        self._start_at_s = t_s + self._back_off_s
        self._back_off_s *= 2.0
        told = ["--spare", str(os.getpid()), "--last-word", str(self._word.descriptor)]
        told += ["--starts-left", str(self._starts_left)]
        try:
            self._process = subprocess.Popen(
                [*self._command, *told], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                pass_fds=[self._word.descriptor], start_new_session=True,
            )  # fmt: skip
        except OSError as error:
            _log.error("the spare watchdog does not start: %s", error)


def wait_behind(pid: int, word: LastWord) -> bytes:
    """The side of the spare one: what the one before knew last, once it has ended or hangs.

    Args:
        pid: of that one, our parent.
        word: which it writes.
    """
    for each in (signal.SIGTERM, signal.SIGHUP):  # meant for the one that guards
        signal.signal(each, signal.SIG_IGN)
    guarding, silence = ProcessWatch(pid), Silence()
    ends = [] if guarding.fd is None else [guarding.fd]
    seen = 0
    while not guarding.has_ended(t_s := time.monotonic()):
        if select.select(ends, [], [], _PERIOD_S)[0]:
            break
        silence.listen(t_s)
        number, _ = word.read()
        if number != seen:
            seen = number
            silence.end()
        if silence.waking_s > HANGS_S and seen > 0:
            _log.warning("the watchdog has said nothing for %.0f s: it is ended", HANGS_S)
            silence.end()
            guarding.end()
    guarding.close()
    _, known = word.read()
    word.close()
    return known
