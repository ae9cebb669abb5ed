import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from vwnav.geometry import rotations

angles = st.floats(-math.pi, math.pi)
unit_range = st.floats(-1.0, 1.0)
directions = st.tuples(unit_range, unit_range, unit_range).filter(lambda v: math.hypot(*v) > 1e-3)
# Near zero and near half a turn is where formulas break.
lengths = st.one_of(
    st.floats(0.0, math.pi),
    st.floats(0.0, 1e-7),
    st.floats(0.0, 1e-7).map(lambda small: math.pi - small),
)


def vector(direction: tuple[float, float, float], length: float) -> np.ndarray:
    return np.array(direction) / math.hypot(*direction) * length


@given(angles, st.floats(-math.pi / 2, math.pi / 2), angles)
@example(0.3, math.pi / 2, 1.0)
@example(0.3, -math.pi / 2, 1.0)
def test_euler_angles_agree_with_scipy(roll: float, pitch: float, yaw: float) -> None:
    ours = rotations.rotation_from_euler(roll, pitch, yaw)
    theirs = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    np.testing.assert_allclose(ours, theirs, atol=1e-14)


@given(angles, st.floats(-math.pi / 2, math.pi / 2), angles)
@example(0.3, math.pi / 2, 1.0)
@example(-0.7, -math.pi / 2, 2.0)
def test_euler_angles_give_their_rotation_back(roll: float, pitch: float, yaw: float) -> None:
    R = rotations.rotation_from_euler(roll, pitch, yaw)
    np.testing.assert_allclose(
        rotations.rotation_from_euler(*rotations.euler_from_rotation(R)), R, atol=1e-7
    )


@given(angles, st.floats(-1.5, 1.5), angles)
def test_euler_angles_away_from_gimbal_lock_are_the_same_again(
    roll: float, pitch: float, yaw: float
) -> None:
    again = rotations.euler_from_rotation(rotations.rotation_from_euler(roll, pitch, yaw))
    for angle, angle_again in zip((roll, pitch, yaw), again, strict=True):
        assert abs(rotations.wrap_pi(angle - angle_again)) < 1e-9


@given(directions, lengths)
def test_rotation_of_a_vector_agrees_with_scipy(
    direction: tuple[float, float, float], length: float
) -> None:
    v = vector(direction, length)
    theirs = Rotation.from_rotvec(v).as_matrix()
    np.testing.assert_allclose(rotations.rotation_from_vector(v), theirs, atol=1e-14)


@given(directions, lengths)
def test_logarithm_undoes_the_exponential(
    direction: tuple[float, float, float], length: float
) -> None:
    R = rotations.rotation_from_vector(vector(direction, length))
    again = rotations.vector_from_rotation(R)
    assert np.linalg.norm(again) <= math.pi + 1e-12
    np.testing.assert_allclose(rotations.rotation_from_vector(again), R, atol=1e-13)


@given(directions, st.floats(1e-12, 1e-6))
def test_logarithm_of_a_tiny_rotation_keeps_its_digits(
    direction: tuple[float, float, float], length: float
) -> None:
    v = vector(direction, length)
    again = rotations.vector_from_rotation(rotations.rotation_from_vector(v))
    np.testing.assert_allclose(again, v, rtol=1e-6, atol=1e-16)


@given(directions, lengths)
def test_quaternions_agree_with_scipy_and_have_positive_w(
    direction: tuple[float, float, float], length: float
) -> None:
    R = Rotation.from_rotvec(vector(direction, length))
    quat = rotations.quat_from_rotation(R.as_matrix())
    theirs = R.as_quat(scalar_first=True)
    assert quat[0] >= 0.0
    assert min(np.abs(quat - theirs).max(), np.abs(quat + theirs).max()) < 1e-12


@given(directions, lengths, directions, lengths)
def test_quaternion_product_is_the_matrix_product(
    direction_a: tuple[float, float, float],
    length_a: float,
    direction_b: tuple[float, float, float],
    length_b: float,
) -> None:
    R_a, R_b = (
        rotations.rotation_from_vector(vector(*pair))
        for pair in ((direction_a, length_a), (direction_b, length_b))
    )
    product = rotations.quat_multiply(
        rotations.quat_from_rotation(R_a), rotations.quat_from_rotation(R_b)
    )
    np.testing.assert_allclose(rotations.rotation_from_quat(product), R_a @ R_b, atol=1e-13)


@given(directions, directions, st.floats(0.0, 1.0))
def test_slerp_agrees_with_scipy(
    a: tuple[float, float, float], b: tuple[float, float, float], fraction: float
) -> None:
    R_a, R_b = Rotation.from_rotvec(a), Rotation.from_rotvec(b)
    theirs = Slerp([0.0, 1.0], Rotation.concatenate([R_a, R_b]))(fraction)
    quats = [rotations.quat_from_rotation(R.as_matrix()) for R in (R_a, R_b)]
    ours = rotations.rotation_from_quat(rotations.slerp(*quats, fraction))
    np.testing.assert_allclose(ours, theirs.as_matrix(), atol=1e-9)


@given(directions, directions)
def test_skew_is_the_cross_product(
    v: tuple[float, float, float], w: tuple[float, float, float]
) -> None:
    np.testing.assert_allclose(rotations.skew(v) @ w, np.cross(v, w), atol=1e-15)


@given(st.floats(-100.0, 100.0))
def test_wrapped_angle_is_the_same_angle_in_range(angle_rad: float) -> None:
    wrapped = rotations.wrap_pi(angle_rad)
    assert -math.pi <= wrapped < math.pi
    assert math.cos(wrapped - angle_rad) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("quat", [[0.0, 0.0, 0.0, 0.0], [math.nan, 0.0, 0.0, 0.0]])
def test_quaternion_without_length_is_refused(quat: list[float]) -> None:
    with pytest.raises(ValueError, match="finite length"):
        rotations.rotation_from_quat(np.array(quat))
