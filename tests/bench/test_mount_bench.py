"""`vwnav bench mount`: what its rows count, and one flight through the command."""

import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from vwnav.__main__ import app
from vwnav.bench.mount.run import (
    FOCALS,
    MOST_MOUNT_DEG,
    OFFSETS_S,
    READOUTS_S,
    SOUGHT,
    MountTrial,
    drawn,
    rows_of,
)

NOTHING = np.full(len(SOUGHT), math.nan)


def trial(number: int, error: float, sigma: float) -> MountTrial:
    return MountTrial(number, np.full(len(SOUGHT), error), np.full(len(SOUGHT), sigma))


def test_errors_are_counted_by_what_is_asked_and_by_the_sigma_given() -> None:
    # 2.5 is over every asked error; of a sigma of 1 it is within three, of 0.5 it is not.
    rows = rows_of([trial(0, -0.1, 0.05), trial(1, 2.5, 1.0), trial(2, 2.5, 0.5)])
    for row in rows:
        assert row.largest == 2.5
        assert row.rms == pytest.approx(math.sqrt((0.01 + 2 * 6.25) / 3))
        assert row.as_asked == (None if row.asked is None else 1)
        assert (row.told, row.within) == (3, 2)


def test_what_is_refused_is_told_by_no_flight_and_counts_for_no_sigma() -> None:
    refused = MountTrial(1, NOTHING, NOTHING, refused="hardly any picture is found on the map")
    rows = rows_of([trial(0, 0.1, 0.1), refused])
    assert all(row.told == row.within == 1 for row in rows)
    nothing = rows_of([refused])
    assert all(row.told == row.within == 0 and math.isnan(row.largest) for row in nothing)


@given(st.integers(0, 1000), st.integers(0, 1000))
def test_the_camera_of_a_flight_is_always_the_same_and_off_by_no_more_than_is_said(k, seed) -> None:
    mounted = drawn(k, seed)
    assert mounted == drawn(k, seed)
    assert mounted != drawn(k + 1, seed)
    assert max(map(abs, mounted.rpy_deg)) <= MOST_MOUNT_DEG
    assert OFFSETS_S[0] <= mounted.offset_s <= OFFSETS_S[1]
    assert READOUTS_S[0] <= mounted.readout_s <= READOUTS_S[1]
    assert mounted.focal in FOCALS


@pytest.mark.long
def test_a_flight_is_flown_calibrated_and_held_against_its_truth() -> None:
    done = CliRunner().invoke(app, ["bench", "mount", "--runs", "1", "--json"])
    assert done.exit_code == 0, done.output
    rows = json.loads(done.stdout)["rows"]
    assert [row["name"] for row in rows] == [each.name for each in SOUGHT]
    assert all(row["told"] == row["within"] == 1 for row in rows)
    assert all(row["as_asked"] in (None, 1) for row in rows)
