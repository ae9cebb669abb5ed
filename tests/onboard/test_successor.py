"""The command line by which the watchdog starts a second navigator is one that `fly` takes."""

from dataclasses import replace
from pathlib import Path

import typer
from typer.testing import CliRunner

from vwnav.cli.fly import fly
from vwnav.onboard import program, successor

ASKED = "--arm --map a.mbtiles --route r.plan --camera c.toml --video sim:x --truth udpin:0.0.0.0:2"
HOME = ["--connection", "udpin://0.0.0.0:14540", "--home", "-33.9,18.4", "--config", "s.toml"]


def test_the_successors_command_line_reads_as_the_same_flight(monkeypatch, tmp_path):
    read = []
    monkeypatch.setattr(program, "fly_route", read.append)
    monkeypatch.setattr(successor, "stand_by", read.append)
    app = typer.Typer()
    app.command()(fly)
    assert CliRunner().invoke(app, [*ASKED.split(), *HOME]).exit_code == 0
    words = read[0].successor(tmp_path)
    result = CliRunner().invoke(app, words[words.index("fly") + 1 :])
    assert result.exit_code == 0, result.output
    first = replace(read[0], arm=False, standby=True, output=Path(tmp_path) / "successor")
    assert read[1] == first
