import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.guidance.hover import climb_straight, descend_to_land, hold_at
from vwnav.guidance.limits import LimitsConfig
from vwnav.vehicle import VelocitySetpoint

LIMITS = LimitsConfig()
numbers = st.floats(allow_nan=True, allow_infinity=True)
HOME = np.array([0.0, 0.0, -30.0])


def test_climb_goes_straight_up_and_stops_at_the_height(make_estimate) -> None:
    low = climb_straight(make_estimate([5.0, -3.0, -10.0]), 50.0, LIMITS)
    assert low == VelocitySetpoint(0.0, 0.0, -LIMITS.climb_m_s)
    assert climb_straight(make_estimate([5.0, -3.0, -50.0]), 50.0, LIMITS).down_m_s == 0.0


def test_hold_goes_back_to_its_place_within_the_limits(make_estimate) -> None:
    setpoint = hold_at(make_estimate([100.0, 0.0, -30.0]), HOME, LIMITS)
    assert setpoint == VelocitySetpoint(-LIMITS.cross_speed_m_s, 0.0, 0.0)


@pytest.mark.parametrize(
    ("agl_m", "sigma_agl_m", "down_m_s"),
    [(50.0, 2.0, LIMITS.descend_m_s), (50.0, 25.0, LIMITS.land_m_s), (5.0, 0.5, LIMITS.land_m_s)],
)
def test_descent_is_slow_near_the_ground_and_where_height_is_unsure(
    make_estimate, agl_m: float, sigma_agl_m: float, down_m_s: float
) -> None:
    estimate = make_estimate(HOME, agl_m=agl_m, sigma_agl_m=sigma_agl_m)
    assert descend_to_land(estimate, HOME[:2], LIMITS).down_m_s == down_m_s


@given(numbers, numbers, numbers, numbers)
def test_hovering_never_asks_for_what_is_not_finite(make_estimate, north, east, down, agl) -> None:
    estimate = make_estimate([north, east, down], agl_m=agl)
    for setpoint in (
        hold_at(estimate, HOME, LIMITS),
        climb_straight(estimate, 50.0, LIMITS),
        descend_to_land(estimate, HOME[:2], LIMITS),
    ):
        values = (setpoint.north_m_s, setpoint.east_m_s, setpoint.down_m_s)
        assert all(math.isfinite(v) for v in values)
        assert -LIMITS.climb_m_s <= setpoint.down_m_s <= LIMITS.descend_m_s


def test_holding_keeps_a_drone_in_gusts_over_its_place(make_drone) -> None:
    drone = make_drone(0, position_m=np.array([8.0, -6.0, -30.0]))
    for i in range(1200):
        drone.move(hold_at(drone.estimate(i * 0.05), HOME, LIMITS))
        if i > 400:
            assert np.linalg.norm(drone.position_m - HOME) < 1.5
