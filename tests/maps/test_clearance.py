"""A route over a ridge: how low above it, on which leg, and who refuses it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.geometry.geodesy import LocalFrame
from vwnav.maps.clearance import LEAST_CLEARANCE_M, check_clearance

HOME = LocalFrame(47.0, 8.0, 500.0)
KNOWN_TO_M = 600.0


class Ridge:
    """A pack's heights: ground at 500 m, a ridge of 60 m between 150 and 250 m north of home."""

    def __init__(self, ridge_m: float = 60.0, home_known: bool = True) -> None:
        self.ridge_m, self.home_known = ridge_m, home_known

    def elevation_m(self, lat_deg: float, lon_deg: float) -> float | None:
        north_m = HOME.to_ned(lat_deg, lon_deg, 500.0)[0]
        if north_m > KNOWN_TO_M or (not self.home_known and north_m < 20.0):
            return None
        return 500.0 + (self.ridge_m if 150.0 < north_m < 250.0 else 0.0)

    def elevations_m(self, lat_deg: np.ndarray, lon_deg: np.ndarray) -> np.ndarray:
        each = [self.elevation_m(*place) for place in zip(lat_deg, lon_deg, strict=True)]
        return np.array([np.nan if ground_m is None else ground_m for ground_m in each])


def flown(*legs: tuple[float, float]) -> np.ndarray:
    """Places (north, height), from above home and back."""
    return np.array([[north_m, 0.0, -height_m] for north_m, height_m in legs])


def test_a_route_through_a_ridge_is_too_low_by_so_many_metres_there():
    found = check_clearance(
        Ridge(), HOME, flown((0, 30), (100, 30), (400, 30), (400, 80), (0, 80)), 2
    )
    assert not found.ok
    assert found.lowest_m == pytest.approx(-30.0)
    assert "too low on the leg to waypoint 2 at 47.001" in found.summary()
    assert "30.0 m below the ground: 35.0 m are missing to the 5 m" in found.summary()
    north_m = HOME.to_ned(*found.lat_lon_deg, 500.0)[0]
    assert 150.0 < north_m < 156.0


def test_the_way_home_counts_and_so_does_the_first_leg():
    back = check_clearance(Ridge(), HOME, flown((0, 80), (400, 80), (400, 30), (0, 30)), 2)
    assert "too low on the way home" in back.summary()
    out = check_clearance(Ridge(), HOME, flown((0, 30), (400, 80), (0, 80)), 1)
    assert "too low on the leg to waypoint 1" in out.summary()


def test_a_route_that_is_high_enough_says_where_it_is_lowest():
    found = check_clearance(Ridge(), HOME, flown((0, 70), (400, 70), (0, 70)), 1)
    assert found.ok
    assert "lowest on the leg to waypoint 1 at 47.001" in found.summary()
    assert "10.0 m above the ground" in found.summary()
    assert "is known" not in found.summary()


def test_take_off_and_landing_are_no_part_of_it():
    assert check_clearance(Ridge(), HOME, flown((0, 6), (100, 6), (0, 6)), 1).ok


def test_what_the_map_has_no_heights_of_is_not_judged_and_that_is_said():
    part = check_clearance(Ridge(0.0), HOME, flown((0, 30), (1200, 30), (0, 30)), 1)
    assert part.ok
    assert "(50% of it is known)" in part.summary()
    nowhere = check_clearance(Ridge(home_known=False), HOME, flown((0, 3), (0, 3)), 0)
    assert nowhere.ok
    assert "is not known: that takes a home" in nowhere.summary()


@given(ridge_m=st.floats(0.0, 200.0), height_m=st.floats(2.0, 200.0))
def test_no_route_is_passed_that_goes_through_the_least_height_above_ground(ridge_m, height_m):
    found = check_clearance(
        Ridge(ridge_m), HOME, flown((0, height_m), (400, height_m), (0, height_m)), 1
    )
    assert found.lowest_m == pytest.approx(height_m - ridge_m, abs=0.01)
    assert found.ok == (found.lowest_m >= LEAST_CLEARANCE_M)
