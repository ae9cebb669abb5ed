"""Ways that contradict the IMU are not believed, until they and a fix agree again."""

import math
from dataclasses import replace

import numpy as np
import pytest

from vwnav.bench.estimator.run import play
from vwnav.bench.estimator.streams import MeasurementEvent, sense
from vwnav.bench.estimator.world import FilterWorld, fly
from vwnav.estimation.beginning.misled import apply_misled
from vwnav.estimation.beginning.starts import Start, first_variance
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.ekf import Ekf
from vwnav.estimation.events import Misled, NedFix
from vwnav.estimation.inertial.attitudes import AttitudeHistory
from vwnav.estimation.inertial.imu import ImuHistory
from vwnav.estimation.odometry_gate import OdometryGate
from vwnav.estimation.states import FilterState, Innovation, States, Verdict
from vwnav.types import Attitude, Height, ImuSample, OdometryMotion, Range

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
WAY = OdometryMotion(-1.0, 0.0, np.zeros(3), 0.05**2 * np.eye(3), 0.0, 0.003, 50.0, 99)


def gate_without_imu() -> OdometryGate:
    attitudes = AttitudeHistory(1.0)
    return OdometryGate(attitudes, ImuHistory(attitudes, 1.0), EkfConfig())


def tell(
    gate: OdometryGate,
    begin_s: float,
    seconds: float,
    agrees: bool,
    brakes_m_s2: float = 3.0,
    nis: float = 3.0,
) -> float:
    """Ten ways a second; returns when the next one is due."""
    P = 0.3**2 * np.eye(States.SIZE)
    told = Innovation(Verdict.FUSED, nis) if agrees else Innovation(Verdict.GATED, 30.0)
    for i in range(round(10 * seconds)):
        x = np.zeros(States.SIZE)
        x[States.VELOCITY.start] = 8.0 - 0.1 * i * brakes_m_s2
        t_s = begin_s + 0.1 * i
        state = FilterState(t_s, x, P, True, True, tracked_s=t_s, exposed_s=t_s)
        gate.learn(told, replace(WAY, t1_s=t_s), state)
    return begin_s + seconds


def test_ways_that_are_refused_are_lost_and_come_back_with_a_fix_only():
    gate = gate_without_imu()
    t_s = tell(gate, 0.0, 5.0, True)
    t_s = tell(gate, t_s, 1.3, False)
    assert gate.lost
    t_s = tell(gate, t_s, 6.0, True)
    assert gate.lost
    gate.fixes += 1
    t_s = tell(gate, t_s, 0.1, True)
    assert not gate.lost


@pytest.mark.parametrize(
    ("nis", "every", "lost"), [(15.0, 3, True), (10.0, 3, False), (15.0, 12, False)]
)
def test_so_are_ways_that_all_are_at_the_edge_of_the_gate_or_beyond(nis, every, lost):
    """Of a patch laid side by side, which stands still by half, a third was refused: 2.8 sigmas.

    One of twelve was in a climb with a camera turned by 10 degrees: lost, they told that no more.
    """
    gate = gate_without_imu()
    t_s = tell(gate, 0.0, 5.0, True)
    for n in range(24):
        t_s = tell(gate, t_s, 0.1, n % every > 0, nis=nis)
    assert gate.lost is lost


def test_lost_again_they_have_to_agree_for_longer():
    gate = gate_without_imu()
    t_s = tell(gate, 0.0, 1.5, False)
    gate.fixes += 1
    t_s = tell(gate, t_s, 3.0, True)
    assert not gate.lost
    t_s = tell(gate, t_s, 1.5, False)
    gate.fixes += 1
    t_s = tell(gate, t_s, 10.0, True)
    assert gate.lost
    tell(gate, t_s, 12.0, True)
    assert not gate.lost


def test_in_steady_flight_ways_of_another_moment_agree_and_that_proves_nothing():
    gate = gate_without_imu()
    t_s = tell(gate, 0.0, 1.5, False, brakes_m_s2=0.0)
    gate.fixes += 1
    t_s = tell(gate, t_s, 30.0, True, brakes_m_s2=0.0)
    assert gate.lost
    tell(gate, t_s, 4.0, True)
    assert not gate.lost


def test_after_a_gap_of_images_it_may_be_the_filter_that_is_wrong():
    gate = gate_without_imu()
    tell(gate, tell(gate, 0.0, 0.8, False) + 1.0, 1.0, False)
    assert not gate.lost


def upside_down(event: MeasurementEvent) -> MeasurementEvent:
    """What a camera the other way round tells: it went back, and tilted back as well.

    Of -w where w is told the likelihood ratio is -3 times that of w.
    """
    seen = event.seen
    if not isinstance(seen, OdometryMotion):
        return event
    way_m = seen.displacement_ned_m * [-1.0, -1.0, 1.0]
    turned = replace(seen, displacement_ned_m=way_m, tilts_along=-3.0 * seen.tilts_along)
    return replace(event, seen=turned)


@pytest.mark.parametrize("seed", range(1, 7))
def test_a_camera_upside_down_is_found_out_before_its_ways_have_led_anywhere(seed):
    """By the ways alone, found out after up to 30 s and wrong by 37 sigmas."""
    world = FilterWorld(seconds=30.0, imu_hz=50.0, leg_s=6.0)
    rng = np.random.default_rng(seed)
    stream = sense(world, fly(world, [rng])[0], rng)
    events = [upside_down(each) for each in stream.events if not isinstance(each.seen, NedFix)]
    said: list[str] = []
    rows = play(replace(stream, events=events), say=said.append).rows
    worst = max(
        math.sqrt(error_m @ np.linalg.solve(P[:2, :2], error_m))
        for error_m, P in zip(rows.error_ne_m, rows.P, strict=True)
    )
    assert [each for each in said if "pictures show contradicts" in each]
    assert worst < 5.0


@pytest.mark.parametrize(("agl_m", "lost"), [(1.5, False), (20.0, True)])
def test_what_blades_and_blur_show_before_any_fix_is_not_heard_and_proves_nothing(agl_m, lost):
    """A take-off over hills was broken off at 1.7 m, as if the camera were mounted wrongly."""
    ekf, said = Ekf(EkfConfig()), []
    ekf.on_event(said.append)
    ekf.handle(Attitude(0.0, LEVEL))
    place = np.array([0.0, 0.0, -agl_m])
    ekf.initialise(Start(t_s=0.0, position_ned_m=place, sigma_m=1.0, agl_m=agl_m))
    for n in range(1, 301):
        t_s = round(0.02 * n, 6)
        ekf.handle(Attitude(t_s, LEVEL))
        ekf.handle(ImuSample(t_s, np.array([0.0, 0.0, -9.80665]), np.zeros(3)))
        if n % 5 == 0:
            ekf.handle(Height(t_s, agl_m))
            wrong_m = np.array([0.3 * (-1.0) ** n, 0.0, 0.0]) if t_s > 2.0 else np.zeros(3)
            sigmas_m2 = 0.02**2 * np.eye(3)
            since_s = round(t_s - 0.1, 6)
            ekf.handle(OdometryMotion(since_s, t_s, wrong_m, sigmas_m2, 0.0, 0.003, agl_m, 99))
        ekf.estimate(t_s)
    assert any("pictures show contradicts" in line for line in said) is lost
    assert np.all(np.abs(ekf.state.x[States.VELOCITY_NE]) < 1.0)


def test_what_wrong_ways_have_taught_is_as_at_first_and_the_velocity_as_wrong_as_they_were():
    config, rng = EkfConfig(), np.random.default_rng(1)
    root = rng.normal(size=(States.SIZE, States.SIZE))
    before = FilterState(8.0, rng.normal(size=States.SIZE), root @ root.T, True, True, 8.0, 8.0)
    after = apply_misled(before, Misled(8.0, 2.0), config)
    for taught in (
        States.TILT,
        States.WIND_FORCE,
        States.GUST_FORCE,
        States.ACCELEROMETER_BIAS_LEVEL,
    ):
        assert np.all(after.x[taught] == 0.0)
        known = np.diag(after.P)[taught]
        assert known == pytest.approx(first_variance(config)[taught])
    added = np.diag(after.P - before.P)
    assert added[States.VELOCITY_NE] == pytest.approx([4.0, 4.0])
    assert added[States.POSITION_NE] == pytest.approx([36.0, 36.0])  # half of 2 m/s for 6 s
    assert np.linalg.eigvalsh(after.P).min() > -1e-9


def hovering_with_imu(
    wrong_way_m, seconds: float, fixes_s=(1.1, 1.3, 1.5)
) -> tuple[Ekf, list[str], float]:
    """Level at 20 m; from 2 s on an image tells `wrong_way_m(n)` (3,) since the one before.

    Also the widest sigma of the level velocity since then.
    """
    ekf, said, widest = Ekf(EkfConfig()), [], 0.0
    ekf.on_event(said.append)
    ekf.handle(Attitude(0.0, LEVEL))
    ekf.initialise(
        Start(t_s=0.0, position_ned_m=np.array([0.0, 0.0, -20.0]), sigma_m=1.0, agl_m=20.0)
    )
    place = {"position_ne_m": np.zeros(2), "covariance_ne_m2": 0.25 * np.eye(2)}
    for n in range(1, round(50.0 * seconds) + 1):
        t_s = round(0.02 * n, 6)
        ekf.handle(Attitude(t_s, LEVEL))
        ekf.handle(ImuSample(t_s, np.array([0.0, 0.0, -9.80665]), np.zeros(3)))
        if n % 5 == 0:
            ekf.handle(NedFix(t_s=t_s, **place) if t_s in fixes_s else Height(t_s, 20.0))
            way_m = wrong_way_m(n) if t_s > 2.0 else np.zeros(3)
            since_s = round(t_s - 0.1, 6)
            told = OdometryMotion(since_s, t_s, way_m, 0.02**2 * np.eye(3), 0.0, 0.003, 20.0, 99)
            ekf.handle(told)
        if t_s > 2.0:
            widest = max(widest, float(np.diag(ekf.estimate(t_s).covariance)[3:5].max()) ** 0.5)
    return ekf, said, widest


def test_ways_that_no_aircraft_flies_move_nothing_and_are_told_as_such_also_when_none_is_believed():
    """So that odometry looks afresh: it had locked on to its own guess, at 36, 72, 100 m/s."""
    racing = OdometryMotion(3.9, 4.0, np.array([7.0, 0.0, 0.0]), np.eye(3), 0.0, 0.003, 20.0, 99)
    for way_m, lost in ((np.array([7.0, 0.0, 0.0]), False), (np.array([1.0, 0.0, 0.0]), True)):
        ekf, said, _ = hovering_with_imu(lambda n, way_m=way_m: way_m, 4.0)
        assert bool([each for each in said if "pictures show contradicts" in each]) is lost
        assert ekf.handle(racing).verdict is Verdict.IMPOSSIBLE
        assert np.all(np.abs(ekf.state.x[States.VELOCITY_NE]) < 0.2)


def test_what_a_blurred_image_near_the_ground_shows_of_a_climb_does_not_hold_a_descent():
    """It grew by half of what it should, and was surer than barometer and rangefinder together."""
    ekf, said, height_m, sinks_m_s = Ekf(EkfConfig()), [], 2.5, 0.0
    ekf.on_event(said.append)
    ekf.handle(Attitude(0.0, LEVEL))
    place = np.array([0.0, 0.0, -height_m])
    ekf.initialise(Start(t_s=0.0, position_ned_m=place, sigma_m=1.0, agl_m=height_m))
    seen = {"position_ne_m": np.zeros(2), "covariance_ne_m2": 0.25 * np.eye(2)}
    ekf.handle(NedFix(t_s=0.0, **seen))
    for n in range(1, 226):
        t_s = round(0.02 * n, 6)
        falls_m_s2 = 1.0 if 25 < n <= 50 else 0.0
        height_m, sinks_m_s = height_m - 0.02 * sinks_m_s, sinks_m_s + 0.02 * falls_m_s2
        ekf.handle(Attitude(t_s, LEVEL))
        ekf.handle(ImuSample(t_s, np.array([0.0, 0.0, falls_m_s2 - 9.80665]), np.zeros(3)))
        if n % 5 == 0:
            ekf.handle(Height(t_s, height_m))
            ekf.handle(Range(t_s, height_m))
            way_m = np.array([0.0, 0.0, (0.1 if n < 100 else 0.04) * sinks_m_s])
            since_s, noise_m2 = round(t_s - 0.1, 6), 0.003**2 * np.eye(3)
            ekf.handle(OdometryMotion(since_s, t_s, way_m, noise_m2, 0.0, 0.003, height_m, 99))
    assert not said
    assert ekf.estimate(t_s).agl_m == pytest.approx(height_m, abs=0.05)
    assert ekf.estimate(t_s).velocity_ned_m_s[2] == pytest.approx(sinks_m_s, abs=0.05)


def test_however_long_images_contradict_an_imu_it_is_not_thought_to_be_off_by_more_than_it_can_be():
    """Six refused in a row freed the velocity by all they said, and the seventh was believed."""
    ekf, _, widest = hovering_with_imu(lambda n: np.array([0.3 + 0.01 * n, 0.0, 0.0]), 3.0)
    assert widest < 1.0
    assert np.all(np.abs(ekf.state.x[States.VELOCITY_NE]) < 0.3)


@pytest.mark.parametrize("fixes_s", [(), (1.5,), (1.3, 1.5)])
def test_one_fix_or_two_do_not_prove_the_ways_before_they_were_lost(fixes_s):
    """A lens a fifth too narrow told ways for 20 s, one fix agreed: 12 m off at 3.4 sigmas."""
    _, _, widest = hovering_with_imu(lambda n: np.array([0.3 + 0.01 * n, 0.0, 0.0]), 4.0, fixes_s)
    assert widest > 1.9


def test_ways_of_which_half_are_refused_are_lost():
    """Over ground that repeats every second one passed by chance, and turned the velocity."""
    gate = gate_without_imu()
    t_s = tell(gate, 0.0, 5.0, True)
    for n in range(14):
        t_s = tell(gate, t_s, 0.1, n % 2 == 0)
    assert gate.lost


def test_so_are_not_those_of_which_a_third_is():
    gate = gate_without_imu()
    t_s = tell(gate, 0.0, 5.0, True)
    for n in range(60):
        t_s = tell(gate, t_s, 0.1, n % 3 != 0)
    assert not gate.lost


def hovering_on(keyframes: list[tuple[float, float]]) -> bool:
    """Whether ways are lost where every image of a keyframe, (seconds, tilts_along), says that."""
    ekf, said, t0_s = Ekf(EkfConfig()), [], 0.1
    ekf.on_event(said.append)
    ekf.handle(Attitude(0.0, LEVEL))
    ekf.initialise(Start(t_s=0.0, position_ned_m=np.array([0.0, 0.0, -20.0]), agl_m=20.0))
    starts_s = [t0_s + sum(seconds for seconds, _ in keyframes[:k]) for k in range(len(keyframes))]
    for n in range(1, round(50.0 * (starts_s[-1] + keyframes[-1][0]))):
        t_s = round(0.02 * n, 6)
        ekf.handle(Attitude(t_s, LEVEL))
        ekf.handle(ImuSample(t_s, np.array([0.0, 0.0, -9.80665]), np.zeros(3)))
        if n % 5 == 0 and t_s > t0_s:
            ekf.handle(Height(t_s, 20.0))
            k = max(k for k, start_s in enumerate(starts_s) if start_s < t_s - 0.01)
            way = OdometryMotion(
                round(starts_s[k], 6), t_s, np.zeros(3), 1e-4 * np.eye(3), 0.0, 0.003, 20.0, 99,
                tilts_along=keyframes[k][1],
            )  # fmt: skip
            ekf.handle(way)
        ekf.estimate(t_s)
    return any("pictures show contradicts" in line for line in said)


@pytest.mark.parametrize(("keyframes", "lost"), [(1, False), (6, True)])
def test_one_keyframe_that_was_dated_wrongly_makes_no_camera_upside_down(keyframes, lost):
    """Every image that hovers on it shows another tilt than the attitudes tell: that of one."""
    assert hovering_on(keyframes * [(6.0 / keyframes, -5.0)]) is lost


@pytest.mark.parametrize(("against", "lost"), [(3, False), (6, True)])
def test_a_camera_that_has_long_hung_as_told_is_not_turned_by_some_keyframes(against, lost):
    """Those of a hard turn, whose attitudes erred by degrees: 160 m off without its ways."""
    assert hovering_on(4 * [(1.0, 5.0)] + against * [(1.0, -5.0)]) is lost
