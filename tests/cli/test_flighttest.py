"""The command line of `vwnav flighttest`; nothing is flown here."""

import json

import pytest
from typer.testing import CliRunner

from vwnav.__main__ import app
from vwnav.bench.flights.table import TABLE
from vwnav.errors import ConfigError

RUN = CliRunner()


def test_the_list_is_one_object_a_line():
    result = RUN.invoke(app, ["flighttest", "faults", "--list", "--json"])
    assert result.exit_code == 0
    rows = [json.loads(line) for line in result.stdout.splitlines()]
    assert [row["name"] for row in rows] == [row.name for row in TABLE]
    assert set(rows[0]) == {"family", "name", "where", "when", "expected"}


def test_only_names_some_of_them():
    result = RUN.invoke(
        app, ["flighttest", "faults", "--list", "--json", "--only", "battery c", "--only", "BLACK"]
    )
    names = [json.loads(line)["name"] for line in result.stdout.splitlines()]
    assert names == ["pictures black for good at 50 m", "battery critical"]


def test_drawn_flights_are_listed_as_rows_are():
    result = RUN.invoke(
        app, ["flighttest", "faults", "--list", "--json", "--drawn", "3", "--first", "7"]
    )
    rows = [json.loads(line) for line in result.stdout.splitlines()]
    assert [row["name"].split(":")[0] for row in rows] == ["drawn 7", "drawn 8", "drawn 9"]
    assert {(row["family"], row["expected"]) for row in rows} == {("drawn", "breaks no rule")}


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--drawn", "2", "--only", "killed"], "--drawn goes with neither"),
        (["--first", "2"], "--first is the first flight of --drawn N"),
        (["--drawn", "2", "--connection", "udpin://0.0.0.0:24000"], "--drawn goes with neither"),
        (["--only", "no such fault"], "no fault is named no such fault: see --list"),
        (["--connection", "udpin://0.0.0.0:24000", "--only", "killed"], "--truth"),
        (["--connection", "udpin://0.0.0.0:24000", "--only", "starved"], "no fault is named"),
        (["--truth", "udpout:127.0.0.1:24001", "--only", "killed"], "go with --connection"),
        (["--pilot", "udpin://0.0.0.0:24001", "--only", "killed"], "go with --connection"),
    ],
)
def test_what_cannot_be_flown_is_said(words, says, tmp_path):
    result = RUN.invoke(app, ["flighttest", "faults", "-o", str(tmp_path / "out"), *words])
    assert isinstance(result.exception, ConfigError)
    assert says in str(result.exception)


@pytest.mark.parametrize("test", ["hover", "waypoints", "failsafe"])
@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--manners", "rover"], "--manners is px4 or px4-1.16 or copter, not 'rover'"),
        (["--connection", "udpin://0.0.0.0:24000"], "--truth"),
        (["--connection", "udpin://0.0.0.0:24000", "--map", "a", "--home", "1,2"],
         "without --truth a test needs --camera, --video, too"),
        (["--truth", "udpout:127.0.0.1:24001"], "go with --connection"),
        (["--connection", "udpin://0.0.0.0:24000", "--truth", "udpout:127.0.0.1:24001",
          "--camera", "b"], "--map, --camera, --video and --home go without --truth"),
        (["--map", "a", "--camera", "b", "--video", "c", "--home", "1,2"], "go with --connection"),
    ],
)  # fmt: skip
def test_a_test_that_cannot_be_flown_leaves_nothing(test, words, says, tmp_path):
    result = RUN.invoke(app, ["flighttest", test, "-o", str(tmp_path / "out"), *words])
    assert isinstance(result.exception, ConfigError)
    assert says in str(result.exception)
    assert not (tmp_path / "out").exists()
