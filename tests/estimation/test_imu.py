"""What accelerometer and gyro add to the filter, simulated and recorded by real autopilots."""

import gzip
import itertools
import math
import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from scipy.spatial.transform import Rotation

from vwnav.bench.estimator.run import play
from vwnav.bench.estimator.scores import position_nees
from vwnav.bench.estimator.streams import sense
from vwnav.bench.estimator.world import FilterWorld, fly
from vwnav.estimation.beginning.starts import Start
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.context import Context
from vwnav.estimation.ekf import Ekf
from vwnav.estimation.inertial.attitudes import AttitudeHistory
from vwnav.estimation.inertial.imu import ImuHistory
from vwnav.estimation.inertial.imu_gate import ImuGate
from vwnav.estimation.inertial.preintegration import preintegrated
from vwnav.estimation.process import predict
from vwnav.estimation.states import FilterState, States
from vwnav.geometry.rotations import (
    euler_from_rotation,
    quat_from_rotation,
    rotation_from_euler,
    rotation_from_quat,
)
from vwnav.mavlink.framing import packet_at
from vwnav.mavlink.telemetry.telemetry_state import TelemetryState
from vwnav.types import Attitude, Estimate, Height, ImuSample, OdometryMotion, Stationary

RATE = st.floats(-3.0, 3.0)
AT_REST = np.array([0.0, 0.0, -9.80665])
STEP_S = 0.02


def flying(sigma_heading_rad: float = math.radians(1.0)) -> Ekf:
    ekf = Ekf(EkfConfig(heading_sigma_rad=sigma_heading_rad))
    above = np.array([0.0, 0.0, -50.0])
    ekf.initialise(Start(t_s=0.0, position_ned_m=above, sigma_m=0.5, agl_m=50.0))
    return ekf


def hover(ekf: Ekf, start_s: float, seconds: float, yaw, rates=(0.0, 0.0, 0.0), on_ground=False):
    """Attitude, IMU and barometer of an aircraft that stays; `yaw(t)` is what its filter says."""
    for i in range(1, round(seconds / STEP_S) + 1):
        t_s = start_s + i * STEP_S
        quat = quat_from_rotation(rotation_from_euler(0.0, 0.0, yaw(t_s)))
        ekf.handle(Attitude(t_s, quat))
        ekf.handle(ImuSample(t_s, AT_REST, np.array(rates)))
        ekf.handle(Height(t_s, 50.0))
        if on_ground:
            ekf.handle(Stationary(t_s))
    return start_s + seconds


def yaw_deg(estimate: Estimate) -> float:
    return math.degrees(euler_from_rotation(rotation_from_quat(estimate.quat_wxyz))[2])


def level_attitudes() -> AttitudeHistory:
    history = AttitudeHistory(10.0)
    for i in range(100):
        history.add(Attitude(0.1 * i, np.array([1.0, 0.0, 0.0, 0.0])))
    return history


@given(rates=st.lists(st.tuples(RATE, RATE, RATE), min_size=3, max_size=12))
def test_turns_are_counted_as_scipy_composes_them(rates):
    history = ImuHistory(level_attitudes(), 10.0)
    for i, rate in enumerate(rates):
        history.add(ImuSample(STEP_S * i, AT_REST, np.array(rate)))
    last_s = STEP_S * (len(rates) - 1)
    imu = preintegrated(history.until(0.0), history.until(last_s))
    expected = Rotation.identity()
    for before, after in itertools.pairwise(rates):
        mean = 0.5 * (np.array(before) + np.array(after))
        expected *= Rotation.from_rotvec(STEP_S * mean)
    w, x, y, z = imu.turn_wxyz
    assert (expected.inv() * Rotation.from_quat([x, y, z, w])).magnitude() < 1e-9
    assert imu.velocity_m_s == pytest.approx(AT_REST * last_s)


def test_a_silence_is_not_integrated_over():
    history = ImuHistory(level_attitudes(), 10.0)
    for t_s in (0.0, 0.02, 0.04, 1.0, 1.02):
        history.add(ImuSample(t_s, AT_REST, np.zeros(3)))
    assert history.until(0.5) is None
    assert preintegrated(history.until(0.02), history.until(1.01)) is None
    assert preintegrated(history.until(1.0), history.until(1.02)) is not None


@pytest.mark.parametrize("apart_s", [0.12, 0.2, 0.5])
def test_between_samples_that_come_seldom_an_aircraft_flies_on(apart_s):
    """It stood for a tenth of a second after each: a fifth of the way was lost at 2 Hz."""
    attitudes = AttitudeHistory(10.0)
    imu = ImuHistory(attitudes, 10.0)
    context = Context(EkfConfig(), attitudes, imu)
    x = np.zeros(States.SIZE)
    x[States.DRAG] = context.config.drag_per_s
    x[States.POSITION], x[States.VELOCITY_NE] = (0.0, 0.0, -50.0), (8.0, 0.0)
    state = FilterState(0.0, x, np.eye(States.SIZE), True, True, 0.0, 0.0)
    for t_s in (0.02 * np.arange(1, 101)).tolist():
        attitudes.add(Attitude(t_s, np.array([1.0, 0.0, 0.0, 0.0])))
        if t_s >= imu.newest_s + apart_s:
            imu.add(ImuSample(t_s, AT_REST, np.zeros(3), apart_s))
        state = predict(state, t_s, context)
    assert state.x[States.POSITION_NE] == pytest.approx([16.0, 0.0], abs=0.01)


def test_a_correction_of_our_clock_makes_no_turn_longer():
    history = ImuHistory(level_attitudes(), 10.0)
    rates = np.array([0.0, 0.0, 1.0])
    for i in range(50):
        slipped_s = 0.04 if i > 25 else 0.0
        history.add(ImuSample(STEP_S * i + slipped_s, AT_REST, rates, STEP_S))
    imu = preintegrated(history.until(0.0), history.until(STEP_S * 49 + 0.04))
    assert 2.0 * math.atan2(imu.turn_wxyz[3], imu.turn_wxyz[0]) == pytest.approx(STEP_S * 49)
    assert imu.span_s == pytest.approx(STEP_S * 49)


@given(
    st.floats(2.0, 15.0),
    st.lists(st.floats(0.0005, 0.6), min_size=1, max_size=8),
    st.floats(0.001, 0.09),
)
def test_an_aircraft_flies_for_as_long_as_the_sensors_own_clock_says(speed_m_s, apart_s, ahead_s):
    """Dates that lie apart are a simulator's that stood, or slips of a link: 4.5 m by 0.6 s."""
    attitudes = AttitudeHistory(10.0)
    imu = ImuHistory(attitudes, 10.0)
    context = Context(EkfConfig(), attitudes, imu)
    dates_s = np.cumsum([0.0, *[0.02] * 20, *apart_s])
    for date_s in dates_s.tolist():
        attitudes.add(Attitude(date_s, np.array([1.0, 0.0, 0.0, 0.0])))
        imu.add(ImuSample(date_s, AT_REST, np.zeros(3), 0.02))
    x = np.zeros(States.SIZE)
    x[States.DRAG] = context.config.drag_per_s
    x[States.POSITION], x[States.VELOCITY_NE] = (0.0, 0.0, -50.0), (speed_m_s, 0.0)
    state = FilterState(0.0, x, np.eye(States.SIZE), True, True, 0.0, 0.0)
    newest_s = float(dates_s[-1])
    state = predict(predict(state, newest_s, context), newest_s + ahead_s, context)
    flown_s = 0.02 * (len(dates_s) - 1) + ahead_s
    assert state.x[States.POSITION_NE] == pytest.approx([speed_m_s * flown_s, 0.0], abs=0.01)


@pytest.mark.parametrize("late_s", [0.0, 0.06])
@pytest.mark.parametrize(("imu", "wrong_deg"), [(True, 0.0), (False, 15.0)])
def test_a_heading_that_the_autopilot_resets_by_15_degrees_is_not_a_turn(imu, wrong_deg, late_s):
    """No fix comes. Barometric heights may be newer than the attitude: it is then carried on."""
    ekf, step_s = flying(), 0.06
    for i in range(1, 400):
        t_s = i * step_s
        yaw_rad = math.radians(15.0 if i > 200 else 0.0)
        quat = quat_from_rotation(rotation_from_euler(0.0, 0.0, yaw_rad))
        ekf.handle(Attitude(t_s, quat))
        if imu:
            ekf.handle(ImuSample(t_s, AT_REST, np.zeros(3)))
        ekf.handle(Height(t_s + late_s, 50.0))
    assert abs(yaw_deg(ekf.estimate(t_s))) == pytest.approx(wrong_deg, abs=1.0)


def test_the_more_rotors_shake_the_imu_the_less_it_is_believed():
    history, rng = ImuHistory(level_attitudes(), 10.0), np.random.default_rng(0)
    for i in range(200):
        force, rates = AT_REST + rng.normal(0.0, 2.0, 3), rng.normal(0.0, 0.05, 3)
        history.add(ImuSample(STEP_S * i, force, rates))
    imu = preintegrated(history.until(2.0), history.until(3.0))
    assert imu.velocity_variance_m2_s2 == pytest.approx(2.0**2 * STEP_S, rel=0.3)
    assert imu.turn_variance_rad2 == pytest.approx(0.05**2 * STEP_S, rel=0.3)


def test_an_imu_that_is_shaken_hard_does_not_lead_the_filter_astray():
    world = FilterWorld(seconds=90.0, imu_hz=50.0, imu_noise_m_s2=5.0, gyro_noise_deg_s=5.0)
    rng = np.random.default_rng(4)
    rows = play(sense(world, fly(world, [rng])[0], rng)).rows
    settled = rows.t_s > 30.0
    assert np.mean(position_nees(rows)[settled]) < 5.0
    assert np.max(np.hypot(*rows.error_ne_m[settled].T)) < 3.0


def test_an_attitude_made_of_a_noisy_gyro_is_taken_to_wander_with_it():
    """As recorded of PX4's simulated IMU of the 1.16 era: 5 m off at 3.7 sigmas by it."""
    rng = np.random.default_rng(5)
    wanders, scatters = np.radians([0.6, 0.45]), (0.12, 0.057, 0.025)
    nees = []
    for _ in range(8):
        attitudes = AttitudeHistory(10.0)
        imu = ImuHistory(attitudes, 10.0)
        context = Context(EkfConfig(), attitudes, imu)
        x, P, off_rad = np.zeros(States.SIZE), 1e-8 * np.eye(States.SIZE), np.zeros(2)
        x[States.DRAG] = context.config.drag_per_s
        state = FilterState(0.0, x, P, True, True, 0.0, 0.0)
        for t_s in (STEP_S * np.arange(1, 76)).tolist():
            off_rad = off_rad + rng.normal(0.0, wanders) * math.sqrt(STEP_S)
            quat = quat_from_rotation(rotation_from_euler(*off_rad, 0.0))
            attitudes.add(Attitude(t_s, quat))
            imu.add(ImuSample(t_s, AT_REST, rng.normal(0.0, scatters)))
            state = predict(state, t_s, context)
        error = state.x[States.TILT] - off_rad
        nees.append(error @ np.linalg.solve(state.P[States.TILT, States.TILT], error))
    assert np.mean(nees) < 6.0  # 2 would be honest, 10 were seen


def test_a_true_turn_is_one():
    ekf = flying()
    turning = hover(ekf, 0.0, 4.0, lambda t: 0.0)
    t_s = hover(ekf, turning, 1.5, lambda t: t - turning, rates=(0.0, 0.0, 1.0))
    assert math.radians(yaw_deg(ekf.estimate(t_s))) == pytest.approx(1.5, abs=0.02)


def test_standing_on_the_ground_tells_the_gyros_bias():
    ekf = Ekf(EkfConfig())
    ekf.initialise(Start(t_s=0.0, position_ned_m=np.zeros(3)))
    bias = np.radians([0.2, -0.4, 0.5])
    hover(ekf, 0.0, 10.0, lambda t: 0.0, rates=bias, on_ground=True)
    assert ekf.state.x[States.GYRO_BIAS] == pytest.approx(bias, abs=math.radians(0.05))


def test_being_carried_to_the_start_is_not_a_bias():
    ekf = Ekf(EkfConfig())
    ekf.initialise(Start(t_s=0.0, position_ned_m=np.zeros(3)))
    hover(ekf, 0.0, 5.0, lambda t: 0.0, on_ground=True)
    hover(ekf, 5.0, 3.0, lambda t: 0.5 * (t - 5.0), rates=(0.0, 0.0, 0.5), on_ground=True)
    assert np.max(np.abs(ekf.state.x[States.GYRO_BIAS])) < math.radians(0.1)


ANY = st.floats(allow_nan=True, allow_infinity=True)


@given(t_s=ANY, values=st.lists(ANY, min_size=6, max_size=6), span_s=st.none() | ANY)
def test_no_sample_whatever_breaks_it(t_s, values, span_s):
    ekf = flying()
    now_s = hover(ekf, 0.0, 0.2, lambda t: 0.0)
    ekf.handle(ImuSample(t_s, np.array(values[:3]), np.array(values[3:]), span_s))
    hover(ekf, now_s, 0.2, lambda t: 0.0)
    found = ekf.estimate(now_s + 0.2)
    assert np.all(np.isfinite(found.position_ned_m))
    assert np.linalg.eigvalsh(ekf.state.P)[0] > -1e-9
    assert np.linalg.norm(found.quat_wxyz) == pytest.approx(1.0)


def recorded(path):
    """(received, name, fields) of what an autopilot said; NaN comes as None, as in flight."""
    decoder, data, at = mavlink.MAVLink(None), gzip.decompress(path.read_bytes()), 0
    while at + 8 < len(data):
        received_s = struct.unpack_from(">Q", data, at)[0] / 1e6
        packet = packet_at(data, at + 8)
        at += 8 + len(packet.data)
        if packet.component_id != 1 or packet.message_id not in mavlink.mavlink_map:
            continue
        message = decoder.decode(bytearray(packet.data))
        values = {name: getattr(message, name) for name in message.fieldnames}
        fields = {name: None if value != value else value for name, value in values.items()}
        yield received_s, message.get_type(), fields


def headings_deg(path):
    """(n, 3) at 50 Hz: time, heading of the autopilot, heading of the filter without any fix."""
    telemetry, ekf, rows, first_s = TelemetryState(), Ekf(EkfConfig()), [], None
    for received_s, name, fields in recorded(path):
        first_s = first_s or received_s
        t_s = received_s - first_s
        telemetry.handle(name, fields, t_s)
        attitude = telemetry.newest_attitude
        if attitude is None or (rows and t_s < rows[-1][0] + STEP_S):
            continue
        if ekf.state is None:
            ekf.initialise(Start(t_s=t_s, position_ned_m=np.zeros(3)))
        state = telemetry.state(t_s)
        ekf.handle(attitude)
        for measured in telemetry.take_measurements():
            if isinstance(measured, ImuSample):
                ekf.handle(measured)
        if state.height_m is not None:
            ekf.handle(Height(state.height_t_s, state.height_m))
        if not state.armed:
            ekf.handle(Stationary(t_s))
        measured = replace(ekf.estimate(t_s), quat_wxyz=attitude.quat_wxyz)
        rows.append((t_s, yaw_deg(measured), yaw_deg(ekf.estimate(t_s))))
    return np.array(rows)


def test_px4s_heading_resets_on_the_ground_leave_ours_alone(data_folder):
    """It stands; its filter moves its heading from -8 to -15 and then to -2 degrees."""
    rows = headings_deg(data_folder / "mavlink/px4-1.18_vpe_nogps_from_boot.tlog.gz")
    on_ground = rows[(rows[:, 0] > 3.0) & (rows[:, 0] < 20.0)]
    assert np.ptp(on_ground[:, 1]) > 12.0
    assert np.ptp(on_ground[:, 2]) < 2.0


def test_arducopters_realignment_leaves_ours_alone(data_folder):
    """In four seconds its heading slews by eight degrees, on the ground, step by small step."""
    rows = headings_deg(data_folder / "mavlink/arducopter-4.7dev_extnav_nogps.tlog.gz")
    slewing = rows[(rows[:, 0] > 14.0) & (rows[:, 0] < 24.0)]
    assert np.ptp(slewing[:, 1]) > 8.0
    assert np.ptp(slewing[:, 2]) < 2.5


def test_what_was_guessed_beyond_the_newest_sample_makes_no_negative_variance():
    """Telemetry 0.1 s late made the covariance none, and no estimate could be computed."""
    history, rng = ImuHistory(level_attitudes(), 10.0), np.random.default_rng(1)
    for i in range(50):
        shaken = AT_REST + rng.normal(0.0, 3.0, 3)
        history.add(ImuSample(STEP_S * i, shaken, np.zeros(3)))
    newest_s = STEP_S * 49
    guessed = history.until(newest_s + 0.09)
    for i in range(1, 10):
        history.add(ImuSample(newest_s + 0.0101 * i, AT_REST, np.zeros(3)))
    imu = preintegrated(guessed, history.until(newest_s + 0.0905))
    assert imu.velocity_variance_m2_s2 >= 0.0
    assert imu.turn_variance_rad2 >= 0.0


@given(
    st.lists(
        st.tuples(st.floats(0.001, 0.08), st.floats(0.002, 0.03), st.floats(0.0, 0.09)),
        min_size=5,
        max_size=30,
    )
)
@example([(0.02, 0.02, 0.0), (0.02, 0.02, 0.09), (0.09, 0.002, 0.0)] * 5)
def test_no_clock_of_an_imu_makes_a_covariance_that_is_none(steps):
    """What was guessed too far is taken back: noise was as well, and no height had a sigma."""
    attitudes = level_attitudes()
    imu = ImuHistory(attitudes, 10.0)
    context = Context(EkfConfig(), attitudes, imu)
    x, sure, t_s = np.zeros(States.SIZE), 1e-6 * np.eye(States.SIZE), 0.0
    x[States.VELOCITY], x[States.DRAG] = (20.0, 0.0, 0.0), context.config.drag_per_s
    state = FilterState(0.0, x, sure, True, True, 0.0, 0.0)
    for later_s, span_s, ahead_s in steps:
        t_s += later_s
        imu.add(ImuSample(t_s, AT_REST, np.zeros(3), span_s))
        if t_s + ahead_s <= state.t_s:
            continue
        state = predict(state._replace(P=sure), t_s + ahead_s, context)
        scale = np.sqrt(np.diag(state.P))
        assert np.linalg.eigvalsh(state.P / np.outer(scale, scale))[0] > -1e-9


def test_a_sample_that_is_refused_after_a_slip_counts_it_no_second_time():
    attitudes = level_attitudes()
    history = ImuHistory(attitudes, 10.0)
    gate = ImuGate(attitudes, history)
    slips_s = []
    for t_s, force in ((0.0, AT_REST), (0.02, AT_REST), (0.62, AT_REST), (0.64, 50.0 * AT_REST)):
        gate.take(ImuSample(t_s, force, np.zeros(3), 0.02))
        slips_s.append(history.slipped_s)
    assert slips_s == pytest.approx([0.0, 0.0, 0.58, 0.0])


@pytest.mark.parametrize("refused", [50.0 * AT_REST, np.full(3, math.nan)])
def test_where_samples_are_refused_the_dates_tell_how_long_it_flew(refused):
    """Else every one that is not a number would cost a fiftieth of a second of the way."""
    ekf = Ekf(EkfConfig())
    level = np.array([1.0, 0.0, 0.0, 0.0])
    ekf.handle(Attitude(0.0, level))
    place = np.array([0.0, 0.0, -50.0])
    ekf.initialise(
        Start(t_s=0.0, position_ned_m=place, agl_m=50.0, sigma_velocity_m_s=8.0),
    )
    for n in range(1, 301):
        t_s = round(0.02 * n, 6)
        ekf.handle(Attitude(t_s, level))
        force = refused if n % 3 == 0 and t_s > 2.0 else AT_REST
        ekf.handle(ImuSample(t_s, force, np.zeros(3), STEP_S))
        if t_s <= 2.0 and n % 5 == 0:
            way_m = np.array([0.8, 0.0, 0.0])
            ekf.handle(
                OdometryMotion(
                    round(t_s - 0.1, 6), t_s, way_m, 1e-4 * np.eye(3), 0.0, 0.003, 50.0, 99
                )
            )
        if n == 100:
            before = ekf.estimate(t_s)
    flown_m = (ekf.estimate(6.0).position_ned_m - before.position_ned_m)[0]
    assert before.velocity_ned_m_s[0] == pytest.approx(8.0, abs=0.1)
    assert flown_m == pytest.approx(32.0, abs=0.5)
