"""Whoever flies waits for no terminal and for no disk."""

import contextlib
import logging
import os
import pty
import signal
import subprocess
import sys
import time
import tty
from pathlib import Path

import pytest

from vwnav.machine.never_waits import NeverWaits, stderr_that_never_waits

MOST_S = 0.05


@contextlib.contextmanager
def terminal():
    """Its master, which nobody reads, and a stream of its other side."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    stream = os.fdopen(slave, "w")
    try:
        yield master, stream
    finally:
        os.close(master)
        with contextlib.suppress(OSError):
            stream.close()


def read_all(master: int, until: str) -> str:
    text = ""
    while until not in text:
        text += os.read(master, 65536).decode()
    return text


def put_all(stream: NeverWaits, texts) -> float:
    """The longest that one of them took."""
    longest_s = 0.0
    for text in texts:
        began_s = time.monotonic()
        stream.write(text)
        longest_s = max(longest_s, time.monotonic() - began_s)
    return longest_s


def test_a_terminal_that_is_not_read_makes_nobody_wait_and_says_what_it_lacks():
    with terminal() as (master, slow):
        stream = NeverWaits(slow)
        assert put_all(stream, (f"line {n} {80 * 'x'}\n" for n in range(5000))) < MOST_S
        text = read_all(master, "left out")
        lines = text.splitlines()
        written = sum(line.startswith("line ") for line in lines)
        assert 1000 <= written < 2000
        assert lines[:written] == [f"line {n} {80 * 'x'}" for n in range(written)]
        assert lines[written].startswith(f"{5000 - written} lines were left out")
        stream.write("goes on\n")
        assert read_all(master, "goes on\n").endswith("goes on\n")
        stream.close(1.0)


def test_of_a_line_that_is_rewritten_in_place_the_newest_waits_and_takes_nobodys_room():
    with terminal() as (master, slow):
        stream = NeverWaits(slow)
        put_all(stream, (500 * "x" + "\n" for _ in range(500)))  # more than a terminal holds
        assert put_all(stream, (f"\r\x1b[2K{n} s" for n in range(3000))) < MOST_S
        stream.write("\r\x1b[2Kan event\n3000 s")
        text = read_all(master, "3000 s")
        assert "left out" not in text
        assert [n for n in range(3000) if f"\r\x1b[2K{n} s" in text] == []
        assert text.endswith("\r\x1b[2Kan event\n3000 s")
        stream.close(1.0)


def test_the_end_of_the_program_waits_for_what_is_read_and_not_for_what_is_not():
    with terminal() as (master, slow):
        stream = NeverWaits(slow)
        stream.write("the last word\n")
        stream.close(5.0)
        assert os.read(master, 4096) == b"the last word\n"
        stream = NeverWaits(slow)
        put_all(stream, (500 * "x" + "\n" for _ in range(500)))
        began_s = time.monotonic()
        stream.close(0.3)
        assert 0.3 <= time.monotonic() - began_s < 0.6


def test_log_warnings_and_what_is_printed_go_the_same_way(capfd):
    with stderr_that_never_waits("vwnav: %(message)s"):
        print("printed", file=sys.stderr, end="")
        logging.getLogger("vwnav").warning("logged %d", 1)
        try:
            raise ValueError("broken on purpose")
        except ValueError:
            logging.getLogger("vwnav").exception("a step failed")
    said = capfd.readouterr().err.splitlines()
    assert said[:4] == [
        "printed", "vwnav: logged 1", "vwnav: a step failed", "Traceback (most recent call last):"
    ]  # fmt: skip
    assert said[-1] == "ValueError: broken on purpose"


def test_a_record_is_made_into_a_line_by_who_writes_it(monkeypatch):
    """A traceback reads its source lines, from a disk that may stall."""

    class Stalls:
        def __str__(self) -> str:
            time.sleep(0.3)
            return "slow"

    monkeypatch.setattr(logging.getLogger(), "handlers", [])  # those of pytest
    with stderr_that_never_waits():
        began_s = time.monotonic()
        logging.getLogger("vwnav").warning("%s", Stalls())
        assert time.monotonic() - began_s < MOST_S


FLIES = """
import sys, threading, time
from contextlib import ExitStack
from vwnav.machine.never_waits import stderr_that_never_waits
from vwnav.machine.priority import go_first
from vwnav.safety.check import Check
from vwnav.screen import LiveLine, ReadinessTable, say

go_first()  # as a flight does: what is measured is who waits, not who is held up by others
longest_s = {}

def loop(name, act):
    until_s = time.monotonic() + 3.0
    while time.monotonic() < until_s:
        began_s = time.monotonic()
        act()
        longest_s[name] = max(longest_s.get(name, 0.0), time.monotonic() - began_s)
        time.sleep(0.005)

with stderr_that_never_waits(), LiveLine() as line:
    acts = {
        "say": lambda: say("an event " + 200 * "x"),
        "line": lambda: line.show(time.monotonic(), "12.3 s on route " + 60 * "x"),
        "checks": lambda: ReadinessTable().show((Check("link", "PASS", "heard"),)),
    }
    threads = [threading.Thread(target=loop, args=each) for each in acts.items()]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
with open(sys.argv[1], "w") as told:
    told.write(repr(longest_s))
"""


@pytest.mark.parametrize("stops", ["Ctrl-S", "is never read"])
def test_a_terminal_that_stands_still_holds_up_no_thread_of_a_flight(tmp_path, stops):
    told = tmp_path / "longest"
    pid, master = pty.fork()
    if pid == 0:
        os.environ["TERM"] = "xterm"
        os.execv(sys.executable, [sys.executable, "-c", FLIES, str(told)])
    if stops == "Ctrl-S":
        os.read(master, 100)  # it has begun
        os.write(master, b"\x13")
    began_s = time.monotonic()
    while os.waitpid(pid, os.WNOHANG) == (0, 0):
        if time.monotonic() - began_s > 30.0:
            os.kill(pid, signal.SIGKILL)
        time.sleep(0.05)
    os.close(master)
    longest_s = eval(told.read_text())
    assert set(longest_s) == {"say", "line", "checks"}
    assert max(longest_s.values()) < MOST_S, longest_s


def test_a_program_whose_log_is_not_read_ends_all_the_same(tmp_path):
    """And well: the interpreter, ending, waits for whoever has its own stderr."""
    says = (
        "from vwnav.machine.never_waits import stderr_that_never_waits\n"
        "from vwnav.screen import say\n"
        "with stderr_that_never_waits():\n"
        "    for _ in range(2000):\n"
        "        say(100 * 'x')\n"
    )
    reads, writes = os.pipe()
    done = subprocess.run([sys.executable, "-c", says], stderr=writes, timeout=60.0)
    os.close(reads)
    os.close(writes)
    assert done.returncode == 0


def test_a_stderr_that_was_closed_before_is_left_as_it_is(tmp_path):
    says = (
        "import sys\n"
        "from vwnav.machine.never_waits import stderr_that_never_waits\n"
        "with stderr_that_never_waits(), open(sys.argv[1], 'w') as done:\n"
        "    done.write(str(sys.stderr))\n"
    )
    done: Path = tmp_path / "done"
    command = ["sh", "-c", 'exec "$@" 2>&-', "sh", sys.executable, "-c", says, str(done)]
    subprocess.run(command, timeout=60.0)
    assert done.read_text() == "None"
