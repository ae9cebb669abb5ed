"""Waypoints: the same flights for every feature set, and errors that say how sure they are."""

import json
import math

import pytest
from typer.testing import CliRunner

from vwnav.__main__ import app
from vwnav.bench.flights.waypoints import THESIS_M, Seen, plan, row_of


def test_flights_are_the_same_for_every_feature_set_and_stay_at_their_height() -> None:
    first = plan(2, 25.0, 20.0, 5.0, seed=0)
    assert first == plan(2, 25.0, 20.0, 5.0, seed=0)
    assert first != plan(3, 25.0, 20.0, 5.0, seed=0)
    assert {point[2] for point in first.setup.route_ned_m} == {-25.0}


def test_errors_are_pooled_over_flights() -> None:
    seen = [Seen((1.0, 3.0), (0.5, 0.5), 4, 10, 10, 1), Seen((2.0,), (0.2,), 4, 10, 5, 1)]
    row = row_of("sift", 50.0, seen)
    assert (row.raw.count, row.raw.mean_m, row.raw.worst_m) == (3, 2.0, 3.0)
    assert row.raw.available == 3 / 8
    assert row.correlated == 2
    assert row.filtered.median_m == 0.5
    assert row.filtered.available == 0.75
    assert row.raw.mean_interval_m == pytest.approx((2.0, 2.0))


def test_without_a_fix_there_is_no_error() -> None:
    row = row_of("orb", 25.0, [Seen((), (), 0, 0, 0)])
    assert math.isnan(row.raw.mean_m)
    assert row.raw.available == 0.0


def test_the_thesis_averages_are_those_of_its_text() -> None:
    means = {height: sum(errors) / len(errors) for height, errors in THESIS_M.items()}
    assert means == pytest.approx({25.0: 4.30, 50.0: 2.81}, abs=0.01)


def test_features_and_sites_that_there_are_not_are_said() -> None:
    done = CliRunner().invoke(app, ["bench", "waypoints", "--features", "surf"])
    assert done.exit_code == 2
    assert "learned, sift, orb" in done.output
    done = CliRunner().invoke(app, ["bench", "waypoints", "--site", "sim:nowhere"])
    assert "no site" in str(done.exception)


@pytest.mark.long
def test_places_are_found_within_the_thesis_errors() -> None:
    words = ["--features", "sift", "--height-m", "50", "--runs", "1", "--seconds", "6", "--json"]
    done = CliRunner().invoke(app, ["bench", "waypoints", *words])
    assert done.exit_code == 0, done.output
    (row,) = json.loads(done.stdout)["rows"]
    assert row["raw"]["count"] > 10
    assert row["raw"]["mean_m"] < 2.81
    assert row["filtered"]["mean_m"] < 2.81
