"""What an autopilot is told in terms of its own north is the same in true ones."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.geometry.rotations import euler_from_rotation, rotation_from_quat, wrap_pi
from vwnav.mavlink.outputs.autopilot_north import AutopilotNorth
from vwnav.types import Estimate
from vwnav.vehicle import VelocitySetpoint

ANGLES = st.floats(-np.pi, np.pi)
PLACES = st.tuples(*[st.floats(-2e3, 2e3)] * 3).map(np.array)


def at(place) -> Estimate:
    covariance = np.diag([4.0, 1.0, 2.0, 0.5, 0.1, 0.2])
    quat = np.array([1.0, 0.0, 0.0, 0.0])
    return Estimate(
        1.0, place, np.array([3.0, -1.0, 0.5]), covariance, quat, 0.1, 30.0, 1.0, 1.0, 2
    )


@given(ANGLES, ANGLES, PLACES, PLACES, PLACES)
def test_a_place_that_is_told_is_found_again_and_no_turn_moves_where_it_is(a, b, p, q, r):
    first = AutopilotNorth().turned_to(a, at(p))
    second = first.turned_to(b, at(q))
    assert second.told(at(q)).position_ned_m == pytest.approx(first.told(at(q)).position_ned_m)
    told = second.told(at(r))
    assert second.true_ned_m(told.position_ned_m) == pytest.approx(r, abs=1e-6)
    assert second.true_velocity(told.velocity_ned_m_s) == pytest.approx([3.0, -1.0, 0.5])


@given(ANGLES)
def test_a_velocity_that_is_asked_for_is_turned_as_one_that_is_told(turn_rad):
    north = AutopilotNorth().turned_to(turn_rad, at(np.zeros(3)))
    told = north.told(at(np.ones(3)))
    asked = north.asked(VelocitySetpoint(3.0, -1.0, 0.5, 0.3))
    assert told.velocity_ned_m_s == pytest.approx([asked.north_m_s, asked.east_m_s, 0.5])
    assert asked.yaw_rad == 0.3  # by the compass, elsewhere
    yaw_rad = euler_from_rotation(rotation_from_quat(told.quat_wxyz))[2]
    assert wrap_pi(yaw_rad - turn_rad) == pytest.approx(0.0, abs=1e-9)
    before, after = (each.covariance for each in (at(np.ones(3)), told))
    for block in (slice(0, 2), slice(3, 5)):
        assert np.linalg.eigvalsh(after[block, block]) == pytest.approx(
            np.linalg.eigvalsh(before[block, block])
        )


def test_without_a_turn_nothing_is_touched():
    estimate = at(np.array([1.0, 2.0, 3.0]))
    assert AutopilotNorth().told(estimate) is estimate
    assert replace(AutopilotNorth()).true_ned_m(np.array([1.0, 2.0, 3.0])).tolist() == [
        1.0,
        2.0,
        3.0,
    ]
