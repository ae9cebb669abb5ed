"""Numbers on the command line that cannot be are usage errors, before anything is read."""

import pytest
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
