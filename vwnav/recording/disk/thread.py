"""What a flight writes: by a thread of its own, and so that it outlasts a power cut.

What is written lies in memory until the system hands it to the disk, half a minute later, and the
name of a new file longer still. `fsync` waits until it is there; on an SD card that takes tens of
milliseconds, now and then seconds.
"""

import os
import queue
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from time import monotonic

_ROUND_S = 0.1  # each thing by itself would take Python's lock from the threads that fly
SYNC_S = 0.6  # with a round it leaves 0.3 s for the disk: what is older than a second is there
_MOST_TIME_SYNCING = 0.5


class DiskThread:
    """Does what it is handed, in rounds and in order, and syncs it 0.7 s later at the latest.

    A disk that syncs slowly is asked less often: half of the time is left for writing.

    Args:
        name: of the thread.
        sync: makes what was done so far outlast a power cut; called at the start, too.
        failed: told what broke; nothing more is done then.
        first: done before all else: a file that is opened here makes nobody wait for the disk.
    """

    def __init__(
        self,
        name: str,
        sync: Callable[[], None],
        failed: Callable[[Exception], None],
        first: Callable[[], None] | None = None,
    ) -> None:
        self._sync = sync
        self._failed = failed
        self._first = first
        self._queue: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._finish, self._closing, self._wakes = sync, False, threading.Event()
        self._next_sync_s, self._is_synced = monotonic(), True
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    @property
    def waiting(self) -> int:
        """How much it has been handed and has not yet done."""
        return self._queue.qsize()

    def put(self, act: Callable[[], None], at_once: bool = False) -> None:
        """Hand it something to do; never waits. `at_once`: no round is awaited, it is large."""
        self._queue.put(act)
        if at_once:
            self._wakes.set()

    def close(self, finish: Callable[[], None], timeout_s: float) -> bool:
        """Let it do what is waiting, and `finish` last; whether it ended in time."""
        self._finish = finish
        self._closing = True
        self._wakes.set()
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _work(self) -> None:
        try:
            if self._first is not None:
                self._first()
            self._sync_now()
            while not self._closing:
                self._wakes.wait(_ROUND_S)
                self._wakes.clear()
                self._do_all()
            self._do_all()
            self._finish()
        except Exception as error:
            self._failed(error)

    def _do_all(self) -> None:
        """Do what has come, and sync it when it is time to."""
        while not self._queue.empty():
            self._queue.get()()
            self._is_synced = False
            self._sync_if_due()
        self._sync_if_due()

    def _sync_if_due(self) -> None:
        if not self._is_synced and monotonic() >= self._next_sync_s:
            self._sync_now()

    def _sync_now(self) -> None:
        start_s = monotonic()
        self._sync()
        self._is_synced = True
        spent_s = monotonic() - start_s
        self._next_sync_s = start_s + max(SYNC_S, spent_s / _MOST_TIME_SYNCING)


def sync_file(path: Path) -> None:
    """Wait until a file's content is on the disk.

    Raises:
        OSError: it is not there, or the disk failed.
    """
    with path.open("rb") as file:
        os.fsync(file.fileno())


def sync_names(folder: Path) -> None:
    """Wait until the names in a folder are on the disk, where the file system can do that."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def replace_for_good(partial: Path, path: Path) -> None:
    """Give a file its name once its content is on the disk: after a power cut it is whole or none.

    Raises:
        OSError: the disk failed.
    """
    sync_file(partial)
    partial.replace(path)
    sync_names(path.parent)


def make_folder(folder: Path) -> None:
    """Make a folder, and those above it that are missing, with names that outlast a power cut.

    Raises:
        OSError: it cannot be made.
    """
    missing = [each for each in (folder, *folder.parents) if not each.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    for each in reversed(missing):
        sync_names(each.parent)
