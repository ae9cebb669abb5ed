"""The successors' processes: one is always loaded and waits, woken when whoever served has ended.

It loads what it needs and then waits for a line on its stdin. The line is one JSON object: where
to connect and to beat, and the last good estimate (`Resume`). An end of stdin tells it to end: the
watchdog has gone, or needs it no more. One that hangs is ended. As soon as one serves, the next is
prepared: an autopilot keeps its position for 5 s without estimates, and loading takes longer.
A first navigator that lives and is of no use is ended for them (`UselessNavigator`).
"""

import contextlib
import json
import logging
import math
import os
import subprocess
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import IO, Protocol

from vwnav.machine.process_watch import UNWINDS_S, ProcessWatch
from vwnav.machine.silence import Silence
from vwnav.vehicle import Learned
from vwnav.watchdog.relay_guard import RelayedPosition
from vwnav.watchdog.voice import Origin

_log = logging.getLogger(__name__)
_MOST_STARTS = 5
_FIRST_BACK_OFF_S = 1.0
_END_TIMEOUT_S = 2.0
_LOOKS_EVERY_S = 0.05
_COMES_UP_S = 20.0  # from its waking to its first beat: it may be loading still
# Neither a beat nor an estimate to hand on, of the first one or of one after it. It gets the
# aircraft back no more then, and 5 s later the next one tells the place: before ArduCopter gives
# its own up, 8 s after the last estimate (measured).
_SILENT_S = 3.0
_LEAVES_WITHIN_S = 1.0  # after its word that it ends: it has the camera, its files are synced
_NICER = 5  # one that loads goes behind one that serves


@dataclass(frozen=True, slots=True)
class Resume:
    """What a successor of the navigator begins with.

    Attributes:
        position, velocity_ne_m_s: the last good ones that it was given; None where there were none.
        origin: of the position; None when the autopilot never told it.
        learned: by the navigator that ended; None where it was not enough.
        system_id: of the autopilot.
    """

    position: RelayedPosition | None
    velocity_ne_m_s: tuple[float, float]
    origin: Origin | None
    learned: Learned | None = None
    system_id: int = 0


class Successor(Protocol):
    """A second navigator that gives the autopilot estimates when the first one has ended."""

    @property
    def stands_by(self) -> bool:
        """There is one that could be woken."""
        ...

    def step(self, resume: Resume | None, t_s: float) -> None:
        """Keep it ready; with `resume` it is needed, from now on."""
        ...

    def handle_beat(self) -> None:
        """It lives."""
        ...

    def close(self) -> None:
        """End it."""
        ...


class UselessNavigator:
    """When the first one's process is to be ended: for how long it has been of no use, in flight.

    Only time counts in which we listened.

    Attributes:
        gone: there is nobody to be ended.
    """

    def __init__(self) -> None:
        self._silence = Silence()
        self._ends_s: float | None = None
        self.gone = False

    def listen(self, t_s: float) -> None:
        """Time passes."""
        self._silence.listen(t_s)

    def heard(self) -> None:
        """It has beaten, or told a place that was handed on."""
        self._silence.end()

    def says_it_ends(self, t_s: float) -> None:
        """Nothing comes from it any more."""
        self._ends_s = t_s

    def has_ended(self) -> None:
        """There is nobody to be ended."""
        self.gone = True

    def reason_to_end(self, t_s: float) -> str:
        """Why it is to be ended now, "" when it is not; after the word that it ends, once."""
        if self.gone:
            return ""
        if self._ends_s is not None:
            self.gone = t_s - self._ends_s >= _LEAVES_WITHIN_S
            return "has not come to its end" if self.gone else ""
        if self._silence.waking_s < _SILENT_S:
            return ""
        self._silence.end()
        return f"has neither beaten nor told a place for {_SILENT_S:.0f} s"


class NavigatorProcess(Protocol):
    """What the navigator runs in."""

    def end(self) -> None:
        """End it at once, hanging or stopped."""
        ...


class SuccessorProcess:
    """A `Successor` in a process of its own.

    Args:
        command: its command line.
        navigator_url: what it connects to.
        observer_url: where it may listen along; see `WatchdogProcess`.
        keepalive_port: where it beats.
        serving: number of the process that serves already, begun by a watchdog that has died.
    """

    def __init__(
        self, command: Sequence[str], navigator_url: str, observer_url: str, keepalive_port: int,
        serving: int | None = None,
    ) -> None:  # fmt: skip
        self._command = list(command)
        self._ways = {
            "connection": navigator_url,
            "observer": observer_url,
            "keepalive_port": keepalive_port,
        }
        self._ready: subprocess.Popen[bytes] | None = None
        self._serving: subprocess.Popen[bytes] | _Adopted | None = None
        if serving is not None:
            self._serving = _Adopted(serving)
        self._starts = 0
        self._start_at_s = 0.0
        self._has_beaten = False
        self._given_up_t_s = math.inf
        self._silence = Silence()

    @property
    def stands_by(self) -> bool:
        """There is one that could be woken."""
        return self._ready is not None

    @property
    def serving(self) -> int | None:
        """Number of the process that serves."""
        return None if self._serving is None else self._serving.pid

    def handle_beat(self) -> None:
        """The one that serves lives."""
        self._silence.end()
        self._has_beaten = True

    def step(self, resume: Resume | None, t_s: float) -> None:
        """Keep one ready; with `resume` one is needed, from now on."""
        self._silence.listen(t_s)
        if self._has_ended(self._ready, t_s):
            self._ready = None
        if self._has_ended(self._serving, t_s) or t_s >= self._given_up_t_s:
            self._serving = None
        if self._serving is not None:
            self._end_if_silent(self._serving, t_s)
        if self._wants_another and t_s >= self._start_at_s:
            self._start(t_s)
        if resume is not None and self._serving is None and self._ready is not None:
            self._wake(self._ready, resume)

    def close(self) -> None:
        """End them: their stdin ends, then they are told to, then killed."""
        ours = [each for each in (self._ready, self._serving) if each is not None]
        self._ready = self._serving = None
        for process in ours:
            _close_stdin(process)
        for process in ours:
            _end(process)

    @property
    def _wants_another(self) -> bool:
        """Not while the last one comes up: it has the place to find."""
        comes_up = self._serving is not None and not self._has_beaten
        return self._ready is None and not comes_up and self._starts < _MOST_STARTS

    def _has_ended(self, process: "subprocess.Popen[bytes] | _Adopted | None", t_s: float) -> bool:
        if process is None or process.poll() is None:
            return False
        _log.warning("the successor ended with code %d", process.returncode)
        _close_stdin(process)
        self._back_off(t_s)
        return True

    def _start(self, t_s: float) -> None:
        self._starts += 1
        try:
            self._ready = subprocess.Popen(
                self._command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL
            )
        except OSError as error:
            _log.error("the successor does not start: %s", error)
            self._back_off(t_s)
            return
        if self._serving is not None:
            _go_behind(self._ready)

    def _back_off(self, t_s: float) -> None:
        """The next one is started after a while, a longer one each time."""
        self._start_at_s = t_s + _FIRST_BACK_OFF_S * 2.0 ** (self._starts - 1)

    def _end_if_silent(self, process: "subprocess.Popen[bytes] | _Adopted", t_s: float) -> None:
        limit_s = _SILENT_S if self._has_beaten else _COMES_UP_S
        if self._silence.waking_s > limit_s:
            self._silence.end()
            _log.warning("the successor has been silent for %.0f s: it is ended", limit_s)
            process.kill()
            self._given_up_t_s = t_s + UNWINDS_S

    def _wake(self, process: subprocess.Popen[bytes], resume: Resume) -> None:
        self._serving, self._ready = process, None
        self._has_beaten, self._given_up_t_s = False, math.inf
        self._silence.end()
        assert process.stdin is not None
        line = json.dumps({**self._ways, **asdict(resume)}) + "\n"
        with contextlib.suppress(OSError):  # it has ended: the next step sees it
            process.stdin.write(line.encode())  # less than a pipe holds: does not wait
            process.stdin.flush()


class _Adopted:
    """A process that is no child of ours, as far as it is used as one."""

    stdin: IO[bytes] | None = None

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self.returncode = -1  # nobody is told it
        self._watch = ProcessWatch(pid)

    def poll(self) -> int | None:
        """None while it lives."""
        return self.returncode if self._watch.has_ended(time.monotonic()) else None

    def kill(self) -> None:
        """End it at once."""
        self._watch.end()

    def terminate(self) -> None:
        """Tell it to end."""
        self._watch.ask_to_end()

    def wait(self, timeout: float) -> int:
        """Until it has ended.

        Raises:
            subprocess.TimeoutExpired: it has not.
        """
        until_s = time.monotonic() + timeout
        while (code := self.poll()) is None:
            if time.monotonic() > until_s:
                raise subprocess.TimeoutExpired(str(self.pid), timeout)
            time.sleep(_LOOKS_EVERY_S)
        return code


def _close_stdin(process: subprocess.Popen[bytes] | _Adopted) -> None:
    if process.stdin is None:
        return
    with contextlib.suppress(OSError):
        process.stdin.close()


def _end(process: subprocess.Popen[bytes] | _Adopted) -> None:
    for end in (process.terminate, process.kill):
        try:
            process.wait(_END_TIMEOUT_S)
            return
        except subprocess.TimeoutExpired:
            end()
    with contextlib.suppress(subprocess.TimeoutExpired):  # held by the system: it runs no more
        process.wait(_END_TIMEOUT_S)


def _go_behind(process: subprocess.Popen[bytes]) -> None:
    """Threads that it starts from now on as well, and for good: to go back takes a right."""
    with contextlib.suppress(OSError):  # it has ended: the next step sees it
        own = os.getpriority(os.PRIO_PROCESS, 0)
        os.setpriority(os.PRIO_PROCESS, process.pid, own + _NICER)
