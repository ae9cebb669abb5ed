"""A camera that hangs otherwise than was told is no attitude error: an IMU tells them apart."""

import math
from dataclasses import replace

import numpy as np
import pytest
from honesty import worst_sigmas

from tests.quick import first_quick
from vwnav.bench.estimator.flown import Run
from vwnav.bench.estimator.run import play
from vwnav.bench.estimator.streams import MeasurementEvent, sense
from vwnav.bench.estimator.world import FilterWorld, fly
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.events import NedFix
from vwnav.estimation.states import States

OFF_DEG = (-2.0, 5.0)
BY_HAND_DEG = 1.5
TURN_SIGMA_DEG = math.degrees(EkfConfig().mount_turn_sigma_rad)


def flown(
    seed: int,
    sigma_deg: float,
    off_deg: tuple[float, float] = OFF_DEG,
    ahead_m: float = 0.0,
    turn_deg: float = 0.0,
    sigma_turn_deg: float = TURN_SIGMA_DEG,
) -> Run:
    """Two minutes in wind, with turns, an IMU and fixes that all lie so far ahead of the nose."""
    world = FilterWorld(seconds=120.0, imu_hz=50.0, mount_off_deg=off_deg, mount_turn_deg=turn_deg)
    rng = np.random.default_rng(seed)
    config = EkfConfig(
        mount_sigma_rad=math.radians(sigma_deg), mount_turn_sigma_rad=math.radians(sigma_turn_deg)
    )
    stream = sense(world, fly(world, [rng])[0], rng)
    return play(replace(stream, events=[ahead(each, ahead_m) for each in stream.events]), config)


def ahead(event: MeasurementEvent, ahead_m: float) -> MeasurementEvent:
    fix = event.seen
    if not isinstance(fix, NedFix) or fix.yaw_rad is None:
        return event
    nose = np.array([math.cos(fix.yaw_rad), math.sin(fix.yaw_rad)])
    return replace(event, seen=replace(fix, position_ne_m=fix.position_ne_m + ahead_m * nose))


@pytest.mark.parametrize("seed", first_quick([1, 2, 3]))
def test_a_mount_that_nobody_measured_is_learned_and_the_place_stays_within_its_sigmas(seed):
    run = flown(seed, BY_HAND_DEG)
    assert worst_sigmas(run) < 4.5
    off_rad = run.last.x[States.CAMERA_TILT] - np.radians(OFF_DEG)
    sigmas = np.sqrt(np.diag(run.last.P)[States.CAMERA_TILT])
    assert np.all(np.abs(off_rad) < 4.0 * sigmas)
    assert np.all(np.degrees(sigmas) < 0.5 * BY_HAND_DEG)


@pytest.mark.parametrize("seed", first_quick([1, 2, 3]))
@pytest.mark.parametrize("turn_deg", first_quick([-8.0, 5.0]))
def test_one_that_is_turned_is_told_from_a_compass_that_errs(seed, turn_deg):
    """By how the aircraft gains speed, and by where fixes lie while it leans."""
    run = flown(seed, 0.2, (0.0, 0.0), turn_deg=turn_deg)
    assert worst_sigmas(run) < 4.5
    off_deg = math.degrees(run.last.x[States.CAMERA_TURN]) + turn_deg
    sigma_deg = math.degrees(math.sqrt(run.last.P[States.CAMERA_TURN, States.CAMERA_TURN]))
    assert abs(off_deg) < 4.0 * sigma_deg < 8.0


@pytest.mark.long
def test_a_turn_that_a_filter_knows_nothing_of_is_taken_for_the_compass_error():
    """What a filter without that state did: and an estimate that is wrong by more than it says."""
    knows, does_not = (
        flown(1, 0.2, (0.0, 0.0), turn_deg=10.0, sigma_turn_deg=sigma_deg)
        for sigma_deg in (TURN_SIGMA_DEG, 0.01)
    )
    assert worst_sigmas(knows) < worst_sigmas(does_not) - 1.0


@pytest.mark.long
def test_one_that_is_said_to_be_measured_is_believed_and_then_it_is_wrong():
    """What a filter without these states did with every mount."""
    assert worst_sigmas(flown(1, 0.01)) > 5.0


@pytest.mark.long
def test_one_that_hangs_as_told_costs_little():
    exact, by_hand = (flown(1, sigma, (0.0, 0.0)) for sigma in (0.2, BY_HAND_DEG))
    late = exact.rows.t_s > 60.0
    mean_m = [float(np.hypot(*run.rows.error_ne_m[late].T).mean()) for run in (exact, by_hand)]
    assert mean_m[1] < mean_m[0] + 0.2


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_what_fixes_have_alike_in_every_turn_is_no_climb(seed):
    """It is their own error as well as a tilt, and a tilt leads a level way up or down.

    By 0.3 m ahead of the nose, for two minutes: 1.3 m of height as long as it was a tilt alone.
    """
    ahead_m, none_m = (
        flown(seed, 0.2, (0.0, 0.0), each).last.x[States.DOWN] for each in (0.3, 0.0)
    )
    assert abs(ahead_m - none_m) < 0.6
