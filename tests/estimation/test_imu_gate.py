"""An IMU that does not feel gravity where the attitude has it, and what it had told before."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from tests.quick import first_quick
from vwnav.bench.estimator.run import Run, play
from vwnav.bench.estimator.streams import MeasurementStream, sense
from vwnav.bench.estimator.world import FilterWorld, fly
from vwnav.estimation.beginning.starts import Start
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.ekf import Ekf
from vwnav.estimation.states import Verdict
from vwnav.geometry.rotations import quat_from_rotation, rotation_from_euler
from vwnav.types import Attitude, ImuSample

PERIOD_S = 0.02
GRAVITY = np.array([0.0, 0.0, -9.8])
QUARTER_ABOUT_FORWARD = rotation_from_euler(math.pi / 2, 0.0, 0.0)


def listening() -> tuple[Ekf, list[str]]:
    said: list[str] = []
    ekf = Ekf(EkfConfig())
    ekf.initialise(Start(t_s=0.0, position_ned_m=np.zeros(3), sigma_m=2.0, agl_m=0.15))
    ekf.on_event(said.append)
    return ekf, said


def verdicts(ekf: Ekf, count: int, force, start: int = 0, roll_rad: float = 0.0) -> list[Verdict]:
    """Of samples that feel `force`, each after the attitude of its moment."""
    quat = quat_from_rotation(rotation_from_euler(roll_rad, 0.0, 0.0))
    found = []
    for i in range(start, start + count):
        ekf.handle(Attitude(PERIOD_S * i, quat))
        sample = ImuSample(PERIOD_S * i, np.asarray(force, dtype=float), np.zeros(3), PERIOD_S)
        found.append(ekf.handle(sample).verdict)
    return found


@pytest.mark.parametrize("force", [(0.0, 0.0, 9.8), (9.8, 0.0, 0.0), (0.0, 0.0, -30.0)])
def test_an_imu_that_feels_gravity_elsewhere_is_not_used_and_it_is_said(force):
    ekf, said = listening()
    verdicts(ekf, 500, force)
    assert set(verdicts(ekf, 50, force, start=500)) == {Verdict.DISTRUSTED}
    assert len(said) == 1
    assert "IMU is not used" in said[0]
    assert np.hypot(*ekf.estimate(11.0).velocity_ned_m_s[:2]) < 1.0


def test_leaning_and_braking_are_no_reason_to_refuse_it():
    ekf, _ = listening()
    leaning = rotation_from_euler(0.3, 0.0, 0.0).T @ [0.0, 0.0, -9.8]
    assert set(verdicts(ekf, 500, leaning, roll_rad=0.3)) == {Verdict.FUSED}
    ekf, _ = listening()
    verdicts(ekf, 500, (0.0, 0.0, -9.8))
    assert set(verdicts(ekf, 100, (6.0, 0.0, -9.8), start=500)) == {Verdict.FUSED}


def test_an_imu_that_comes_right_is_used_again():
    ekf, said = listening()
    verdicts(ekf, 500, (0.0, 0.0, 9.8))
    assert verdicts(ekf, 2000, (0.0, 0.0, -9.8), start=500)[-1] is Verdict.FUSED
    assert "again: it is used" in said[-1]
    assert len(said) == 2


def test_at_the_bound_it_is_not_said_again_and_again():
    ekf, said = listening()
    for i in range(0, 3000, 30):  # 2.9 and 3.2 m/s^2 too little, in turns
        verdicts(ekf, 30, (0.0, 0.0, -6.9 if i % 60 else -6.6), start=i)
    assert sum("IMU" in each for each in said) == 1


@pytest.mark.parametrize("sigma_m_s2", [2.0, 6.0])
def test_one_that_is_shaken_feels_gravity_where_it_is(sigma_m_s2):
    """By a propeller out of balance: chance is no other gravity."""
    ekf, said = listening()
    for i, shaken in enumerate(np.random.default_rng(1).normal(0.0, sigma_m_s2, (3000, 3))):
        verdicts(ekf, 1, shaken + GRAVITY, start=i)
    assert said == []


@pytest.mark.parametrize("sigma_m_s2", [12.0, 20.0])
def test_one_that_is_shaken_too_much_is_given_up_once_and_taken_again_once(sigma_m_s2):
    """At 15 m/s^2 it had been given up and taken again 40 times in 45 s, its gravity to blame."""
    ekf, said = listening()
    for i, shaken in enumerate(np.random.default_rng(1).normal(0.0, sigma_m_s2, (3000, 3))):
        verdicts(ekf, 1, shaken + GRAVITY, start=i)
    assert ["shaken too much" in each for each in said] == [True]
    assert verdicts(ekf, 2000, (0.0, 0.0, -9.8), start=3000)[-1] is Verdict.FUSED
    assert ["again: it is used" in each for each in said] == [False, True]


def test_one_that_is_shaken_and_feels_gravity_elsewhere_is_found_out():
    ekf, said = listening()
    for i, shaken in enumerate(np.random.default_rng(1).normal(0.0, 6.0, (500, 3))):
        verdicts(ekf, 1, shaken - GRAVITY, start=i)
    assert "gravity" in said[0]


def stream_of(seed: int) -> MeasurementStream:
    world = FilterWorld(seconds=30.0, imu_hz=50.0, leg_s=6.0)
    rng = np.random.default_rng(seed)
    return sense(world, fly(world, [rng])[0], rng)


def altered(
    stream: MeasurementStream, change: Callable[[ImuSample], ImuSample], from_s: float, to_s: float
) -> MeasurementStream:
    """The IMU tells something else between those times."""

    def other(seen):
        broken = isinstance(seen, ImuSample) and from_s <= seen.t_s < to_s
        return change(seen) if broken else seen

    events = [replace(event, seen=other(event.seen)) for event in stream.events]
    return replace(stream, events=events)


def turned(sample: ImuSample) -> ImuSample:
    """By an IMU that is a quarter turn about forward off."""
    R = QUARTER_ABOUT_FORWARD.T
    force, rates = R @ sample.specific_force_m_s2, R @ sample.rates_rad_s
    return replace(sample, specific_force_m_s2=force, rates_rad_s=rates)


def off_by(off_m_s2: Sequence[float]) -> Callable[[ImuSample], ImuSample]:
    """By an accelerometer that tells so much more, in the body's axes."""
    return lambda sample: replace(
        sample, specific_force_m_s2=sample.specific_force_m_s2 + np.array(off_m_s2)
    )


def worst_sigmas(run: Run, from_s: float, to_s: float = math.inf) -> float:
    """Of the horizontal place."""
    rows = run.rows
    return max(
        math.sqrt(error_m @ np.linalg.solve(P[:2, :2], error_m))
        for t_s, error_m, P in zip(rows.t_s, rows.error_ne_m, rows.P, strict=True)
        if from_s <= t_s < to_s
    )


@pytest.mark.parametrize("seed", first_quick(range(4), 2))
def test_what_it_told_before_it_was_found_out_is_taken_back(seed):
    """Believed for half a second it left tilt and velocity wrong at small sigmas: 6.5 sigmas."""
    run = play(altered(stream_of(seed), turned, 15.0, math.inf))
    assert worst_sigmas(run, 0.0, 16.5) < 5.0
    assert worst_sigmas(run, 16.5) < 3.5


@pytest.mark.parametrize("seed", first_quick(range(3)))
@pytest.mark.parametrize("off_m_s2", [(4, 0, 0), (0, -3, 0), (0, 0, 4), (-3, 2, -2), (6, 6, 0)])
def test_an_accelerometer_that_is_off_is_told_from_images_that_are(off_m_s2, seed):
    """The images were blamed for it: without them it flew on by it, 1 km away at 69 m/s."""
    said: list[str] = []
    run = play(altered(stream_of(seed), off_by(off_m_s2), 15.0, math.inf), say=said.append)
    assert [each for each in said if "accelerometer is off" in each]
    assert not [each for each in said if "pictures show contradicts" in each]
    assert worst_sigmas(run, 0.0) < 5.0


def test_it_is_believed_again_once_it_feels_what_the_air_does():
    said: list[str] = []
    play(altered(stream_of(1), off_by((0, 4, 0)), 8.0, 12.0), say=said.append)
    found, again = said
    assert "accelerometer is off" in found
    assert "it is used" in again
