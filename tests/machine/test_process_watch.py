"""Processes that end, are ended, or are only held by the system any more."""

import platform
import subprocess
import sys
import time

import pytest

from vwnav.machine import process_watch
from vwnav.machine.process_watch import ProcessWatch


def test_who_is_not_our_parent_any_more_is_not_ended(monkeypatch):
    """Without a descriptor a number is all there is, and it may be another's by now."""
    monkeypatch.delattr(process_watch.os, "pidfd_open")
    with subprocess.Popen(["sleep", "60"]) as other:
        watch = ProcessWatch(other.pid)
        watch.end()
        assert not watch.has_ended(5.0)
        assert other.poll() is None
        other.kill()


def test_a_process_that_is_killed_counts_as_ended_though_the_system_still_holds_it(monkeypatch):
    """As one does that waits for a disk."""
    with subprocess.Popen(["sleep", "60"]) as other:
        watch = ProcessWatch(other.pid)
        monkeypatch.setattr(ProcessWatch, "_lives", lambda _: True)
        assert not watch.has_ended(10.0)
        watch.end()
        assert not watch.has_ended(10.5)
        assert watch.has_ended(11.2)
        watch.close()


@pytest.mark.parametrize("told", [True, False])
def test_the_end_of_a_process_that_is_no_parent_is_seen_too(told, monkeypatch):
    """Where the system cannot tell, it is asked."""
    if not told:
        monkeypatch.delattr(process_watch.os, "pidfd_open")
    with subprocess.Popen(["sleep", "60"]) as other:
        watch = ProcessWatch(other.pid)
        assert (watch.fd is not None) is told
        assert not watch.has_ended(1.0)
        other.kill()
        other.wait()
        assert watch.has_ended(2.0)
        watch.close()
    gone = ProcessWatch(other.pid)
    assert gone.has_ended(1.0)


LEFT_BEHIND = """
import ctypes, threading, time
threading.Thread(target=time.sleep, args=(60.0,)).start()
print(flush=True)
ctypes.CDLL(None).syscall({"x86_64": 60, "aarch64": 93}["MACHINE"], 0)
""".replace("MACHINE", platform.machine())


@pytest.mark.skipif(sys.platform != "linux", reason="threads of Linux")
def test_a_process_of_which_a_thread_is_left_that_waits_for_a_disk_has_ended():
    """The system tells its end when the last one has gone; killed, it does not run any more."""
    command = [sys.executable, "-c", LEFT_BEHIND]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        other.stdout.readline()
        time.sleep(0.3)
        watch = ProcessWatch(other.pid)
        assert other.poll() is None
        assert watch.has_ended(1.0)
        watch.close()
        other.kill()


NAMED = """
import ctypes, time
ctypes.CDLL(None).prctl(15, "weinberg-flüge-2026".encode()[:12], 0, 0, 0)
print(flush=True)
time.sleep(60.0)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="names of Linux")
def test_a_process_whose_name_the_system_has_cut_within_a_letter_lives():
    with subprocess.Popen([sys.executable, "-c", NAMED], stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        other.stdout.readline()
        watch = ProcessWatch(other.pid)
        assert not watch.has_ended(1.0)
        watch.close()
        other.kill()
