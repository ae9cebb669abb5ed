"""Rendered flights through the very pipeline that flies, in simulated time."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from heapq import merge
from pathlib import Path

import cv2
import numpy as np

from vwnav.bench.estimator_run import START_SIGMA_M, Run, against
from vwnav.bench.estimator_streams import Event, HeightSeen, Stream
from vwnav.bench.rendered_clock import HeardEkf, LateExecutor, SimulatedClock
from vwnav.bench.rendered_errors import with_errors
from vwnav.bench.rendered_flight import RenderedFlight, pictures, plan_flight
from vwnav.bench.rendered_scenarios import Flown, RenderedScenario
from vwnav.cli.assemble import assemble, choose_features
from vwnav.cli.simulation import map_pack_of
from vwnav.config import Config
from vwnav.drivers.attitude_track import AttitudeTrack
from vwnav.drivers.track_picture import TrackPicture
from vwnav.estimation.ekf import Start
from vwnav.geometry.geodesy import LocalFrame
from vwnav.maps.pack import MapPack
from vwnav.pipeline import Pipeline, Sensors, StepResult
from vwnav.sim.renderer import default_camera
from vwnav.types import Attitude, Estimate, FeatureName, Frame, RejectReason, Rejected

PICTURE_LATE_S = 0.04  # from exposure to the pipeline
_ESTIMATES_HZ = 5.0
_ATTITUDE_GAP_S = 0.1

Say = Callable[[str], None]


@dataclass(frozen=True, slots=True, eq=False)
class Navigated:
    """What came out of the pipeline: estimates at a steady rate, and each picture's result."""

    estimates: list[Estimate]
    steps: list[StepResult]


def fly_rendered(
    scenario: RenderedScenario,
    number: int,
    seed: int,
    seconds: float,
    features: FeatureName,
    say: Say,
    picture: Path | None = None,
) -> Flown:
    """Fly one flight of a scenario and hold it against its truth.

    Args:
        scenario: says how often the map is asked.
        number: of the flight, from 0; its site and its course follow from it and the seed.
        seed: of everything random.
        seconds: length.
        features: of the map matching.
        say: told how far it is.
        picture: where to draw the track over the map.
    """
    flight = plan_flight(number, seed, seconds)
    frames = pictures(flight, default_camera())
    return navigate_flight(flight, frames, scenario, number, features, say, picture)


def navigate_flight(
    flight: RenderedFlight,
    frames: Iterable[Frame],
    scenario: RenderedScenario,
    number: int,
    features: FeatureName,
    say: Say,
    picture: Path | None = None,
) -> Flown:
    """The same with any pictures. The truth comes in only when the flight has been navigated."""
    cv2.setNumThreads(1)  # the same flight gives the same trajectory
    clock = SimulatedClock()
    low_s, high_s = flight.world.fix_latency_s
    lateness_s = low_s - PICTURE_LATE_S, high_s - PICTURE_LATE_S
    config = Config()
    asked = replace(config.pipeline, most_fixes=scenario.most_fixes)
    config = config.model_copy(update={"pipeline": asked})
    site = flight.site
    local_frame = LocalFrame(site.home_lat_deg, site.home_lon_deg, 0.0)
    primary, fallback = choose_features(features, None, say)
    with ExitStack() as stack:
        extractors = [primary, *([fallback] if fallback else [])]
        pack = stack.enter_context(MapPack.open(map_pack_of(f"sim:{site.seed}", extractors)))
        assembled = assemble(
            pack, default_camera(), features, None, local_frame, config,
            LateExecutor(clock, lateness_s, flight.latencies), say, partial(HeardEkf, clock=clock),
        )  # fmt: skip
        ekf = assembled.ekf
        assert isinstance(ekf, HeardEkf)
        ekf.initialise(Start(t_s=0.0, position_ned_m=np.zeros(3), sigma_m=START_SIGMA_M))
        done = _navigate(assembled.pipeline, clock, frames, flight.telemetry, say)
        if picture is not None:
            _draw(done, flight, TrackPicture(pack, local_frame), picture)
    return _flown(flight, number, ekf, done)


def _navigate(
    pipeline: Pipeline,
    clock: SimulatedClock,
    frames: Iterable[Frame],
    telemetry: list[Event],
    say: Say,
) -> Navigated:
    """Hand everything in as it arrives."""
    track = AttitudeTrack(_ATTITUDE_GAP_S)
    height: HeightSeen | None = None
    done, due = Navigated([], []), 1
    for arrival_s, arrived in _in_order(frames, telemetry):
        while due / _ESTIMATES_HZ <= arrival_s:
            now = pipeline.estimate(due / _ESTIMATES_HZ)
            assert now is not None  # it was started on the ground
            done.estimates.append(now)
            due += 1
        clock.now_s = arrival_s
        match arrived:
            case Attitude():
                track.add(arrived.t_s, arrived.quat_wxyz)
                pipeline.sense(arrival_s, Sensors(attitude=arrived))
            case HeightSeen():
                height = arrived
                pipeline.sense(arrival_s, _sensors(None, height))
            case Frame():
                sensors = _sensors(track.at(arrived.t_s), height)
                done.steps.append(pipeline.step(arrived, sensors))
                say(f"{arrived.t_s:.0f} s")
    return done


def _in_order(
    frames: Iterable[Frame], telemetry: list[Event]
) -> Iterator[tuple[float, object]]:
    """(arrival, what arrives); pictures are drawn when their turn comes."""
    told = ((event.arrival_s, event.seen) for event in telemetry)
    seen = ((frame.t_s + PICTURE_LATE_S, frame) for frame in frames)
    return merge(told, seen, key=lambda pair: pair[0])


def _sensors(attitude: Attitude | None, height: HeightSeen | None) -> Sensors:
    if height is None:
        return Sensors(attitude=attitude)
    return Sensors(attitude=attitude, height_m=height.height_m, height_t_s=height.t_s)


def _flown(flight: RenderedFlight, number: int, ekf: HeardEkf, done: Navigated) -> Flown:
    assert ekf.state is not None
    answers = with_errors(ekf.answers, flight.truth)
    stream = Stream(flight.truth, [event for event, _ in answers], flight.measured_yaw_rad)
    run = Run(
        stream,
        against(flight.truth, done.estimates),
        done.estimates,
        answers,
        ekf.state,
        np.array(ekf.cost_s),
        float(np.sum(ekf.cost_s)),
    )
    idle = (RejectReason.NOT_TRIED, RejectReason.TOO_LOW)
    outcomes = [
        step.outcome
        for step in done.steps
        if not (isinstance(step.outcome, Rejected) and step.outcome.reason in idle)
    ]
    return Flown(number, run, outcomes)


def _draw(done: Navigated, flight: RenderedFlight, track: TrackPicture, path: Path) -> None:
    for step in done.steps:
        track.add(step)
        track.add_truth(flight.truth.position_ned_m[flight.truth.index(step.t_s)])
    track.save(path)
