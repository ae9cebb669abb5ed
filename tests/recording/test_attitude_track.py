"""Attitudes at exposure times."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.geometry.rotations import (
    euler_from_rotation,
    quat_from_rotation,
    rotation_from_euler,
    rotation_from_quat,
)
from vwnav.recording.attitude_track import AttitudeTrack


def quat(yaw_rad: float, roll_rad: float = 0.0):
    return quat_from_rotation(rotation_from_euler(roll_rad, 0.0, yaw_rad))


def yaw_of(attitude) -> float:
    return euler_from_rotation(rotation_from_quat(attitude.quat_wxyz))[2]


@given(st.floats(0.0, 0.98))
def test_a_steady_turn_is_interpolated_through_south(t_s):
    track = AttitudeTrack(max_gap_s=0.1)
    for i in range(50):
        track.add(i * 0.02, quat(3.0 + i * 0.02))
    expected = math.remainder(3.0 + t_s, math.tau)
    assert math.remainder(yaw_of(track.at(t_s)) - expected, math.tau) == pytest.approx(0, abs=1e-6)


def test_gaps_and_both_ends_are_unknown():
    track = AttitudeTrack(max_gap_s=0.1)
    track.add(1.0, quat(0.0))
    track.add(2.0, quat(1.0))
    assert track.at(0.9) is None
    assert track.at(1.5) is None
    assert track.at(2.1) is None
    assert track.at(2.0) is not None


def test_what_is_not_newer_is_dropped():
    track = AttitudeTrack(max_gap_s=0.1)
    for t_s in (0.0, 0.01, 0.02, 0.01):
        track.add(t_s, quat(t_s))
    assert len(track) == 3
    assert yaw_of(track.at(0.02)) == pytest.approx(0.02)
