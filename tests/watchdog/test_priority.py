"""Navigator and watchdog go before what else a machine has to do, where they may."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from link_peer import free_port

from vwnav.machine.priority import NICER
from vwnav.watchdog.launch import start_watchdog

SESSION = "/proc/self/autogroup"
PROGRAM = """
import os, resource, sys, threading
from vwnav.machine.priority import go_first
{before}
raised, told = go_first(), []
thread = threading.Thread(target=lambda: told.append(os.nice(0)))
thread.start()
thread.join()
print(raised, told[0], sys.getswitchinterval())
"""
WITHOUT_THE_RIGHT = """
resource.setrlimit(resource.RLIMIT_NICE, (0, 0))
if os.getuid() == 0:
    os.setuid(65534)
"""


def answer(before: str = "") -> list[str]:
    program = PROGRAM.format(before=before)
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    return run.stdout.split()


@pytest.fixture
def may_go_first() -> None:
    if answer()[0] == "False":
        pytest.skip("nothing may go first here")


@pytest.mark.usefixtures("may_go_first")
def test_threads_started_later_go_first_too():
    raised, nice, turn_s = answer()
    assert (raised, int(nice)) == ("True", os.nice(0) + NICER)
    assert float(turn_s) < 0.001


@pytest.mark.usefixtures("may_go_first")
def test_its_session_goes_before_others_while_it_lives():
    """Where the kernel shares time between sessions first, nice says nothing to another one's."""
    if not Path(SESSION).exists():
        pytest.skip("the kernel knows no autogroups")
    inside = (
        f"from vwnav.machine.priority import go_first; go_first(); print(open({SESSION!r}).read())"
    )
    shell = ["sh", "-c", f'"{sys.executable}" -c "$0"; cat {SESSION}', inside]
    run = subprocess.run(shell, capture_output=True, text=True, start_new_session=True)
    nice = [line.split()[-1] for line in run.stdout.splitlines() if line]
    assert nice == [str(NICER), "0"], run.stderr


@pytest.mark.usefixtures("may_go_first")
@pytest.mark.parametrize("told", ["", "/autogroup-25 nice\n", None])
def test_who_is_in_no_session_of_the_kernels_flies_as_it_is(told, tmp_path):
    """Of what the system's first process started, without a session of its own, it says nothing."""
    if told is not None:
        (tmp_path / "autogroup").write_text(told)
    session = (
        f"import vwnav.machine.priority as p; p._SESSION = p.Path({str(tmp_path)!r}, 'autogroup')"
    )
    assert answer(before=session)[0] == "True"


def test_without_the_right_it_flies_as_it_is():
    assert answer(before=WITHOUT_THE_RIGHT)[:2] == ["False", str(os.nice(0))]


@pytest.mark.usefixtures("may_go_first")
def test_the_watchdog_goes_before_who_started_it(tmp_path: Path):
    with start_watchdog(f"udpin://127.0.0.1:{free_port()}", tmp_path / "log") as watchdog:
        nice = os.getpriority(os.PRIO_PROCESS, watchdog.process.pid)
    assert nice == os.nice(0) + NICER < os.nice(0)
