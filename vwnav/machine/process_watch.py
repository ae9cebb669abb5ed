"""Whether another process has ended, parent, child or neither, and an end put to it."""

import contextlib
import math
import os
import signal
from pathlib import Path

UNWINDS_S = 1.0  # of a killed one; it runs no more, whatever the system still holds of it
_CHECK_S = 0.1


class ProcessWatch:
    """Whether a process has ended; readable at once when it does, where the system can tell.

    Also a `watchdog.successor.NavigatorProcess`.

    Args:
        pid: of any process, parent or not.
    """

    def __init__(self, pid: int) -> None:
        self._pid = pid
        self._is_parent = os.getppid() == pid
        self._fd: int | None = None
        self._check_t_s = 0.0
        self._given_up_t_s = math.inf
        self._has_ended = False
        with contextlib.suppress(AttributeError, OSError):  # not Linux, an old one, or gone
            self._fd = os.pidfd_open(pid)

    @property
    def fd(self) -> int | None:
        """To be waited for; None where only asking helps."""
        return self._fd

    def has_ended(self, t_s: float) -> bool:
        """Whether it has; asks the system ten times a second."""
        if not self._has_ended and t_s - self._check_t_s >= _CHECK_S:
            self._check_t_s = t_s
            self._has_ended = not self._lives() or t_s >= self._given_up_t_s
        return self._has_ended

    def handle_readable(self) -> None:
        """Its descriptor became readable: it has ended."""
        self._has_ended = True

    def end(self) -> None:
        """Kill it, stopped or not."""
        if self._send(signal.SIGKILL):
            self._given_up_t_s = self._check_t_s + UNWINDS_S

    def ask_to_end(self) -> None:
        """Tell it to end, as a service is told."""
        self._send(signal.SIGTERM)

    def close(self) -> None:
        """Give the descriptor back."""
        if self._fd is not None:
            os.close(self._fd)
            self._fd = None

    def _send(self, number: signal.Signals) -> bool:
        """By its number alone, which may be another's by now, never."""
        with contextlib.suppress(OSError):  # it has just ended
            if self._fd is not None:
                signal.pidfd_send_signal(self._fd, number)
            elif self._is_parent and os.getppid() == self._pid:
                os.kill(self._pid, number)
            else:
                return False
            return True
        return False

    def _lives(self) -> bool:
        if _is_left_over(self._pid):
            return False
        if self._is_parent:
            return os.getppid() == self._pid
        try:
            os.kill(self._pid, 0)
        except ProcessLookupError:
            return False
        except PermissionError:
            return True
        return True


def _is_left_over(pid: int) -> bool:
    """Its first thread has ended: another one that waits for a disk keeps it from being gone."""
    with contextlib.suppress(OSError):  # gone, or not Linux
        # A name is cut within a letter: it is no text.
        return Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()[0] == b"Z"
    return False
