"""The filter's benchmark: its statistics, its flights, its recordings."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2
from typer.testing import CliRunner

from vwnav.__main__ import app
from vwnav.bench.estimator.flown import Metric
from vwnav.bench.estimator.record import load_stream, save_stream
from vwnav.bench.estimator.run import play
from vwnav.bench.estimator.scenarios import SCENARIOS, FilterScenario, fly_scenario, judge_outage
from vwnav.bench.estimator.scores import chi_square_bounds, consistency
from vwnav.bench.estimator.streams import sense
from vwnav.bench.estimator.world import G_M_S2, FilterWorld, fly
from vwnav.estimation.config import EkfConfig
from vwnav.geometry.rotations import rotation_from_quat

SHORT = FilterWorld(seconds=40.0)


@pytest.mark.parametrize(("dof", "runs"), [(1, 20), (2, 200), (3, 50)])
def test_the_bounds_are_those_of_chi_square(dof, runs):
    exact = chi2.ppf([0.025, 0.975], dof * runs) / runs
    assert chi_square_bounds(dof, runs) == pytest.approx(exact, rel=0.01)


def test_an_honest_filter_is_within_the_bounds_and_a_boastful_one_is_not():
    values = np.random.default_rng(0).chisquare(2, (50, 2000))
    assert consistency(values, 2).inside == pytest.approx(0.95, abs=0.02)
    assert consistency(1.5 * values, 2).optimistic > 0.5
    assert consistency(0.6 * values, 2).pessimistic > 0.5


def test_a_flight_is_the_same_whatever_flies_beside_it():
    alone = fly(SHORT, [np.random.default_rng(3)])[0]
    beside = fly(SHORT, [np.random.default_rng(k) for k in (1, 2, 3)])[2]
    assert np.array_equal(alone.position_ned_m, beside.position_ned_m)
    assert np.array_equal(alone.quat_wxyz, beside.quat_wxyz)


def test_the_attitude_error_is_what_the_world_says():
    """Two degrees per axis over many flights, seen from the true attitude."""
    sizes = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        world = replace(SHORT, seconds=2.0)
        truth = fly(world, [rng])[0]
        event = next(
            e for e in sense(world, truth, rng).events if type(e.seen).__name__ == "Attitude"
        )
        sizes.append(_tilt_deg(event.seen.quat_wxyz))
    assert np.sqrt(np.mean(np.square(sizes))) == pytest.approx(2.0 * np.sqrt(2.0), rel=0.35)


def _tilt_deg(quat_wxyz) -> float:
    _, x, y, _ = quat_wxyz
    return float(np.degrees(np.arccos(1.0 - 2.0 * (x * x + y * y))))


def test_a_recording_replays_bit_for_bit(tmp_path):
    world = replace(SHORT, height_m=60.0, hill_m=30.0, table=True, imu_hz=20.0, wrong_share=0.1)
    rng = np.random.default_rng(1)
    stream = sense(world, fly(world, [rng])[0], rng)
    save_stream(stream, tmp_path / "flight.mcap")
    first, again = play(stream), play(load_stream(tmp_path / "flight.mcap", stream.truth))
    assert np.array_equal(first.last.x, again.last.x)
    assert np.array_equal(first.last.P, again.last.P)
    for a, b in zip(first.estimates, again.estimates, strict=True):
        assert np.array_equal(a.position_ned_m, b.position_ned_m)
        assert np.array_equal(a.quat_wxyz, b.quat_wxyz)


def test_lambda_pulls_the_estimate_to_the_fixes():
    runs = [
        fly_scenario(FilterScenario("x", SHORT, judge_outage, EkfConfig(visual_weight=w)), 1, 0)[0]
        for w in (0.0, 1.0)
    ]
    residuals = [
        [float(np.hypot(*i.residual)) for e, i in r.answers if e.error_m > 0.0 and i.accepted]
        for r in runs
    ]
    assert not np.array_equal(runs[0].last.x, runs[1].last.x)
    assert np.mean(residuals[1]) > np.mean(residuals[0])


def test_a_metric_knows_whether_it_is_reached():
    assert Metric("a", 1.0).good is None
    assert Metric("a", 1.0, "", 0.5, 2.0).good is True
    assert Metric("a", 3.0, "", 0.5, 2.0).good is False


def test_scenarios_have_names_of_their_own():
    assert len({s.name for s in SCENARIOS}) == len(SCENARIOS)


def test_the_command_prints_one_json_object():
    done = CliRunner().invoke(
        app, ["bench", "estimator", "--scenario", "outage", "--runs", "1", "--json"]
    )
    assert done.exit_code == 0
    metrics = json.loads(done.stdout)["scenarios"]["outage"]
    assert metrics["error at its end, RMS"]["high"] == 2.0


def test_an_unknown_scenario_is_wrong_usage():
    done = CliRunner().invoke(app, ["bench", "estimator", "--scenario", "nothing"])
    assert done.exit_code == 2


def test_the_world_feels_nothing_across_its_thrust_but_the_air():
    """In a climb in wind it leant as if it only hovered, and learned a drag that is too small."""
    world = replace(SHORT, gust_m_s=0.0, drag_per_s=1.0)
    truth = fly(world, [np.random.default_rng(1)])[0]
    acceleration = np.gradient(truth.velocity_ned_m_s, truth.t_s, axis=0)
    at = truth.index(5.0)  # climbing
    R_ned_body = rotation_from_quat(truth.quat_wxyz[at])
    felt = R_ned_body.T @ (acceleration[at] - [0.0, 0.0, G_M_S2])
    angle_rad = np.random.default_rng(1).uniform(0.0, 2.0 * np.pi)  # what a flight draws first
    wind = world.wind_m_s * np.array([np.cos(angle_rad), np.sin(angle_rad), 0.0])
    drag = -world.drag_per_s * R_ned_body.T @ (truth.velocity_ned_m_s[at] - wind)
    assert felt[:2] == pytest.approx(drag[:2], abs=0.05)
