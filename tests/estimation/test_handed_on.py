"""What a filter leaves to the one that goes on in its place."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import wishart

from vwnav.estimation.beginning.starts import Start, first_state, left_by
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.inputs import decode, encode, learned_of
from vwnav.estimation.states import States
from vwnav.vehicle import FoundCamera, Learned

CONFIG = EkfConfig()
AIR = [*range(37, 42)]  # wind, drag, gusts
MOUNT = [States.CAMERA_TURN, States.FOCAL, States.TIME_OFFSET]
LEFT = [States.HEADING_BIAS, *range(9, 11), *range(19, 22), *AIR, *MOUNT]
CAMERA = FoundCamera(0.8, 1.0, tuple(np.eye(3).ravel().tolist()), -0.1)
PLACE = np.array([10.0, 20.0, -50.0])


def flown(seed: int, t_s: float = 100.0):
    """A state of somebody who knows heading and drag."""
    rng = np.random.default_rng(seed)
    state = first_state(Start(t_s=t_s, position_ned_m=PLACE), CONFIG)
    scale = np.full(States.SIZE, 0.02)
    root = wishart.rvs(2 * States.SIZE, np.eye(States.SIZE), random_state=rng) / States.SIZE
    x = state.x.copy()
    x[LEFT] = rng.normal(0.0, 0.1, len(LEFT))
    x[States.DRAG], x[States.WIND_FORCE] = rng.uniform(0.2, 1.0), rng.normal(0.0, 2.0, 2)
    return state._replace(x=x, P=scale[:, None] * root * scale, heading_known=True)


def begun(left, since_s: float):
    return first_state(Start(t_s=100.0 + since_s, position_ned_m=PLACE, learned=left), CONFIG)


@given(st.integers(0, 2**32 - 1))
def test_it_goes_on_with_what_was_learned_and_no_surer(seed):
    state = flown(seed)
    now = begun(left_by(state, None), 0.0)
    np.testing.assert_allclose(now.x[LEFT], state.x[LEFT])
    added = now.P[np.ix_(LEFT, LEFT)] - state.P[np.ix_(LEFT, LEFT)]
    assert np.linalg.eigvalsh(added)[0] > -1e-12
    np.testing.assert_allclose(now.P[np.ix_(AIR, AIR)], state.P[np.ix_(AIR, AIR)])


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 30.0), st.floats(0.0, 30.0))
def test_the_older_it_is_the_less_it_says_of_the_wind(seed, one_s, more_s):
    left = left_by(flown(seed), CAMERA)
    sooner, later = begun(left, one_s), begun(left, one_s + more_s)
    for state in (sooner, later):
        assert np.linalg.eigvalsh(state.P)[0] > 0.0
    felt = np.zeros((2, States.SIZE))
    felt[:, States.WIND_FORCE] = np.eye(2)
    spread = [np.trace(felt @ each.P @ felt.T) for each in (sooner, later)]
    assert spread[0] <= spread[1]
    assert np.hypot(*later.x[States.GUST_FORCE]) <= np.hypot(*sooner.x[States.GUST_FORCE]) + 1e-12


@pytest.mark.parametrize("since_s", [-1.0, 61.0])
def test_what_is_stale_or_of_another_clock_is_left_out(since_s):
    fresh = begun(None, since_s)
    stale = begun(left_by(flown(1), None), since_s)
    np.testing.assert_array_equal(stale.x, fresh.x)
    np.testing.assert_array_equal(stale.P, fresh.P)


def test_what_is_of_another_size_is_left_out():
    left = left_by(flown(1), None)
    assert left is not None
    fresh = begun(None, 0.0)
    np.testing.assert_array_equal(begun(left._replace(mean=left.mean[1:]), 0.0).x, fresh.x)


def test_who_knows_neither_heading_nor_drag_leaves_nothing():
    state = flown(1)
    P = state.P.copy()
    P[States.DRAG, States.DRAG] = 1.0
    assert left_by(None, CAMERA) is None
    assert left_by(state._replace(heading_known=False), None) is None
    assert left_by(state._replace(P=P), None) is None


def test_the_camera_is_left_whether_air_and_heading_are_known_or_not():
    state = flown(1)._replace(heading_known=False)
    left = left_by(state, CAMERA)
    assert left is not None
    assert left.camera == CAMERA
    np.testing.assert_array_equal(begun(left, 0.0).P, begun(None, 0.0).P)


def test_what_was_learned_before_cameras_were_handed_on_is_read():
    assert learned_of(1.0, [2.0], [3.0]) == Learned(1.0, (2.0,), (3.0,), None)


def test_a_start_is_recorded_with_it_bit_for_bit():
    start = Start(t_s=1.0, position_ned_m=PLACE, learned=left_by(flown(3), CAMERA))
    again = decode(encode(start))
    assert isinstance(again, Start)
    assert again.learned == start.learned
