"""What a command says where nobody can hear it."""

import os
import subprocess
import sys

import pytest
from rich.console import Console

from vwnav.safety.check import Check
from vwnav.screen import ReadinessTable, check_table, print_rows, print_table

SAYS_ON = """
import sys
import threading
from vwnav.safety.check import Check
from vwnav.screen import LiveLine, ReadinessTable, progress_bar, say

def speak():
    for number in range(300):
        say(f"line {number} " + 60 * "x")
    ReadinessTable().show((Check("link", "PASS", "heard"),))
    with progress_bar() as report:
        report("tiles", 1, 2)
    with LiveLine(every_s=0.0) as line:
        line.show(1.0, "flies")
    spoke.append(True)

spoke = []
thread = threading.Thread(target=speak)
thread.start()
thread.join()
speak()
open(sys.argv[1], "w").write(str(len(spoke)))
"""


@pytest.mark.parametrize("screen", ["a pipe that nobody reads", "a full disk", "closed"])
def test_a_screen_that_breaks_ends_no_thread(tmp_path, screen):
    done = tmp_path / "done"
    command = [sys.executable, "-c", SAYS_ON, str(done)]
    if screen == "closed":
        subprocess.run(["sh", "-c", 'exec "$@" 2>&-', "sh", *command], timeout=60.0)
    elif screen == "a full disk":
        with open("/dev/full", "wb") as full:
            subprocess.run(command, stderr=full, timeout=60.0)
    else:
        reads, writes = os.pipe()
        os.close(reads)
        subprocess.run(command, stderr=writes, timeout=60.0)
        os.close(writes)
    assert done.read_text() == "2"


def test_what_stands_in_brackets_is_shown_as_it_is(capsys):
    """Names of files and what to type are not for whoever draws the table to read."""
    told = "/maps [old]/field.mbtiles: try /dev/video0[@30]"
    print_table(told, [("[red]", told)])
    print_rows(told, ("[a]",), [(told,)])
    shown = capsys.readouterr().out.replace("\n", "")
    assert shown.count("[old]") == shown.count("[@30]") == 4
    assert "[red]" in shown


def test_what_is_wider_than_the_terminal_is_not_cut(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    path = f"/flights/{'x' * 60}/run"
    print_table("fly", [("results in", path)])
    Console(file=sys.stdout).print(check_table([Check("COM_OBL_RC_ACT_" * 3, "WARN", path)]))
    shown = capsys.readouterr().out
    assert (shown.count("x"), shown.count("R"), "…" in shown) == (120, 4, False)


def test_of_the_readiness_list_only_what_changed_is_shown_again(capfd):
    table = ReadinessTable()
    link, warned = Check("link", "PASS", "heard"), Check("NAV_DLL_ACT", "WARN", "is 0")
    table.show((link, warned, Check("camera", "FAIL", "no picture has come")))
    first = capfd.readouterr().err
    assert all(said in first for said in ("heard", "NAV_DLL_ACT", "no picture has come"))
    table.show((link, warned, Check("camera", "PASS", "pictures come")))
    then = capfd.readouterr().err
    assert "pictures come" in then
    assert "heard" not in then
    assert "NAV_DLL_ACT" not in then
    table.show((link, warned))
    assert capfd.readouterr().err == ""


def test_what_kept_it_on_the_ground_and_is_gone_is_said_to_be_gone(capfd):
    """A parameter that was mended, a switch that was put back: they have a line while they do."""
    table, camera = ReadinessTable(), Check("camera", "FAIL", "no picture has come")
    table.show((Check("VISO_TYPE", "FAIL", "is 0"), Check("link", "PASS", "heard"), camera))
    capfd.readouterr()
    table.show((camera,))
    said = capfd.readouterr().err
    assert "PASS" in said
    assert "no more: is 0" in said
    assert not any(other in said for other in ("heard", "camera", "FAIL"))
