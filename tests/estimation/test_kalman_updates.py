"""The Kalman updates against textbook algebra that shares none of their shortcuts."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vwnav.estimation.inertial.gyro_aiding import (
    DelayedStateMeasurement,
    correlated_noise_update,
)
from vwnav.estimation.states import FilterState, Measurement, States, correct, fuse

N = States.SIZE


def covariance(rng: np.random.Generator, n: int) -> np.ndarray:
    """Sigmas from a millimetre to a kilometre, and states that go together."""
    L = 10.0 ** rng.uniform(-3.0, 3.0, n)[:, None] * np.tril(rng.normal(size=(n, n)))
    return L @ L.T


def state(rng: np.random.Generator) -> FilterState:
    return FilterState(0.0, np.zeros(N), covariance(rng, N), True, True, 0.0, 0.0)


@given(seed=st.integers(0, 10_000), m=st.integers(1, 3))
@settings(max_examples=60, deadline=None)
def test_an_update_is_the_conditional_distribution_in_josephs_form(seed: int, m: int) -> None:
    rng = np.random.default_rng(seed)
    before, H, R = state(rng), rng.normal(size=(m, N)), covariance(rng, m)
    after = correct(before, Measurement(0.01 * rng.normal(size=m), H, R))
    K = np.linalg.solve(H @ before.P @ H.T + R, H @ before.P).T
    A = np.eye(N) - K @ H
    scale = np.sqrt(np.outer(np.diag(before.P), np.diag(before.P)))
    joseph = A @ before.P @ A.T + K @ R @ K.T
    np.testing.assert_allclose(after.P / scale, joseph / scale, atol=1e-9)
    assert np.array_equal(after.P, after.P.T)


@given(seed=st.integers(0, 10_000), considered=st.integers(0, N - 1))
@settings(max_examples=60, deadline=None)
def test_a_considered_state_stays_as_it_is_and_as_unsure(seed: int, considered: int) -> None:
    """The covariance is right for a gain that is not the best one: that is what the form is for."""
    rng = np.random.default_rng(seed)
    before, H, R = state(rng), rng.normal(size=(2, N)), covariance(rng, 2)
    after = correct(before, Measurement(rng.normal(size=2), H, R, considered=(considered,)))
    assert after.x[considered] == 0.0
    assert after.P[considered, considered] == pytest.approx(before.P[considered, considered])
    sigmas = np.sqrt(np.diag(before.P))
    assert np.linalg.eigvalsh(after.P / np.outer(sigmas, sigmas))[0] > -1e-9


@given(seed=st.integers(0, 10_000))
@settings(max_examples=60, deadline=None)
def test_a_measurement_of_both_ends_of_a_step_is_joint_conditioning(seed: int) -> None:
    """Of x0, w and n together: x1 = F x0 + w, and z = C x0 + A w + n tells of it."""
    rng = np.random.default_rng(seed)
    P, Q, R = covariance(rng, N), covariance(rng, N), covariance(rng, 3)
    F = np.eye(N) + 0.1 * rng.normal(size=(N, N))
    A, C = rng.normal(size=(3, N)), rng.normal(size=(3, N))
    r = 0.01 * np.sqrt(np.diag(C @ P @ C.T)) * rng.normal(size=3)  # within the gate
    z = DelayedStateMeasurement(r, A, C, R)
    x, after = correlated_noise_update(np.zeros(N), P, F, Q, z)
    joint = np.block([
        [P, np.zeros((N, N + 3))],
        [np.zeros((N, N)), Q, np.zeros((N, 3))],
        [np.zeros((3, 2 * N)), R],
    ])  # fmt: skip
    moved, told = np.hstack([F, np.eye(N), np.zeros((N, 3))]), np.hstack([C, A, np.eye(3)])
    gain = np.linalg.solve(told @ joint @ told.T, told @ joint @ moved.T).T
    wanted = moved @ joint @ moved.T - gain @ told @ joint @ moved.T
    scale = np.sqrt(np.outer(*[np.diag(moved @ joint @ moved.T)] * 2))
    np.testing.assert_allclose(after / scale, wanted / scale, atol=1e-9)
    np.testing.assert_allclose(
        x / np.sqrt(np.diag(scale)), gain @ r / np.sqrt(np.diag(scale)), atol=1e-9
    )


def test_what_its_gate_refuses_changes_nothing() -> None:
    before = state(np.random.default_rng(2))
    H = np.zeros((1, N))
    H[0, States.DOWN] = 1.0
    far = 100.0 * np.sqrt(before.P[States.DOWN, States.DOWN])
    after, innovation = fuse(before, Measurement(np.array([far]), H, np.eye(1)))
    assert after is before
    assert not innovation.accepted
