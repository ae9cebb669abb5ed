"""A command that fails says one line, whatever it has taken of a file."""

import subprocess
import sys

import pytest
import typer

from vwnav import __main__ as command
from vwnav.errors import SourceError


def said(monkeypatch, capsys, text: str) -> str:
    def fails() -> None:
        raise SourceError(text)

    monkeypatch.setattr(command, "app", fails)
    with pytest.raises(SystemExit) as ended:
        command.main()
    assert ended.value.code == 1
    return capsys.readouterr().err


def test_what_would_command_the_terminal_is_left_out(monkeypatch, capsys):
    line = said(monkeypatch, capsys, "no column t_s;\nit has \x1b[2J, \x00\x9b, Höhe")
    assert line == "vwnav: no column t_s; it has \ufffd[2J, \ufffd\ufffd, Höhe\n"


def test_an_interrupt_is_one_line_and_the_shells_exit_code(monkeypatch, capsys):
    app = typer.Typer()

    @app.command()
    def work() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(sys, "argv", ["vwnav"])
    monkeypatch.setattr(command, "app", app)
    with pytest.raises(SystemExit) as ended:
        command.main()
    assert ended.value.code == 130
    assert capsys.readouterr().err.strip() == "vwnav: interrupted"


def test_what_would_fill_the_terminal_is_cut(monkeypatch, capsys):
    line = said(monkeypatch, capsys, f"it has {'uint64_t timestamp, ' * 5000}; say another")
    assert line.startswith("vwnav: it has uint64_t timestamp, ")
    assert line.endswith("timestamp, ; say another\n")
    assert len(line) < 1600


@pytest.mark.parametrize("closed", [">&-", "<&- >&- 2>&-"])
def test_streams_that_were_closed_before_are_nobodys_trouble(closed):
    program = (
        "from vwnav import __main__ as command, screen\n"
        "command.app = lambda: screen.print_rows('faults', ('fault',), [('black',)])\n"
        "command.main()"
    )
    command = [sys.executable, "-c", program]
    done = subprocess.run(["sh", "-c", f'exec "$@" {closed}', "sh", *command], check=False)
    assert done.returncode == 0


def test_a_complaint_is_never_a_result(tmp_path):
    command = [sys.executable, "-m", "vwnav", "map", "info", str(tmp_path / "none.mbtiles")]
    done = subprocess.run(
        ["sh", "-c", 'exec "$@" 2>&-', "sh", *command], stdout=subprocess.PIPE, check=False
    )
    assert (done.returncode, done.stdout) == (1, b"")
