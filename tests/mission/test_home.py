"""Where the aircraft stood, by the way flown from there to the first fixes."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from vwnav.mission.home import Home

GIVEN_NE_M = np.array([5.0, 5.0])
NORTH_20_M = np.array([20.0, 0.0])


def at(place_ne_m: np.ndarray, sigma_m: float = 0.5) -> SimpleNamespace:
    return SimpleNamespace(
        position_ned_m=np.array([*place_ne_m, -50.0]), sigma_horizontal_m=sigma_m
    )


def flown(
    given_ne_m: np.ndarray | None, sigma_m: float, fixed_at: int = 400, given_sigma_m: float = 5.0
) -> Home:
    """20 s at 1 m/s to the north; the place gets so unsure on it, and sure by a fix."""
    home = Home(given_ne_m, given_sigma_m)
    for i in range(400):
        grown_m2 = 1.0 - 1e3 if i == fixed_at else sigma_m**2 / 400.0
        home.flown(np.array([0.05, 0.0]), grown_m2)
    return home


@pytest.mark.parametrize(
    ("sigma_m", "apart_m", "weighed"),
    [(1.0, 2.5, True), (1.0, 6.0, False), (5.0, 6.0, True), (5.0, 40.0, False)],
)
@pytest.mark.parametrize("fixed_at", [399, 400])
def test_a_home_that_was_given_is_weighed_unless_the_way_from_it_is_surer(
    sigma_m, apart_m, weighed, fixed_at
):
    home = flown(GIVEN_NE_M, sigma_m, fixed_at)
    stood_ne_m = GIVEN_NE_M + np.array([0.0, apart_m])
    said = home.settle(at(stood_ne_m + np.array([20.0, 0.0])))
    assert (said == "") is weighed
    given_m2, way_m2 = 5.0**2 + 0.5**2, sigma_m**2 * fixed_at / 400.0
    share = given_m2 / (given_m2 + way_m2) if weighed else 1.0
    assert home.place_ne_m == pytest.approx(GIVEN_NE_M + share * (stood_ne_m - GIVEN_NE_M))


@pytest.mark.parametrize("given_m", [0.3, 5.0])
@pytest.mark.parametrize("way_m", [0.3, 4.0])
def test_it_lands_nearer_to_where_it_stood_than_by_either_alone(given_m, way_m):
    """By a map that is off by 1.5 m: 1.65 m from home, with one that was given to a centimetre."""
    rng, off_m = np.random.default_rng(2), []
    for _ in range(2000):
        map_ne_m, given_ne_m, way_ne_m = (rng.normal(0.0, s, 2) for s in (1.5, given_m, way_m))
        home = flown(given_ne_m, way_m, given_sigma_m=given_m)
        if home.settle(at(NORTH_20_M + map_ne_m + way_ne_m, 1.5)):
            continue  # given for elsewhere, it seems
        ends = (home.place_ne_m, given_ne_m, map_ne_m + way_ne_m)
        off_m.append([math.dist(each, map_ne_m) for each in ends])
    assert len(off_m) > 300
    weighed, given, stood = np.sqrt(np.mean(np.square(off_m), axis=0))
    assert weighed < 1.02 * min(given, stood)


def test_where_none_was_given_it_is_where_the_aircraft_stood_however_unsure():
    home = flown(None, 5.0)
    assert "known now" in home.settle(at(np.array([20.0, 3.0])))
    assert home.place_ne_m == pytest.approx(np.array([0.0, 3.0]))


@pytest.mark.parametrize("sigma_m", [0.5, 4.0])
def test_a_home_that_was_given_right_stays_so_in_95_of_100(sigma_m):
    """However unsure the way is: 10 m here. By one sigma it was given up in six of ten."""
    rng, stays, n = np.random.default_rng(1), 0, 600
    for _ in range(n):
        home = flown(GIVEN_NE_M, 10.0)
        errors_m = rng.normal(0.0, (10.0, sigma_m), (2, 2)).sum(axis=1)
        stays += home.settle(at(GIVEN_NE_M + NORTH_20_M + errors_m, sigma_m)) == ""
    assert 0.93 < stays / n < 0.97
