"""Who goes first on a busy processor: the watchdog, then the navigator, then everything else."""

import os
import sys

NICER = -5  # than who started it
_TURN_S = 0.0005


def take_short_turns() -> None:
    """Let no thread compute for over half a millisecond while another waits (Python's own: 5)."""
    sys.setswitchinterval(_TURN_S)


def go_first() -> bool:
    """Let this process, and what it starts, go before others; False where the system forbids it.

    It takes the right to (`CAP_SYS_NICE`, or a limit `RLIMIT_NICE`). All of a process' threads have
    to be raised, not those of the control loop alone: a thread of low priority that is held up by
    others holds what the control loop waits for. So call it before threads are started.
    """
    take_short_turns()
    try:
        os.nice(NICER)
    except PermissionError:
        return False
    return True
