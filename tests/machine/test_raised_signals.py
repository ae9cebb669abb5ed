"""Commands that fly nothing clear up after `kill` and a closed terminal, too."""

import os
import signal
import subprocess
import sys

import pytest

ENDS = [signal.SIGTERM, signal.SIGHUP]
WORKS = """
import os, signal, sys, time
from concurrent.futures import ProcessPoolExecutor
import multiprocessing
from vwnav.machine.signals import raise_signals, raised_signals

if __name__ == "__main__":
    with raised_signals():
        try:
            if sys.argv[1] == "alone":
                print("works", flush=True)
                time.sleep(20.0)
            else:
                context = multiprocessing.get_context("spawn")
                with ProcessPoolExecutor(1, context, raise_signals) as pool:
                    pool.submit(os.getpid).result()
                    waits = pool.submit(time.sleep, 20.0)
                    time.sleep(0.2)
                    print("works", flush=True)
                    waits.result()
        finally:
            time.sleep(0.1)
            print("cleared up", flush=True)
"""


def told(
    folder, signals: list[signal.Signals], how: str = "alone", ignored: tuple[int, ...] = ()
) -> tuple[int, str]:
    """Exit code and words of a command that works for 20 s."""
    script = folder / "works.py"
    script.write_text(WORKS)

    def start() -> None:
        for each in ENDS:
            signal.signal(each, signal.SIG_IGN if each in ignored else signal.SIG_DFL)

    with subprocess.Popen(
        [sys.executable, str(script), how], stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        text=True, env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}, preexec_fn=start,
    ) as process:  # fmt: skip
        assert process.stdout is not None
        assert process.stdout.readline() == "works\n"
        for number in signals:
            process.send_signal(number)
        said, _ = process.communicate(timeout=10.0)
    return process.returncode, said


@pytest.mark.parametrize("number", ENDS)
def test_it_clears_up_and_says_what_ended_it(tmp_path, number: signal.Signals):
    said = f"cleared up\nvwnav: ended by {number.name}\n"
    assert told(tmp_path, [number]) == (128 + number, said)


def test_a_second_signal_right_after_does_not_break_off_the_clearing_up(tmp_path):
    code, said = told(tmp_path, [signal.SIGHUP, signal.SIGHUP, signal.SIGTERM])
    assert said.startswith("cleared up\nvwnav: ended by SIG")
    assert code > 128


def test_one_that_it_was_started_to_ignore_stays_ignored(tmp_path):
    code, _ = told(tmp_path, [signal.SIGHUP, signal.SIGTERM], ignored=(signal.SIGHUP,))
    assert code == 128 + signal.SIGTERM


def test_processes_that_share_the_work_end_with_it(tmp_path):
    code, said = told(tmp_path, [signal.SIGTERM], "shared")
    assert (code, said) == (143, "cleared up\nvwnav: ended by SIGTERM\n")
