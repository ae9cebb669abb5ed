"""What the air does to the aircraft tells how fast it flies, where images do not."""

import gzip
import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink import mavutil

from tests.quick import first_quick
from vwnav.bench.estimator.flown import Run
from vwnav.bench.estimator.run import play
from vwnav.bench.estimator.streams import sense
from vwnav.bench.estimator.world import FilterWorld, fly
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.context import Context
from vwnav.estimation.events import NedFix
from vwnav.estimation.inertial.attitudes import GRAVITY_M_S2
from vwnav.estimation.inertial.preintegration import PreintegratedImu
from vwnav.estimation.process import TimeStep, imu_model
from vwnav.estimation.states import States
from vwnav.geometry.rotations import rotation_from_quat
from vwnav.types import OdometryMotion

SEEN_S, BLIND_S = 60.0, 40.0
RECORDINGS = Path(__file__).resolve().parents[3] / "shared" / "data" / "mavlink"


def goes_blind(seed: int, imu_hz: float = 100.0, **windy: float) -> tuple[FilterWorld, Run]:
    """A minute of flight with images, then without, in wind with gusts."""
    world = FilterWorld(seconds=SEEN_S + BLIND_S, imu_hz=imu_hz, hover_share=0.3, **windy)
    rng = np.random.default_rng(seed)
    stream = sense(world, fly(world, [rng])[0], rng)
    events = [
        event
        for event in stream.events
        if event.arrival_s < SEEN_S or not isinstance(event.seen, OdometryMotion | NedFix)
    ]
    return world, play(replace(stream, events=events))


@pytest.mark.parametrize("seed", first_quick([0, 1, 2]))
def test_without_images_the_velocity_stays_known_and_the_truth_within_5_sigma(seed):
    world, run = goes_blind(seed)
    assert run.last.x[States.DRAG] == pytest.approx(world.drag_per_s, abs=0.05)
    for t_s, error_m, P in zip(run.rows.t_s, run.rows.error_ne_m, run.rows.P, strict=True):
        sigmas = math.sqrt(error_m @ np.linalg.solve(P[:2, :2], error_m))
        assert sigmas < 5.0, f"{error_m} m at {t_s} s"
    sigma_m_s = math.sqrt(np.linalg.norm(run.estimates[-1].covariance[3:5, 3:5], 2))
    assert sigma_m_s < 2.0  # by counting accelerations alone it would be 4 and more
    assert np.hypot(*run.rows.error_ne_m[-1]) < 3.0 * 30.0


@pytest.mark.parametrize("seed", first_quick([0, 1, 2]))
def test_however_noisy_the_imu_is_no_reading_moves_the_place_so_far_that_it_is_another(seed):
    """35 resets in 40 s; the first of them ended the estimate, and a blind landing 306 m off."""
    _, run = goes_blind(seed, imu_noise_m_s2=3.0, gyro_noise_deg_s=3.0)
    blind = [each for each in run.estimates if each.t_s > SEEN_S]
    assert len({each.reset_counter for each in blind}) == 1
    for error_m, P in zip(run.rows.error_ne_m, run.rows.P, strict=True):
        assert math.sqrt(error_m @ np.linalg.solve(P[:2, :2], error_m)) < 5.0


@pytest.mark.parametrize(("seed", "drag_per_s"), first_quick([(1, 0.16), (2, 0.16), (1, 0.4)]))
def test_in_a_storm_it_does_not_take_a_gust_for_its_own_motion(seed, drag_per_s):
    """As long as wind was one slow state, 4.7, 6.1 and 7.2 sigmas."""
    _, run = goes_blind(seed, wind_m_s=12.0, gust_m_s=3.0, drag_per_s=drag_per_s)
    blind = run.rows.t_s > SEEN_S
    for error_m_s, P in zip(run.rows.error_v_m_s[blind, :2], run.rows.P[blind], strict=True):
        assert math.sqrt(error_m_s @ np.linalg.solve(P[3:5, 3:5], error_m_s)) < 4.5


@given(st.floats(2.0, 120.0), st.floats(2.0, 120.0), st.floats(0.5, 4.0))
def test_the_mean_wind_goes_by_height_as_the_logarithmic_profile_has_it(high_m, low_m, climb_m_s):
    """Felt with the wind of 50 m, the calm near the ground was a drift of 2 m/s."""
    config = EkfConfig()
    x, P = np.zeros(States.SIZE), np.zeros((States.SIZE, States.SIZE))
    x[States.DRAG], x[States.WIND_FORCE], x[States.DOWN] = 0.35, (0.5, 1.2), -high_m
    x[States.VELOCITY_DOWN] = math.copysign(climb_m_s, high_m - low_m)
    unturned = np.array([1.0, 0.0, 0.0, 0.0])
    hangs_m_s = np.array([0.0, 0.0, -GRAVITY_M_S2 * 0.05])
    imu = PreintegratedImu(0.05, hangs_m_s, hangs_m_s, 0.05 * np.eye(3), unturned, 1e-6, 1e-6)
    step = TimeStep(0.05, unturned, unturned, True, 0.0, imu)
    context = Context(config, None, None)
    for _ in range(round(abs(high_m - low_m) / climb_m_s / 0.05)):
        x, F, Q = imu_model(x, step, imu, context)
        P = F @ P @ F.T + Q
    z0 = config.roughness_m
    share = math.log1p(-x[States.DOWN] / z0) / math.log1p(high_m / z0)
    assert x[States.WIND_FORCE] == pytest.approx([0.5 * share, 1.2 * share], rel=0.02)
    sigma = math.sqrt(P[States.WIND_FORCE, States.WIND_FORCE][0, 0])
    assert sigma >= 0.3 * abs(1.0 - share) * 1.2  # the profile may be another's


def test_without_an_imu_nothing_is_known_of_the_air():
    _, run = goes_blind(0, imu_hz=0.0)
    assert math.sqrt(np.linalg.norm(run.estimates[-1].covariance[3:5, 3:5], 2)) > 4.0


@pytest.mark.parametrize(
    ("name", "drag_per_s"), [("px4-1.18_nominal", 1.0), ("arducopter-4.7dev_nominal", 0.384)]
)
def test_what_real_autopilots_feel_across_their_thrust_grows_with_the_speed(
    name, drag_per_s, tmp_path
):
    """Least squares over a recording: the law, its constant, and that little else is felt."""
    recording = RECORDINGS / f"{name}.tlog.gz"
    if not recording.exists():
        pytest.skip("needs the recordings of real autopilots")
    tlog = tmp_path / "flight.tlog"
    tlog.write_bytes(gzip.decompress(recording.read_bytes()))
    felt, speed = forward_force_and_speed(tlog)
    window = np.ones(20) / 20.0
    felt, speed = np.convolve(felt, window, "valid"), np.convolve(speed, window, "valid")
    slope, offset = np.polyfit(speed, felt, 1)
    assert -slope == pytest.approx(drag_per_s, rel=0.03)
    assert abs(offset) < 0.03
    assert np.std(felt - slope * speed - offset) < 0.05


def forward_force_and_speed(tlog: Path) -> tuple[np.ndarray, np.ndarray]:
    """Along the nose, m/s^2 and m/s, of all samples above 3 m."""
    os.environ["MAVLINK20"] = "1"
    link = mavutil.mavlink_connection(str(tlog), dialect="ardupilotmega")
    quat = velocity = None
    rows = []
    while (message := link.recv_match()) is not None:
        match message.get_type():
            case "ATTITUDE_QUATERNION":
                quat = np.array([message.q1, message.q2, message.q3, message.q4])
            case "LOCAL_POSITION_NED":
                high = message.z < -3.0
                velocity = np.array([message.vx, message.vy, message.vz]) if high else None
            case "HIGHRES_IMU" if quat is not None and velocity is not None:
                forward = rotation_from_quat(quat)[:, 0]
                rows.append((message.xacc, forward @ velocity))
    return np.array(rows).T
