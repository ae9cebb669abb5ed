"""An attitude that does not come is carried on by the gyro, and by it alone."""

import math

import numpy as np
import pytest

from vwnav.estimation.beginning.starts import Start, first_state
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.context import Context
from vwnav.estimation.inertial.attitudes import AttitudeHistory
from vwnav.estimation.inertial.imu import ImuHistory
from vwnav.estimation.process import predict
from vwnav.estimation.states import States
from vwnav.geometry.rotations import quat_from_vector
from vwnav.types import Attitude

RATE = np.array([0.2, -0.3, 0.5])  # rad/s


def turning(until_s: float, gyro_until_s: float) -> AttitudeHistory:
    """Attitudes at 50 Hz up to a time, the gyro up to another."""
    attitudes = AttitudeHistory(10.0)
    gyro = attitudes.gyro
    gyro.begin(0.0)
    for i in range(round(50 * gyro_until_s)):
        gyro.turn(0.02 * (i + 1), 0.02 * RATE, 0.02)
    for i in range(round(50 * until_s) + 1):
        attitudes.add(Attitude(0.02 * i, quat_from_vector(0.02 * i * RATE)))
    return attitudes


def off_rad(attitudes: AttitudeHistory, t_s: float) -> float:
    return 2.0 * math.acos(
        min(1.0, abs(attitudes.held(t_s).quat_wxyz @ quat_from_vector(t_s * RATE)))
    )


@pytest.mark.parametrize("t_s", [1.05, 1.5, 3.0])
def test_beyond_the_newest_attitude_it_turns_as_the_gyro_says(t_s):
    attitudes = turning(1.0, 3.0)
    assert attitudes.held(t_s).known
    assert attitudes.held(t_s).from_wxyz == pytest.approx(quat_from_vector(RATE), abs=1e-3)
    assert off_rad(attitudes, t_s) < 1e-3


def test_without_the_gyro_nobody_tells():
    attitudes = turning(1.0, 1.0)
    assert not attitudes.held(1.5).known
    assert attitudes.at(1.5) is None
    assert attitudes.held(1.5).from_wxyz is None


def test_a_sample_after_a_silence_carries_no_attitude_on():
    """Of how it turns since that tells nothing: it was taken for an aircraft that turns no more."""
    attitudes = turning(1.0, 0.5)
    attitudes.gyro.begin(1.0)
    assert attitudes.gyro.between(1.0, 1.0) == pytest.approx([1.0, 0.0, 0.0, 0.0])
    assert attitudes.gyro.between(1.0, 1.09) is None
    assert attitudes.at(1.09) is None


def test_where_the_clock_has_slipped_no_image_is_told_an_attitude():
    """A simulator stood for 0.6 s: what came before the slip was seen may be anywhere in it.

    An image in it was told one that was 10 degrees off; one as a keyframe was 3 sigmas, for 4 s.
    """
    attitudes, stood_s = turning(1.0, 1.0), 0.6
    for i in range(51, 100):
        attitudes.gyro.turn(0.02 * i + stood_s, 0.02 * RATE, 0.02)
        attitudes.add(Attitude(0.02 * i + stood_s, quat_from_vector(0.02 * i * RATE)))
    assert [attitudes.at(t_s) for t_s in (1.01, 1.3, 1.61)] == [None] * 3
    assert attitudes.at(0.99) is not None
    assert attitudes.at(1.63).quat_wxyz == pytest.approx(quat_from_vector(1.03 * RATE), abs=1e-3)
    # What was felt was felt: the body has turned by what the gyro counted, across the slip too.
    turned = attitudes.gyro.between(1.0, 1.7)
    assert turned == pytest.approx(quat_from_vector(0.1 * RATE), abs=1e-6)


def test_a_slow_sensor_and_a_clock_that_is_a_third_slow_are_no_slip():
    """Samples of 10 Hz, dated 0.143 s apart: an ArduCopter's images had no attitude any more."""
    attitudes = turning(1.0, 1.0)
    for i in range(1, 10):
        attitudes.gyro.turn(1.0 + 0.143 * i, 0.1 * RATE, 0.1)
        attitudes.add(Attitude(1.0 + 0.143 * i, quat_from_vector((1.0 + 0.1 * i) * RATE)))
    assert attitudes.at(1.5) is not None


def test_it_is_not_carried_on_for_ever():
    assert not turning(1.0, 7.0).held(6.5).known


def test_in_a_silence_the_autopilot_s_heading_may_be_realigned_unseen():
    attitudes, config = turning(1.0, 1.0), EkfConfig()
    start = first_state(Start(t_s=1.0, position_ned_m=np.zeros(3)), config)
    start.P[States.HEADING_BIAS, States.HEADING_BIAS] = 0.0
    after = predict(start, 21.0, Context(config, attitudes, ImuHistory(attitudes, 10.0)))
    sigma_rad = math.sqrt(after.P[States.HEADING_BIAS, States.HEADING_BIAS])
    # A real one turned by 2.2 degrees while its navigator slept for 20 s.
    assert math.radians(1.1) < sigma_rad < math.radians(2.2)
