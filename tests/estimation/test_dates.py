"""What a wrong date of an image may have done to its way, and to its fix."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import toeplitz
from scipy.spatial.transform import Rotation

from vwnav.estimation.beginning.starts import Start, first_state
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.disputes import of_doubtful_date
from vwnav.estimation.events import NedFix
from vwnav.estimation.inertial.attitudes import AttitudeHistory
from vwnav.estimation.odometry_gate import OdometryGate
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
    told = OdometryGate(attitudes, EkfConfig()).displacement(way).motion.covariance_ned_m2
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
        doubted = of_doubtful_date(fix, state._replace(t_last_fix_s=last_s))
        told += 1.0 / doubted.covariance_ne_m2[0, 0]
        last_s = fix.t_s
    # The least-squares mean of correlated samples: 1 / (1' C^-1 1).
    C_m2 = (0.5 * speed_m_s) ** 2 * toeplitz(np.exp(-spacing_s * np.arange(count)))
    expected = np.ones(count) @ np.linalg.solve(C_m2, np.ones(count))
    assert told == pytest.approx(expected, rel=1e-3)


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
