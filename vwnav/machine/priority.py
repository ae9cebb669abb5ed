"""Who goes first on a busy processor: the watchdog, then the navigator, then everything else."""

import atexit
import contextlib
import os
import sys
from pathlib import Path

NICER = -5  # than who started it
_TURN_S = 0.0005
_SESSION = Path("/proc/self/autogroup")


def take_short_turns() -> None:
    """Let no thread compute for over half a millisecond while another waits (Python's own: 5)."""
    sys.setswitchinterval(_TURN_S)


def go_first() -> bool:
    """Let this process, and what it starts, go before others; False where the system forbids it.

    It takes the right to (`CAP_SYS_NICE`, or a limit `RLIMIT_NICE`). All of a process' threads have
    to be raised, not those of the control loop alone: a thread of low priority that is held up by
    others holds what the control loop waits for. So call it before threads are started.

    Where the kernel shares time between sessions first (autogroups, sched(7)), the session is
    raised with it, until this process ends: nice alone tells apart what runs inside of one.
    """
    take_short_turns()
    try:
        os.nice(NICER)
    except PermissionError:
        return False
    _raise_session()
    return True


def _raise_session() -> None:
    with contextlib.suppress(OSError, ValueError):  # no such groups here, or it is in none
        *_, before = _SESSION.read_text().split()  # "/autogroup-25 nice 0", or nothing
        if int(before) > NICER:
            _SESSION.write_text(str(NICER))
            atexit.register(_leave_session, before)


def _leave_session(nice: str) -> None:
    with contextlib.suppress(OSError):
        _SESSION.write_text(nice)
