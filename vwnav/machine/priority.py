"""Who goes first on a busy processor: the watchdog, then the navigator, then everything else."""

import os
import sys

NICER = -5  # than who started it
_TURN_S = 0.0005


def go_first() -> bool:
    """Let this process, and what it starts, go before others; False where the system forbids it.

    It takes the right to (`CAP_SYS_NICE`, or a limit `RLIMIT_NICE`). All of a process' threads have
    to be raised, not those of the control loop alone: a thread of low priority that is held up by
    others holds what the control loop waits for. So call it before threads are started. Of its own
    threads none computes longer than half a millisecond when another one has something to do (5 ms
    is Python's own).
    """
    sys.setswitchinterval(_TURN_S)
    try:
        os.nice(NICER)
    except PermissionError:
        return False
    return True
