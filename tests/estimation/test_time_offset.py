"""By how much images are dated wrongly is learned of turns, brakes and fixes."""

import math

import numpy as np
import pytest
from honesty import worst_sigmas
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.quick import first_quick
from vwnav.bench.estimator.flown import Run
from vwnav.bench.estimator.run import play
from vwnav.bench.estimator.streams import sense
from vwnav.bench.estimator.world import FilterWorld, fly
from vwnav.estimation.beginning.other_camera import found_in, seen_by
from vwnav.estimation.beginning.starts import Start, first_state
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.ekf import Ekf
from vwnav.estimation.events import Recalibrated
from vwnav.estimation.inertial.attitudes import AttitudeHistory
from vwnav.estimation.inertial.dates import misdated
from vwnav.estimation.states import FilterState, States
from vwnav.types import Attitude, Frame
from vwnav.vehicle import FoundCamera, Learned

OFFSET = States.TIME_OFFSET
UPRIGHT = tuple(np.eye(3).ravel().tolist())


def flown(seed: int, late_s: float, imu_hz: float, config: EkfConfig | None = None) -> Run:
    """Two minutes in wind, with turns and fixes."""
    world = FilterWorld(seconds=120.0, imu_hz=imu_hz, dated_late_s=late_s)
    rng = np.random.default_rng(seed)
    return play(sense(world, fly(world, [rng])[0], rng), config or EkfConfig())


@pytest.mark.parametrize(
    ("seed", "late_s", "imu_hz"),
    first_quick(
        [
            (1, 0.1, 50.0),
            (6, 0.2, 50.0),
            (2, 0.05, 0.0),
            (3, -0.05, 50.0),
            (4, 0.1, 0.0),
            (5, 0.05, 50.0),
        ]
    ),
)
def test_images_that_are_dated_late_or_early_tell_by_how_much(seed, late_s, imu_hz):
    """Of fast turns within such a time the filter, which dates nothing anew, learns a part."""
    run = flown(seed, late_s, imu_hz)
    assert run.last.x[OFFSET] == pytest.approx(-late_s, abs=0.005 + 0.2 * abs(late_s))
    assert worst_sigmas(run) < 4.5


@pytest.mark.long
def test_without_that_they_cost_metres():
    believed, learned = (
        float(np.hypot(*flown(1, 0.1, 50.0, config).rows.error_ne_m.T).mean())
        for config in (EkfConfig(time_offset_sigma_s=1e-6), None)
    )
    assert believed > 1.5 * learned


@pytest.mark.parametrize("imu_hz", [0.0, 50.0])
def test_where_dates_are_right_little_is_lost(imu_hz):
    known, open_ = (
        flown(1, 0.0, imu_hz, EkfConfig(time_offset_sigma_s=sigma_s)) for sigma_s in (1e-6, 0.08)
    )
    mean_m = [float(np.hypot(*run.rows.error_ne_m.T).mean()) for run in (known, open_)]
    assert mean_m[1] < mean_m[0] + 0.1
    assert abs(open_.last.x[OFFSET]) < 0.004


def state_with(off_s: float, sigma_s: float) -> FilterState:
    state = first_state(Start(t_s=100.0, position_ned_m=np.zeros(3)), EkfConfig())
    x, P = state.x.copy(), state.P.copy()
    x[OFFSET], P[OFFSET, OFFSET] = off_s, sigma_s**2
    return state._replace(x=x, P=P)


@pytest.mark.parametrize(
    ("off_s", "sigma_s", "worth"),
    [(-0.06, 0.01, True), (0.05, 0.015, True), (-0.06, 0.018, False), (-0.06, 0.021, False)],
)
def test_images_are_dated_anew_as_soon_as_it_is_sure(off_s, sigma_s, worth):
    event = misdated(state_with(off_s, sigma_s)._replace(t_last_fix_s=99.0), 100.0)
    assert (event is not None) is worth
    if event is not None:
        assert event.redated_s == off_s
        assert event.t_s == 100.0 + min(off_s, 0.0)  # what is dated by then is of before


@pytest.mark.parametrize(("off_s", "worth"), [(-0.07, True), (0.05, False)])
def test_before_a_fix_was_found_it_has_to_be_more(off_s, worth):
    assert (misdated(state_with(off_s, 0.01), 100.0) is not None) is worth


@pytest.mark.parametrize("off_s", [-0.08, 0.03])
def test_dated_anew_they_are_off_by_the_rest_and_less_surely(off_s):
    ekf = Ekf(EkfConfig())
    ekf.initialise(Start(t_s=0.0, position_ned_m=np.array([0.0, 0.0, -50.0]), agl_m=50.0))
    ekf.handle(Attitude(0.0, np.array([1.0, 0.0, 0.0, 0.0])))
    assert ekf.handle(Recalibrated(0.1, redated_s=off_s)).accepted
    state = ekf.state
    assert state is not None
    assert state.x[OFFSET] == pytest.approx(-off_s)
    assert math.sqrt(state.P[OFFSET, OFFSET]) == pytest.approx(0.3 * abs(off_s))


@pytest.mark.parametrize(("mirrored", "time_offset_s"), [(0.0, -0.1), (1.0, 0.02), (1.0, 0.0)])
def test_an_image_is_seen_as_of_the_camera_that_was_told(mirrored, time_offset_s):
    image = np.arange(12, dtype=np.uint8).reshape(3, 4)
    seen = seen_by(FoundCamera(1.0, mirrored, UPRIGHT, time_offset_s), Frame(7.0, image, 3))
    assert seen.t_s == 7.0 + time_offset_s
    np.testing.assert_array_equal(seen.image, image[:, ::-1] if mirrored else image)


@pytest.mark.parametrize("time_offset_s", [math.nan, math.inf, -3600.0])
def test_no_camera_is_taken_on_whose_dates_are_none(time_offset_s):
    camera = FoundCamera(1.0, 0.0, UPRIGHT, time_offset_s)
    assert found_in(Learned(0.0, (), (), camera)) is None


@given(
    st.floats(-0.7, 0.7), st.floats(-0.7, 0.7), st.floats(-3.0, 3.0),
    st.tuples(*[st.floats(-2.0, 2.0)] * 3),
)  # fmt: skip
def test_how_it_turned_is_told_about_level_axes(roll, pitch, yaw, rates_rad_s):
    """Conformance with scipy's rotations."""
    attitudes = AttitudeHistory(10.0)
    held = Rotation.from_euler("ZYX", [yaw, pitch, roll])
    attitudes.gyro.begin(0.0)
    for n in range(1, 61):
        attitudes.gyro.turn(0.01 * n, 0.01 * np.array(rates_rad_s), 0.01)
    attitudes.add(Attitude(0.5, held.as_quat(scalar_first=True)))
    expected = Rotation.from_euler("Z", -yaw).apply(held.apply(rates_rad_s))
    np.testing.assert_allclose(attitudes.exposure(0.5).turns_rad_s, expected, atol=2e-3)


def test_a_heading_that_is_reset_is_no_turn():
    attitudes = AttitudeHistory(10.0)
    for n in range(101):
        turned = Rotation.from_euler("Z", 1.5 if n > 50 else 0.0)
        attitudes.add(Attitude(0.01 * n, turned.as_quat(scalar_first=True)))
    assert not np.any(attitudes.exposure(0.515).turns_rad_s)
