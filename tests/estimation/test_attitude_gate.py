"""Attitudes that could have been turned to are believed, and only those."""

import math
import tracemalloc

import numpy as np
import pytest

from vwnav.estimation.beginning.starts import Start
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.ekf import Ekf
from vwnav.estimation.events import NedFix
from vwnav.estimation.inertial.attitude_gate import AttitudeGate
from vwnav.estimation.inertial.attitudes import AttitudeHistory, GyroHistory
from vwnav.estimation.inertial.imu import ImuHistory
from vwnav.estimation.states import Verdict
from vwnav.geometry.rotations import quat_from_rotation, rotation_from_euler
from vwnav.types import Attitude, Height, ImuSample, OdometryMotion

STEP_S = 0.02
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
HOVER = np.array([0.0, 0.0, -9.80665])


def quat(yaw_deg: float, pitch_deg: float = -8.0):
    angles = 0.0, math.radians(pitch_deg), math.radians(yaw_deg)
    return quat_from_rotation(rotation_from_euler(*angles))


def cruising(seconds: float, imu: bool, quat_at=lambda t: quat(118.0)) -> Ekf:
    """Told its attitude, height and perhaps its IMU at 50 Hz."""
    ekf = Ekf(EkfConfig())
    above = np.array([0.0, 0.0, -50.0])
    ekf.initialise(Start(t_s=0.0, position_ned_m=above, sigma_m=0.5, agl_m=50.0))
    go_on(ekf, 0.0, seconds, imu, quat_at)
    return ekf


def go_on(ekf, start_s, seconds, imu, quat_at=lambda t: quat(118.0), rates=(0.0, 0.0, 0.0)):
    verdicts = []
    for i in range(1, round(seconds / STEP_S) + 1):
        t_s = start_s + STEP_S * i
        verdicts.append(ekf.handle(Attitude(t_s, quat_at(t_s))).verdict)
        if imu:
            ekf.handle(ImuSample(t_s, HOVER, np.array(rates)))
        ekf.handle(Height(t_s, 50.0))
    return verdicts


@pytest.mark.parametrize("imu", [True, False])
def test_one_level_attitude_among_right_ones_is_refused_and_leaves_no_trace(imu):
    ekf, untouched = cruising(2.0, imu), cruising(2.0, imu)
    assert ekf.handle(Attitude(2.01, LEVEL)).verdict is Verdict.GATED
    for each in (ekf, untouched):
        assert set(go_on(each, 2.0, 1.0, imu)) == {Verdict.FUSED}
    first, second = ekf.estimate(3.0), untouched.estimate(3.0)
    assert np.array_equal(first.velocity_ned_m_s, second.velocity_ned_m_s)
    assert np.array_equal(first.quat_wxyz, second.quat_wxyz)


@pytest.mark.parametrize("imu", [True, False])
@pytest.mark.parametrize("turned_deg", [0.0, 118.0])
def test_level_attitudes_while_the_link_is_cut_are_none_of_the_autopilot(imu, turned_deg):
    """15 a second for five, as images came: nothing else of the autopilot is heard meanwhile."""
    ekf = cruising(2.0, imu, lambda t: quat(turned_deg))
    for i in range(75):
        ekf.handle(Attitude(2.0 + (i + 1) / 15.0, LEVEL))
        ekf.estimate(2.0 + (i + 1) / 15.0)
    assert ekf.attitudes.at(4.0) is None
    assert ekf.attitudes.at(7.0) is None
    go_on(ekf, 7.0, 0.2, imu, lambda t: quat(turned_deg))
    assert ekf.attitudes.at(7.2) is not None


def test_without_attitude_the_estimate_gets_as_unsure_as_an_aircraft_can_move():
    ekf = cruising(10.0, imu=True)
    before, after = ekf.estimate(10.0), ekf.estimate(15.0)
    assert after.sigma_horizontal_m > before.sigma_horizontal_m + 25.0
    assert after.sigma_yaw_rad > 1.0


def test_odometry_counted_in_an_attitude_that_was_refused_is_refused():
    ekf = cruising(2.0, imu=True)
    ekf.handle(Attitude(2.01, LEVEL))
    go_on(ekf, 2.0, 0.2, imu=True)
    way = np.array([1.0, 0.0, 0.0])
    for t0_s, t1_s in ((2.01, 2.1), (1.9, 2.01)):
        motion = OdometryMotion(t0_s, t1_s, way, 0.01 * np.eye(3), 0.0, 0.01, 50.0, 99)
        assert ekf.handle(motion).verdict is Verdict.NO_ATTITUDE


def test_odometry_faster_than_any_aircraft_is_refused():
    ekf = cruising(2.0, imu=True)
    way = np.array([5.0, 0.0, 0.0])
    motion = OdometryMotion(1.9, 2.0, way, 0.01 * np.eye(3), 0.0, 0.01, 50.0, 99)
    assert ekf.handle(motion).verdict is Verdict.IMPOSSIBLE


@pytest.mark.parametrize("imu", [True, False])
def test_a_heading_that_the_autopilot_resets_is_followed_within_a_quarter_second(imu):
    ekf = cruising(2.0, imu)
    verdicts = go_on(ekf, 2.0, 0.3, imu, lambda t: quat(131.0))
    assert verdicts[0] is Verdict.GATED
    assert verdicts[-1] is Verdict.FUSED
    assert ekf.attitudes.at(2.25) is not None


@pytest.mark.parametrize("tilts_deg", [0.0, 6.0])
@pytest.mark.parametrize("imu_apart_s", [0.12, 0.5, math.inf])
def test_a_quarter_turn_by_reset_is_followed_where_an_imu_was_heard_and_tells_nothing(
    tilts_deg, imu_apart_s
):
    """One that fell silent, or comes seldom, vouched for no attitude: all were refused for good."""
    ekf, imu_s, verdicts = cruising(2.0, imu=True), 2.0, []
    for n in range(1, 301):
        t_s = 2.0 + STEP_S * n
        turned = quat(118.0) if t_s < 4.0 else quat(-142.0, tilts_deg - 8.0)
        verdicts.append(ekf.handle(Attitude(t_s, turned)).verdict)
        ekf.handle(Height(t_s, 50.0))
        if t_s >= imu_s + imu_apart_s:
            imu_s = t_s
            ekf.handle(ImuSample(t_s, HOVER, np.zeros(3)))
    assert set(verdicts[:99]) == {Verdict.FUSED}
    assert verdicts[-1] is Verdict.FUSED
    assert ekf.attitudes.at(8.0).quat_wxyz == pytest.approx(quat(-142.0, tilts_deg - 8.0))


@pytest.mark.parametrize("jump_deg", [-90.0, -20.0, 30.0, 170.0])
@pytest.mark.parametrize("tilts_deg", [0.0, 6.0])
def test_a_reset_attitude_turns_no_image_that_was_taken_before_it_was_believed(jump_deg, tilts_deg):
    """A keyframe of that time had the new heading, and the old one's error: 30 degrees between.

    What is told of the attitude at an image's time stays so, and later images meet it there.
    """
    ekf = Ekf(EkfConfig())
    above = np.array([0.0, 0.0, -50.0])
    ekf.initialise(Start(t_s=0.0, position_ned_m=above, sigma_m=0.5, agl_m=50.0))
    ekf.handle(
        NedFix(
            t_s=0.0, position_ne_m=np.zeros(2), covariance_ne_m2=0.01 * np.eye(2),
            yaw_rad=math.radians(118.0), sigma_yaw_rad=0.02, agl_m=50.0, sigma_agl_m=0.5,
        )
    )  # fmt: skip
    told: dict[float, np.ndarray] = {}
    refused = []
    for i in range(1, 250):
        t_s = STEP_S * i
        jumped = t_s > 3.03
        ekf.handle(Attitude(t_s, quat(118.0 + jumped * jump_deg, jumped * tilts_deg)))
        ekf.handle(ImuSample(t_s, HOVER, np.zeros(3)))
        ekf.handle(Height(t_s, 50.0))
        if i % 5:
            continue
        told[t_s] = ekf.attitudes.at(t_s).quat_wxyz
        if (before_s := STEP_S * (i - 5)) in told:
            seen = OdometryMotion(before_s, t_s, np.zeros(3), 1e-4 * np.eye(3), 0.0, 0.01, 50.0, 99)
            way = ekf.handle(seen)
            refused += [t_s for part in way.parts if part.verdict is not Verdict.FUSED]
    assert not refused
    for t_s, quat_wxyz in told.items():
        if t_s > 250 * STEP_S - 2.0:
            assert ekf.attitudes.at(t_s).quat_wxyz == pytest.approx(quat_wxyz, abs=1e-6)


def test_a_turn_of_90_degrees_a_second_is_one():
    ekf = cruising(2.0, True, lambda t: quat(118.0, 0.0))
    turning = go_on(
        ekf, 2.0, 1.0, True, lambda t: quat(90.0 * (t - 2.0) + 118.0, 0.0), (0.0, 0.0, 1.5708)
    )
    assert turning.count(Verdict.FUSED) == 50


def test_duplicates_stale_ones_and_no_numbers_are_refused():
    ekf = cruising(2.0, imu=True)
    assert ekf.handle(Attitude(2.0, quat(118.0))).verdict is Verdict.DUPLICATE
    assert ekf.handle(Attitude(1.99, LEVEL)).verdict is Verdict.GATED
    assert ekf.handle(Attitude(-50.0, quat(118.0))).verdict is Verdict.GATED
    assert ekf.handle(Attitude(2.01, np.full(4, np.nan))).verdict is Verdict.NOT_FINITE


def test_one_wrong_sample_of_the_imu_is_refused_and_a_blow_makes_unsure():
    ekf, calm = cruising(2.0, imu=True), cruising(2.0, imu=True)
    assert ekf.handle(ImuSample(2.01, np.array([90.0, 0.0, 0.0]), np.zeros(3))).verdict is (
        Verdict.GATED
    )
    for each in (ekf, calm):
        go_on(each, 2.0, 0.2, imu=True)
    struck, quiet = ekf.estimate(2.2), calm.estimate(2.2)
    assert np.max(np.abs(struck.velocity_ned_m_s - quiet.velocity_ned_m_s)[:2]) < 0.1
    assert struck.covariance[3, 3] > quiet.covariance[3, 3]


def test_heights_of_once_a_second_are_company_enough():
    ekf = Ekf(EkfConfig())
    above = np.array([0.0, 0.0, -50.0])
    ekf.initialise(Start(t_s=0.0, position_ned_m=above, sigma_m=0.5, agl_m=50.0))
    verdicts = []
    for i in range(1, 200):
        verdicts.append(ekf.handle(Attitude(0.05 * i, quat(118.0))).verdict)
        if i % 20 == 0:
            ekf.handle(Height(0.05 * i, 50.0))
    assert verdicts[100:].count(Verdict.FUSED) == 99


def test_attitudes_that_nothing_vouches_for_are_not_kept_for_ever():
    gyro = GyroHistory(10.0)
    attitudes = AttitudeHistory(10.0, gyro)
    gate = AttitudeGate(attitudes, ImuHistory(attitudes, 10.0))
    gate.heard(0.0)
    tracemalloc.start()
    verdicts = {gate.take(Attitude(STEP_S * i, LEVEL)) for i in range(20_000)}
    kept_bytes = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert Verdict.GATED in verdicts
    assert kept_bytes < 6e5


def test_attitudes_that_were_doubted_until_they_were_believed_are_none_that_jumped():
    """A line that hung hands over the end of what it held back, in the midst of a brake."""
    ekf = cruising(2.0, True, lambda t: quat(0.0))
    rate, brakes_s = math.radians(200.0), 2.96

    def braking(t_s):
        return quat(0.0, -4.0 + math.degrees(rate * (t_s - brakes_s)))

    verdicts = go_on(ekf, brakes_s, 0.12, True, braking, (0.0, rate, 0.0))
    assert verdicts[0] is not Verdict.FUSED
    assert verdicts[-1] is Verdict.FUSED
    told, known = ekf.estimate(brakes_s + 0.12).quat_wxyz, braking(brakes_s + 0.12)
    assert 2.0 * math.acos(min(1.0, abs(told @ known))) < math.radians(1.5)
