"""The processes of a flight of `vwnav fly`, found by their command lines."""

import contextlib
import os
import signal
import threading
from pathlib import Path

_STOPPED = "T"


def watchdogs_of(navigator: int) -> dict[int, bool]:
    """Process ids of all watchdogs of a navigator, and whether each was started as a spare one."""
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            words = (folder / "cmdline").read_bytes().split(b"\0")
            if b"vwnav.watchdog" in words and str(navigator).encode() in words:
                found[int(folder.name)] = b"--spare" in words
    return found


def guarding(navigator: int) -> int | None:
    """The watchdog that has the link, or will have it: the first, then each spare one in turn."""
    awake = {pid: spare for pid, spare in watchdogs_of(navigator).items() if _is_awake(pid)}
    return min(awake, key=lambda pid: (awake[pid], _started(pid)), default=None)


def send(number: signal.Signals, pid: int | None) -> None:
    """A signal to a process that may have ended."""
    if pid is not None:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, number)


def stop_for(seconds: float, pid: int) -> None:
    """Stopped, and let go on later."""
    send(signal.SIGSTOP, pid)
    threading.Timer(seconds, send, (signal.SIGCONT, pid)).start()


def _is_awake(pid: int) -> bool:
    fields = _stat(pid)
    return bool(fields) and fields[0] != _STOPPED


def _started(pid: int) -> int:
    fields = _stat(pid)
    return int(fields[19]) if fields else 0


def _stat(pid: int) -> list[str]:
    """From the state on, see proc(5): empty when it is gone."""
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return []
