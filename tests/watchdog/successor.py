"""A second navigator: notes what it was woken with, sends estimates, and tries to fly.

    python successor.py NOTES [dies | stops | loads]

NOTES gets a line at the start, one when it is woken, one when it is told to end. The first one that
`stops` does so once it has sent some estimates. One that `loads` takes as long as that takes, and
notes its number when it is woken.
"""

import json
import os
import signal
import sys
import threading
import time
from pathlib import Path

from navigator import connect, estimate, setpoint

from vwnav.watchdog.keepalive import KeepAlive, UdpChannel

STOPS_AFTER = 25
LOADS_S = 4.0


def main() -> None:
    notes = Path(sys.argv[1])

    def note(text: str) -> None:
        with notes.open("a") as file:
            file.write(text + "\n")

    if sys.argv[2:] == ["loads"]:
        time.sleep(LOADS_S)
    note("started")
    line = sys.stdin.readline()
    if not line:
        note("not needed")
        return
    note(line.strip())
    if sys.argv[2:] == ["loads"]:
        note(f"serves {os.getpid()}")
    if sys.argv[2:] == ["dies"]:
        sys.exit(1)
    ended = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: ended.set())
    resume = json.loads(line)
    link, counter = connect(resume["connection"]), resume["position"]["reset_counter"] + 1
    keepalive = KeepAlive(UdpChannel(resume["keepalive_port"], listens=False), time.monotonic)
    is_first = notes.read_text().count("started") == 1
    while not ended.is_set():
        answered = keepalive.report.sequence if keepalive.report is not None else 0
        if sys.argv[2:] == ["stops"] and is_first and answered > STOPS_AFTER:
            os.kill(os.getpid(), signal.SIGSTOP)
        keepalive.beat(False, "pilot flies")
        link.send(estimate(time.monotonic(), 3.0, counter))
        link.send(setpoint(5.0))
        time.sleep(0.02)
    note("ended")


if __name__ == "__main__":
    main()
