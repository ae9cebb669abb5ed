"""What the watchdog starts and wakes a second navigator with is what that one reads."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from vwnav.cli.fly import fly
from vwnav.onboard import program, successor
from vwnav.onboard.successor import Handover
from vwnav.vehicle import FoundCamera, Learned
from vwnav.watchdog.keepalive import Beat
from vwnav.watchdog.relay_guard import RelayedPosition
from vwnav.watchdog.successor import Resume
from vwnav.watchdog.voice import Origin

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


def test_what_the_watchdog_wakes_it_with_is_read():
    ways = {"connection": "udpout://127.0.0.1:1", "observer": "", "keepalive_port": 2}
    place = RelayedPosition(100.0, (0.0, 0.0, -50.0), 1.0, 3)
    for position, origin in ((place, Origin(41.0, 29.0, 40.0)), (None, None), (place, None)):
        resume = Resume(position, (8.0, 0.0), origin, None, system_id=7)
        read = Handover.read(json.dumps({**ways, **asdict(resume)}))
        assert (read.system_id, read.connection) == (7, ways["connection"])
        assert (read.lat_lon_deg is None) is (origin is None)


@pytest.mark.parametrize("camera", [None, FoundCamera(0.8, 1.0, (1.0, *[0.0] * 7, 1.0), -0.1)])
def test_what_the_first_navigator_has_learned_reaches_the_second_one_by_beat_and_by_word(camera):
    learned = Learned(100.0, (1.0, 2.0), (3.0, 4.0, 5.0), camera)
    beat = Beat.unpack(Beat(True, 1, 2, "on route", learned=learned).pack())
    assert beat is not None
    resume = Resume(None, (8.0, 0.0), None, beat.learned)
    ways = {"connection": "udpout://127.0.0.1:1", "observer": "", "keepalive_port": 2}
    assert Handover.read(json.dumps({**ways, **asdict(resume)})).learned == learned
