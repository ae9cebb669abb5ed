"""`vwnav bench shutter`: the same moments seen by three cameras."""

import json

from typer.testing import CliRunner

from vwnav.__main__ import app


def test_rows_that_are_put_back_are_worth_a_global_shutter() -> None:
    words = ["bench", "shutter", "--features", "sift", "--looks", "6", "--json"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    names = [row["shutter"] for row in told["rows"]]
    assert names == ["global", "rolling, not told", "rolling, rows put back"]
    at_once, rolling, put_back = (row["place_m"] + row["agl_m"] for row in told["rows"])
    assert put_back < rolling
    assert put_back < 2.0 * at_once
    assert all(row["fixes"] == row["looks"] == 6 for row in told["rows"])
