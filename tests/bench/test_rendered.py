"""Rendered flights: over their sites, the same every time, and blind to their truth."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from typer.testing import CliRunner

from vwnav.__main__ import app
from vwnav.bench.estimator.benchmark import as_json
from vwnav.bench.estimator.flown import NavigatedFlight, Run
from vwnav.bench.estimator.rendered_errors import fix_errors, odometry_errors, parts, way_errors
from vwnav.bench.estimator.rendered_flight import RENDERED_S, images, plan_flight
from vwnav.bench.estimator.rendered_run import fly_rendered
from vwnav.bench.estimator.rendered_scenarios import judge_odometry, judge_rendered
from vwnav.bench.estimator.run import play
from vwnav.bench.estimator.streams import sense
from vwnav.bench.estimator.world import FilterWorld, fly
from vwnav.estimation.events import NedFix
from vwnav.sim.named_sites import MAP_EAST_M, MAP_NORTH_M
from vwnav.sim.renderer import default_camera
from vwnav.types import Frame, MapFix

SECONDS = 11.0


@pytest.fixture(scope="module")
def short_flight():
    """A climb with the first fixes, flown once, and its images."""
    flight = plan_flight(0, 0, SECONDS)
    frames = list(images(flight, default_camera()))
    return frames, navigated(frames)


def navigated(frames, flight=None, most_fixes=0) -> NavigatedFlight:
    flight = flight or plan_flight(0, 0, SECONDS)
    return fly_rendered(flight, frames, most_fixes, "sift", lambda _: None)


def places(flown) -> np.ndarray:
    return np.array([e.position_ned_m for e in flown.run.estimates])


def test_flights_stay_where_the_map_shows_what_the_camera_sees():
    for number in range(3):
        truth = plan_flight(number, 0, RENDERED_S).truth
        seen_m = 1.3 * np.max(truth.agl_m)  # 52 degrees off the vertical
        reach_m = np.max(np.abs(truth.position_ned_m[:, :2]), axis=0) + seen_m
        assert np.all(reach_m < (MAP_NORTH_M / 2.0, MAP_EAST_M / 2.0))


def test_the_height_above_ground_is_that_of_the_level_ground_that_is_drawn():
    truth = plan_flight(1, 0, SECONDS).truth
    assert np.array_equal(truth.agl_m, -truth.position_ned_m[:, 2])


def test_fixes_come_and_the_estimate_is_near_the_truth(short_flight):
    flown = short_flight[1]
    assert flown.fixes >= 5
    assert np.max(np.hypot(*flown.run.rows.error_ne_m.T)) < 6.0


def test_the_same_flight_gives_the_same_estimates(short_flight):
    frames, flown = short_flight
    drawn_again = islice(images(plan_flight(0, 0, SECONDS), default_camera()), 40)
    for before, again in zip(frames[:40], drawn_again, strict=True):
        assert np.array_equal(before.image, again.image)
    assert np.array_equal(places(navigated(frames)), places(flown))


@pytest.mark.long
def test_the_truth_is_not_navigated_by(short_flight):
    """Another truth, the same images and telemetry: the same estimates, other errors."""
    frames, flown = short_flight
    flight = plan_flight(0, 0, SECONDS)
    moved = replace(flight.truth, position_ned_m=flight.truth.position_ned_m + 50.0)
    elsewhere = navigated(frames, replace(flight, truth=moved))
    assert np.array_equal(places(elsewhere), places(flown))
    assert np.min(np.hypot(*elsewhere.run.rows.error_ne_m.T)) > 50.0


def test_black_images_give_no_fix(short_flight):
    black = [Frame(f.t_s, np.zeros_like(f.image), f.index) for f in short_flight[0]]
    flown = navigated(black)
    assert flown.fixes == 0
    assert flown.run.estimates[-1].t_last_fix_s is None
    assert judge_odometry([flown])[0].good is False


@pytest.mark.long
def test_fixes_are_late_and_end_when_there_were_enough(short_flight):
    frames, flown = short_flight
    late_s = [e.arrival_s - e.seen.t_s for e, _ in flown.run.answers if isinstance(e.seen, NedFix)]
    assert 0.1 < np.mean(late_s) < 0.4
    assert max(late_s) < 0.5
    few = navigated(frames, most_fixes=2)
    assert sum(isinstance(o, MapFix) for o in few.outcomes) == 2


def played(world: FilterWorld) -> list[Run]:
    """Two flights of the fast benchmark, whole."""
    rngs = [np.random.default_rng(seed) for seed in range(2)]
    return [play(sense(world, t, rng)) for t, rng in zip(fly(world, rngs), rngs, strict=True)]


@pytest.mark.long
def test_the_errors_measured_in_a_flight_are_those_that_were_put_in():
    world = FilterWorld(seconds=130.0, odometry_sigma=0.0015, fix_sigma_m=0.4, tilt_in_odometry=0.3)
    runs = played(world)
    found = odometry_errors([way_errors(run) for run in runs])
    fixes = [fix_errors(run) for run in runs]
    assert found.image == pytest.approx(0.0015, rel=0.1)
    assert found.kept == pytest.approx(0.0015, rel=0.2)
    assert found.yaw_image_rad == pytest.approx(world.odometry_yaw_rad, rel=0.1)
    assert found.tilt == pytest.approx(0.3, abs=0.06)
    assert parts([f.ne_m for f in fixes]).white == pytest.approx(0.4, rel=0.15)
    assert parts([f.ne_m for f in fixes]).slow == pytest.approx(world.map_error_m, rel=0.35)
    assert parts([f.agl_ratio for f in fixes]).white == pytest.approx(0.02, rel=0.15)


def test_every_number_has_a_name_of_its_own():
    world = FilterWorld(seconds=60.0)
    flown = [NavigatedFlight(run, []) for run in played(world)]
    for judged in (judge_rendered(flown), judge_odometry(flown)):
        assert len(as_json(judged)) == len(judged)


def test_rendered_flights_know_their_features():
    asked = ["bench", "estimator", "--scenario", "rendered", "--features", "none"]
    done = CliRunner().invoke(app, asked)
    assert done.exit_code == 2
