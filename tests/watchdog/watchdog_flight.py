"""A flight of processes: a navigator, its watchdog, and the autopilot that hears them."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from link_peer import IN_AIR, PX4_OFFBOARD, Peer, free_port, is_still, wait_for

HERE = Path(__file__).parent
SETPOINT, ESTIMATE = "SET_POSITION_TARGET_LOCAL_NED", "VISION_POSITION_ESTIMATE"


class Flight:
    """A navigator's process, its watchdog, and the autopilot that hears them."""

    def __init__(self, peer: Peer, process: subprocess.Popen, url: str) -> None:
        self.peer, self.process, self.url = peer, process, url
        assert process.stdout is not None
        self.watchdog = int(process.stdout.readline())
        peer.armed, peer.custom_mode, peer.landed_state = True, PX4_OFFBOARD, IN_AIR
        wait_for(lambda: len(peer.of(ESTIMATE)) > 30 and len(peer.of(SETPOINT)) > 30)

    def signal(self, number: int) -> float:
        self.process.send_signal(number)
        return time.monotonic()

    def first_still_s(self, since_s: float) -> float:
        """From then to the first zero velocity at the autopilot."""

        def first() -> float | None:
            found = [t for t, m in list(self.peer.heard) if t >= since_s and is_zero(m)]
            return found[0] - since_s if found else None

        return wait_for(first)

    def watchdog_lives(self) -> bool:
        return lives(self.watchdog)

    def all_watchdogs(self) -> dict[int, list[str]]:
        """Those on this link, with the words of their command lines."""
        found = {}
        for folder in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                words = (folder / "cmdline").read_bytes().decode().split("\0")
                if "vwnav.watchdog" in words and self.url in words and lives(int(folder.name)):
                    found[int(folder.name)] = words
        return found

    def guards(self) -> int:
        """The one that has the link: behind no other one that lives.

        One that is being started looks like the one that starts it, for a moment.
        """

        def behind_none() -> list[int]:
            found = self.all_watchdogs()
            pids = [pid for pid, words in found.items() if _behind(words) not in found]
            return pids if len(pids) == 1 else []

        return wait_for(behind_none)[0]

    def wait_for_a_spare(self) -> None:
        """It has loaded what it needs, and waits."""
        wait_for(lambda: len(self.all_watchdogs()) == 2, 10.0)
        time.sleep(2.0)


def _behind(words: list[str]) -> int:
    return int(words[words.index("--spare") + 1]) if "--spare" in words else 0


def is_zero(message) -> bool:
    return message.get_type() == SETPOINT and is_still(message)


def lives(pid: int) -> bool:
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False


def heed_interrupts() -> None:
    """As at a terminal: what a shell starts in the background ignores SIGINT."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@contextlib.contextmanager
def stalled_log() -> Iterator[int]:
    """A full pipe that nobody reads: who writes to it waits, as for a disk that stalls."""
    reads, writes = os.pipe()
    os.set_blocking(writes, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(writes, bytes(4096))
    os.set_blocking(writes, True)
    try:
        yield writes
    finally:
        os.close(reads)
        os.close(writes)


@contextlib.contextmanager
def flight(standby: list[str] | None = None, log: int | None = None) -> Iterator[Flight]:
    """One under way.

    Args:
        standby: command line of the successor.
        log: what navigator and watchdog have for their stderr; None is that of the test.
    """
    port = free_port()
    url = f"udpin://127.0.0.1:{port}"
    arguments = [url, *([json.dumps(standby)] if standby else [])]
    command = [sys.executable, str(HERE / "navigator.py"), *arguments]
    with (
        Peer(port) as peer,
        subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=log, preexec_fn=heed_interrupts
        ) as process,
    ):
        flying = Flight(peer, process, url)
        try:
            yield flying
        finally:
            with contextlib.suppress(ProcessLookupError):
                process.send_signal(signal.SIGCONT)
                process.kill()
            peer.armed = False
            wait_for(lambda: not flying.all_watchdogs(), 10.0)
