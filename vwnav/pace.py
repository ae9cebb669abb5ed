"""A simulated time, shared by processes, that waits for a participant who lives and is late.

It runs with the wall clock, and stands while the least time that a participant has named
(`Participant.until`) is reached: on a machine that is fast enough it is the wall's, on a busy one
it is slower. One whose process has ended or was stopped is not waited for, and nobody longer than
`PATIENCE_S` of the wall clock; whoever was given up is waited for again from its next word on.

There is no master: all of them keep the time, in one small file. It holds the offset of the time
from the wall's monotonic clock, which only ever falls, and a slot for each participant.
"""

import contextlib
import fcntl
import math
import mmap
import os
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from vwnav.clock import Clock, WallClock

PATIENCE_S = 2.0
_SLOTS = 32
_NAME_BYTES = 16
_OFFSET, _COUNT = 0, 1  # cells of the header, 8 bytes each; then _SLOTS cells of each kind:
_DUE, _PID, _SINCE, _HELD = (2 + _SLOTS * kind for kind in range(4))
_NAMES_AT = 8 * (2 + 4 * _SLOTS)
_FILE_BYTES = _NAMES_AT + _NAME_BYTES * _SLOTS
_POLL_S = 0.001  # who waits for a time that stands looks again after so long
_ASK_EVERY_S = 0.01  # whether the process of one who is late still runs
_LOCK_PATIENCE_S = 0.05  # the one who has the lock may just have been stopped
_LOCK_POLL_S = 0.0002


class PacedClock:
    """The simulated time; a `vwnav.clock.Clock`. May be used from any thread.

    Args:
        path: file of the time, made by `create`.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._descriptor = os.open(path, os.O_RDWR)
        self._map = mmap.mmap(self._descriptor, _FILE_BYTES)
        self._cells: memoryview[float] = memoryview(self._map)[:_NAMES_AT].cast("d")
        self._threads = threading.Lock()
        self._lock_is_stuck = False
        self._asked_s = -math.inf
        self._latest_s = -math.inf

    @classmethod
    def create(cls) -> "PacedClock":
        """Begin a time, now the wall's, in a new file; `remove` it when all have ended."""
        descriptor, name = tempfile.mkstemp(prefix="vwnav-time-")
        os.truncate(descriptor, _FILE_BYTES)
        os.close(descriptor)
        clock = cls(Path(name))
        for number in range(_SLOTS):
            clock._cells[_DUE + number] = math.inf
        return clock

    @property
    def file(self) -> Path | None:
        """What another process opens to have the same time."""
        return self._path

    def remove(self) -> None:
        """Delete the file; those who have opened it keep their time."""
        self._path.unlink(missing_ok=True)

    def __call__(self) -> float:
        """The time now."""
        count = int(self._cells[_COUNT])
        due_s = min(self._cells[_DUE : _DUE + count], default=math.inf)
        t_s = time.monotonic() + self._cells[_OFFSET]
        if t_s > due_s:
            with self._alone():
                t_s = self._advance()
        self._latest_s = t_s = max(t_s, self._latest_s)
        return t_s

    def wait_until(self, t_s: float) -> None:
        """Sleep until it is `t_s`."""
        while (left_s := t_s - self()) > 0.0:
            time.sleep(max(left_s, _POLL_S))

    def join(self, name: str) -> "PacedParticipant":
        """Take part; waited for from its first word on."""
        with self._alone():
            number = int(self._cells[_COUNT])
            if number == _SLOTS:
                raise ValueError(f"more than {_SLOTS} take part in one simulated time")
            at = _NAMES_AT + _NAME_BYTES * number
            self._map[at : at + _NAME_BYTES] = name.encode()[:_NAME_BYTES].ljust(_NAME_BYTES, b"\0")
            self._cells[_PID + number] = os.getpid()
            self._cells[_COUNT] = number + 1
        return PacedParticipant(self, number)

    def held_s(self) -> dict[str, float]:
        """For how long it stood still, in seconds of the wall clock, and for whom."""
        held: dict[str, float] = {}
        for number in range(int(self._cells[_COUNT])):
            at = _NAMES_AT + _NAME_BYTES * number
            name = self._map[at : at + _NAME_BYTES].rstrip(b"\0").decode()
            held[name] = held.get(name, 0.0) + self._cells[_HELD + number]
        return held

    def set_due(self, number: int, t_s: float) -> None:
        """The next word of a participant: time may pass to `t_s`."""
        with self._alone():
            # Never before now: time does not go back to wait for who comes late.
            self._cells[_DUE + number] = max(t_s, self._advance())
            self._cells[_SINCE + number] = 0.0

    def _advance(self) -> float:
        """The time now; what the wall ran ahead while somebody was late is taken off for good."""
        cells, wall_s = self._cells, time.monotonic()
        t_s = wall_s + cells[_OFFSET]
        while True:
            late = min(range(_SLOTS), key=lambda number: cells[_DUE + number])
            due_s = cells[_DUE + late]
            if t_s <= due_s:
                return t_s
            since_s = cells[_SINCE + late] = cells[_SINCE + late] or wall_s - (t_s - due_s)
            if not self._runs(late, since_s, wall_s):
                cells[_DUE + late] = math.inf
                continue
            cells[_HELD + late] += t_s - due_s
            cells[_OFFSET], t_s = due_s - wall_s, due_s
            if wall_s - since_s <= PATIENCE_S:
                return t_s
            cells[_DUE + late] = math.inf

    def _runs(self, number: int, since_s: float, wall_s: float) -> bool:
        """Whether one who is late since `since_s` is there at all; looked up now and then."""
        pid = int(self._cells[_PID + number])
        if pid == os.getpid() or wall_s - max(since_s, self._asked_s) < _ASK_EVERY_S:
            return True
        self._asked_s = wall_s
        return _is_running(pid)

    @contextlib.contextmanager
    def _alone(self) -> Iterator[None]:
        """Nobody else changes the file; but one that was stopped meanwhile stops nobody."""
        with self._threads:
            locked = self._lock()
            self._lock_is_stuck = not locked
            try:
                yield
            finally:
                if locked:
                    fcntl.flock(self._descriptor, fcntl.LOCK_UN)

    def _lock(self) -> bool:
        end_s = time.monotonic() + _LOCK_PATIENCE_S
        while True:
            try:
                fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                if self._lock_is_stuck or time.monotonic() > end_s:
                    return False
                time.sleep(_LOCK_POLL_S)
            else:
                return True


class PacedParticipant:
    """A `vwnav.clock.Participant` of a `PacedClock`."""

    def __init__(self, clock: PacedClock, number: int) -> None:
        self._clock = clock
        self._number = number

    def until(self, t_s: float) -> None:
        """Up to `t_s` time may pass without a further word."""
        self._clock.set_due(self._number, t_s)

    def leave(self) -> None:
        """Nobody needs to wait for it, until its next word."""
        self._clock.set_due(self._number, math.inf)


def clock_of(file: str | Path) -> Clock:
    """The time kept in a file; the wall's for an empty name."""
    return PacedClock(Path(file)) if file else WallClock()


def _is_running(pid: int) -> bool:
    """Whether a process lives and was not stopped (proc(5): the state follows the name)."""
    try:
        os.kill(pid, 0)
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except ProcessLookupError:
        return False
    except (OSError, IndexError):  # not ours to ask, or a system that does not tell
        return True
    return state not in "TtZX"
