"""The successor's process: started early, woken when the navigator has ended.

It loads what it needs and then waits for a line on its stdin. The line is one JSON object: where
to connect and to beat, and the last good estimate (`Resume`). An end of stdin tells it to end: the
watchdog has gone, or needs it no more. One that hangs is ended, and another one started.
"""

import contextlib
import json
import logging
import subprocess
from collections.abc import Sequence
from dataclasses import asdict

from vwnav.watchdog.dead_man import Silence
from vwnav.watchdog.loop import Resume

_log = logging.getLogger(__name__)
_MOST_STARTS = 5
_FIRST_BACK_OFF_S = 1.0
_END_TIMEOUT_S = 2.0
_COMES_UP_S = 20.0  # from its waking to its first beat: it may be loading still
_SILENT_S = 4.0  # no other one has loaded yet: longer than a navigator may be


class SuccessorProcess:
    """A `Successor` in a process of its own.

    Args:
        command: its command line.
        navigator_url: what it connects to.
        observer_url: where it may listen along; see `WatchdogProcess`.
        keepalive_port: where it beats.
    """

    def __init__(
        self, command: Sequence[str], navigator_url: str, observer_url: str, keepalive_port: int
    ) -> None:
        self._command = list(command)
        self._ways = {
            "connection": navigator_url,
            "observer": observer_url,
            "keepalive_port": keepalive_port,
        }
        self._process: subprocess.Popen[bytes] | None = None
        self._starts = 0
        self._start_at_s = 0.0
        self._woken = self._has_beaten = False
        self._silence = Silence()

    @property
    def stands_by(self) -> bool:
        """There is one that could be woken."""
        return self._process is not None and not self._woken

    def handle_beat(self) -> None:
        """It lives."""
        self._silence.end()
        self._has_beaten = True

    def step(self, resume: Resume | None, t_s: float) -> None:
        """Keep it ready; with `resume` it is needed, from now on."""
        self._silence.listen(t_s)
        if self._process is not None and self._process.poll() is not None:
            _log.warning("the successor ended with code %d", self._process.returncode)
            self._forget(t_s)
        if self._process is not None and self._woken:
            self._end_if_silent(self._process)
        if self._process is None and self._starts < _MOST_STARTS and t_s >= self._start_at_s:
            self._start(t_s)
        if resume is not None and self._process is not None and not self._woken:
            self._wake(self._process, resume)

    def close(self) -> None:
        """End it: its stdin ends, then it is told to, then killed."""
        process, self._process = self._process, None
        if process is None:
            return
        _close_stdin(process)
        for end in (process.terminate, process.kill):
            try:
                process.wait(_END_TIMEOUT_S)
                return
            except subprocess.TimeoutExpired:
                end()
        process.wait()

    def _start(self, t_s: float) -> None:
        self._starts += 1
        self._woken = self._has_beaten = False
        try:
            self._process = subprocess.Popen(
                self._command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL
            )
        except OSError as error:
            _log.error("the successor does not start: %s", error)
            self._forget(t_s)

    def _forget(self, t_s: float) -> None:
        """The next one is started after a while, a longer one each time."""
        if self._process is not None:
            _close_stdin(self._process)
        self._process = None
        self._start_at_s = t_s + _FIRST_BACK_OFF_S * 2.0 ** (self._starts - 1)

    def _end_if_silent(self, process: subprocess.Popen[bytes]) -> None:
        limit_s = _SILENT_S if self._has_beaten else _COMES_UP_S
        if self._silence.waking_s > limit_s:
            self._silence.end()
            _log.warning("the successor has been silent for %.0f s: it is ended", limit_s)
            process.kill()

    def _wake(self, process: subprocess.Popen[bytes], resume: Resume) -> None:
        self._woken = True
        self._silence.end()
        assert process.stdin is not None
        line = json.dumps({**self._ways, **asdict(resume)}) + "\n"
        with contextlib.suppress(OSError):  # it has ended: the next step sees it
            process.stdin.write(line.encode())  # less than a pipe holds: does not wait
            process.stdin.flush()


def _close_stdin(process: subprocess.Popen[bytes]) -> None:
    assert process.stdin is not None
    with contextlib.suppress(OSError):
        process.stdin.close()
