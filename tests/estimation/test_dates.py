"""What a wrong date of an image may have done to its way, and to its fix."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import toeplitz
from scipy.spatial.transform import Rotation

from vwnav.estimation.beginning.starts import Start, first_state
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.events import NedFix
from vwnav.estimation.inertial.attitudes import AttitudeHistory
from vwnav.estimation.inertial.dates import DateCheck, of_doubtful_date
from vwnav.estimation.inertial.imu import ImuHistory
from vwnav.estimation.inertial.integrals import ImuIntegrals
from vwnav.estimation.odometry_gate import OdometryGate
from vwnav.estimation.states import States
from vwnav.types import Attitude, OdometryMotion

SURE_M2 = 0.01**2


def made_unsure_m2(lean: Rotation, agl_m: float, rate_rad_s: float):
    """(3, 3) what the dates add, of images from `lean` to level, while it pitches at both."""
    attitudes = AttitudeHistory(10.0)
    attitudes.gyro.begin(0.0)
    turn_rad = np.array([0.0, 0.01 * rate_rad_s, 0.0])
    for n in range(1, 101):
        attitudes.gyro.turn(0.01 * n, turn_rad, 0.01)
    quats = (lean.as_quat(scalar_first=True), np.array([1.0, 0.0, 0.0, 0.0]))
    for t_s, quat in zip((0.5, 0.6), quats, strict=True):
        attitudes.add(Attitude(t_s, quat))
    way = OdometryMotion(
        t0_s=0.5,
        t1_s=0.6,
        displacement_ned_m=np.zeros(3),
        covariance_ned_m2=SURE_M2 * np.eye(3),
        yaw_increment_rad=0.0,
        sigma_yaw_rad=0.001,
        agl_m=agl_m,
        tracks=100,
    )
    gate = OdometryGate(attitudes, ImuHistory(attitudes, 10.0), EkfConfig())
    told = gate.displacement(way).motion.covariance_ned_m2
    return told - SURE_M2 * np.eye(3)


@given(
    st.floats(-0.7, 0.7), st.floats(-0.7, 0.7), st.floats(-3.0, 3.0),
    st.floats(5.0, 100.0), st.floats(0.0, 2.0),
)  # fmt: skip
def test_a_wrong_date_shows_ways_across_the_sight_and_aslant_along_it(
    roll, pitch, yaw, agl_m, rate_rad_s
):
    lean = Rotation.from_euler("ZYX", [yaw, pitch, roll])
    sight = lean.apply([0.0, 0.0, 1.0])
    added_m2 = made_unsure_m2(lean, agl_m, rate_rad_s)
    turned_rad = EkfConfig().picture_date_s * rate_rad_s
    leaning, level = agl_m * turned_rad / sight[2], agl_m * turned_rad
    # Across a leaning image's sight only the level one's adds along it, and so the other way round.
    sin2 = 1.0 - sight[2] ** 2
    is_hard = sin2 > (0.25 * sight[2]) ** 2
    along = leaning**2 * sin2 / sight[2] ** 2 if is_hard else 0.0
    # Rows that are read one after the other stretch each of the two: half of that is height.
    stretched = 2.0 * (0.8 * level) ** 2
    expected = level**2 * sin2 + along + stretched * sight[2] ** 2
    assert sight @ added_m2 @ sight == pytest.approx(expected, rel=1e-3, abs=1e-9)
    vertical = (2.0 if is_hard else 1.0) * leaning**2 * sin2 + stretched
    assert added_m2[2, 2] == pytest.approx(vertical, rel=1e-3, abs=1e-9)
    expected = 2.0 * (leaning**2 + level**2) + along + stretched
    assert np.trace(added_m2) == pytest.approx(expected, rel=1e-3, abs=1e-9)


@pytest.mark.parametrize("spacing_s", [0.2, 0.4, 1.0])
def test_doubtful_fixes_tell_as_much_as_an_error_they_share_leaves(spacing_s):
    count, speed_m_s = 8, 20.0
    state = first_state(Start(t_s=0.0, position_ned_m=np.array([0.0, 0.0, -1e-6])), EkfConfig())
    state.x[3] = speed_m_s
    told, last_s = 0.0, None
    for n in range(count):
        fix = NedFix(
            t_s=100.0 + n * spacing_s,
            position_ne_m=np.zeros(2),
            covariance_ne_m2=1e-6 * np.eye(2),
        )
        doubted = of_doubtful_date(fix, state._replace(t_last_fix_s=last_s), AttitudeHistory(1.0))
        told += 1.0 / doubted.covariance_ne_m2[0, 0]
        last_s = fix.t_s
    # The least-squares mean of correlated samples: 1 / (1' C^-1 1).
    C_m2 = (0.5 * speed_m_s) ** 2 * toeplitz(np.exp(-spacing_s * np.arange(count)))
    expected = np.ones(count) @ np.linalg.solve(C_m2, np.ones(count))
    assert told == pytest.approx(expected, rel=1e-3)


def checked(
    seed: int,
    late_s: float,
    gain: float,
    keyframes_s: float = 3.0,
    refused_every: int = 10_000,
    image_s: float = 0.1,
) -> list[bool]:
    """Whether images, that late and of a ground that moves by `gain`, are right, in a minute."""
    rng = np.random.default_rng(seed)
    # North and east: a velocity of some metres a second that swings within seconds.
    rates, phases = rng.uniform(0.5, 1.6, (4, 2)), rng.uniform(0.0, 2.0 * np.pi, (4, 2))

    def velocity_m_s(t_s: float) -> np.ndarray:
        return np.array([4.0, 0.0]) + np.sum(np.sin(rates * t_s + phases), axis=0)

    def place_m(t_s: float) -> np.ndarray:
        return np.array([4.0, 0.0]) * t_s - np.sum(np.cos(rates * t_s + phases) / rates, axis=0)

    check, told = DateCheck(), []
    state = first_state(Start(t_s=0.0, position_ned_m=np.array([0.0, 0.0, -50.0])), EkfConfig())
    state.P[States.VELOCITY, States.VELOCITY] = 2.0**2 * np.eye(3)  # which tells nothing
    every = round(keyframes_s / image_s)
    for n in range(round(60.0 / image_s)):
        t_s, keyframe_s = image_s * n, image_s * ((n - 1) // every * every)
        way_m = gain * (place_m(t_s - late_s) - place_m(keyframe_s - late_s))
        way_m = np.append(way_m + rng.normal(0.0, 0.03, 2), 0.0)
        sigmas_m2 = 0.07**2 * np.eye(3)
        motion = OdometryMotion(keyframe_s, t_s, way_m, sigmas_m2, 0.0, 0.003, 50.0, 99)
        integrals = np.zeros((3, 5))
        integrals[:2, 3] = velocity_m_s(t_s) + 0.05 * t_s  # an accelerometer's bias
        felt = ImuIntegrals(0, t_s, integrals, np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(2))
        check.see(motion, felt, state)
        if n % refused_every == refused_every - 1:
            check.refused()
        told.append(check.are_right(t_s))
    return told


@given(st.integers(0, 10_000), st.sampled_from([0.4, 3.0]), st.sampled_from([0.2, 0.1, 1 / 30]))
@settings(max_examples=20)
def test_an_aircraft_that_changes_its_speed_shows_of_which_moment_images_are(
    seed, keyframes_s, image_s
):
    assert checked(seed, 0.0, 1.0, keyframes_s, image_s=image_s)[-1]


@given(st.integers(0, 10_000), st.sampled_from([(0.5, 1.0), (0.3, 1.0), (0.0, 0.0)]))
@settings(max_examples=30)
def test_images_of_another_moment_or_of_no_ground_never_are_right(seed, late_and_gain):
    assert not any(checked(seed, *late_and_gain))


@given(st.integers(0, 10_000))
@settings(max_examples=10)
def test_nor_are_images_whose_ways_are_refused_now_and_then(seed):
    """Of a focus that hunts they agreed for some seconds: believed, and lost again, and landed."""
    assert not any(checked(seed, 0.0, 1.0, refused_every=10))


def test_without_an_imu_or_in_a_steady_flight_nothing_is_known_of_them():
    check = DateCheck()
    state = first_state(Start(t_s=0.0, position_ned_m=np.array([0.0, 0.0, -50.0])), EkfConfig())
    for n in range(300):
        t_s, way_m = 0.1 * n, np.array([0.4 * n, 0.0, 0.0])
        motion = OdometryMotion(0.0, t_s, way_m, SURE_M2 * np.eye(3), 0.0, 0.003, 50.0, 99)
        steady = ImuIntegrals(0, t_s, np.zeros((3, 5)), np.array([1.0, 0, 0, 0]), np.zeros(2))
        check.see(motion, None if n < 150 else steady, state)
        assert not check.are_right(t_s)


@pytest.mark.parametrize("attitude_hz", [50.0, 30.0])
@pytest.mark.parametrize("rate_rad_s", [0.2, 1.2])
def test_how_fast_it_tilts_attitudes_tell_where_no_gyro_does(attitude_hz, rate_rad_s):
    """With nothing to tell it was taken to stand still: in a swing 0.6 m off at a sigma of 0.1."""
    with_gyro, without = AttitudeHistory(10.0), AttitudeHistory(10.0)
    with_gyro.gyro.begin(0.0)
    for n in range(1, 101):
        with_gyro.gyro.turn(0.01 * n, np.array([0.0, 0.01 * rate_rad_s, 0.0]), 0.01)
    for t_s in np.arange(0.0, 1.0, 1.0 / attitude_hz).tolist():
        pitched = Rotation.from_euler("Y", rate_rad_s * (t_s - 0.5))
        for attitudes in (with_gyro, without):
            attitudes.add(Attitude(t_s, pitched.as_quat(scalar_first=True)))
    told, guessed = with_gyro.exposure(0.55), without.exposure(0.55)
    assert told.tilts_rad_s == pytest.approx(rate_rad_s, rel=1e-3)
    assert guessed.tilts_rad_s == pytest.approx(rate_rad_s, rel=1e-3)
