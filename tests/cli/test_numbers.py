"""Numbers on the command line that cannot be are usage errors, before anything is read."""

from collections.abc import Iterator
from inspect import signature
from typing import get_args

import pytest
import typer
from typer.testing import CliRunner

from vwnav.__main__ import app

LOCALIZE = ("localize", "a.png", "--map", "none.mbtiles")
REPLAY = ("replay", "none.mp4", "--map", "none.mbtiles")
BUILD = ("map", "build", "none.tif", "-o", "none.mbtiles")
CHECK = ("map", "check", "none.mbtiles", "--route", "none.plan")


@pytest.mark.parametrize("hfov_deg", ["200", "180", "0", "-5", "nan"])
@pytest.mark.parametrize("command", [REPLAY, LOCALIZE])
def test_a_field_of_view_that_no_lens_has(command, hfov_deg):
    done = CliRunner().invoke(app, [*command, f"--hfov-deg={hfov_deg}"])
    assert done.exit_code == 2
    assert "--hfov-deg" in done.output


@pytest.mark.parametrize("value", ["nan", "inf"])
@pytest.mark.parametrize(
    ("command", "option"),
    [
        *((LOCALIZE, f"--{name}") for name in ("lat", "lon", "sigma-m", "yaw-deg", "agl-m")),
        (BUILD, "--georeference-sigma-m"),
        (CHECK, "--margin-m"),
        (("camera", "none.mp4"), "--height-m"),
        (("camera", "none.mp4"), "--seconds"),
    ],
)
def test_what_is_no_number(command, option, value):
    done = CliRunner().invoke(app, [*command, option, value])
    assert done.exit_code == 2
    assert option in done.output


def commands_of(group: typer.Typer, words: tuple[str, ...] = ()) -> Iterator:
    """Words and function of every command."""
    for each in group.registered_commands:
        yield (*words, each.name or each.callback.__name__), each.callback
    for inner in group.registered_groups:
        yield from commands_of(inner.typer_instance, (*words, inner.name))


def is_number(annotation: object) -> bool:
    """A real number, one that may be left out, or several."""
    parts = get_args(annotation)
    return annotation is float or any(is_number(part) for part in parts)


NUMBERS = [
    (words, f"--{name.replace('_', '-')}")
    for words, function in commands_of(app)
    for name, parameter in signature(function).parameters.items()
    if is_number(parameter.annotation)
]


@pytest.mark.parametrize("value", ["nan", "inf"])
@pytest.mark.parametrize(("words", "option"), NUMBERS, ids=" ".join)
def test_no_command_takes_what_is_no_number(words, option, value):
    done = CliRunner().invoke(app, [*words, option, value], terminal_width=200)
    assert done.exit_code == 2
    assert "Invalid value" in done.output
    assert option in done.output
