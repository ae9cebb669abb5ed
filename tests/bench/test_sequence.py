"""The track that sequences are judged by, and how their sigmas are."""

import csv

import numpy as np
import pytest

from vwnav.bench.features.sequence import honesty, possible

TIMES_S = np.arange(0.0, 6.0, 1.0 / 3.0)
M_PER_DEG = 111_000.0


def track(north_m: np.ndarray) -> np.ndarray:
    """(n, 2) degrees of a flight east at 13 m/s that swerves by `north_m` (n,)."""
    return np.column_stack([north_m, 13.0 * TIMES_S]) / M_PER_DEG


def test_a_place_that_no_aircraft_flies_through_is_left_out_and_its_neighbours_stay():
    swerve_m = np.zeros(len(TIMES_S))
    swerve_m[7] = 5.0  # 90 m/s^2
    left = possible(TIMES_S, track(swerve_m))
    assert np.flatnonzero(~left).tolist() == [7]


def test_a_hard_turn_stays():
    assert possible(TIMES_S, track(0.5 * 10.0 * np.maximum(TIMES_S - 2.0, 0.0) ** 2)).all()


def test_of_the_real_track_two_places_are_left_out(data_folder):
    """Its own columns say the same: the image of 1270 was fitted 14 % too small."""
    flight = data_folder / "flights" / "islamabad" / "sift_track_every10.csv"
    rows = list(csv.DictReader(flight.open()))
    places = np.array([(float(row["lat"]), float(row["lon"])) for row in rows])
    left = possible(np.array([float(row["t"]) for row in rows]), places)
    assert [row["frame"] for row, stays in zip(rows, left, strict=True) if not stays] == [
        "1270",
        "1290",
    ]


def test_honesty_counts_shares_and_the_longest_time_over_three_sigmas():
    t_s, errors_m = np.arange(10) * 0.5, np.array([0.5, 1.5, 7, 8, 9, 1.5, 7, 0.5, 0.5, 0.5])
    found = honesty(t_s, errors_m, np.full(10, 2.0))
    assert found.worst_sigmas == pytest.approx(4.5)
    assert (found.within_1, found.within_2) == pytest.approx((0.6, 0.6))
    assert found.over_3_s == pytest.approx(1.0)
    assert found.median_sigma_m == pytest.approx(2.0)
