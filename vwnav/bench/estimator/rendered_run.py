"""Rendered flights through the very pipeline that flies, in simulated time."""

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from heapq import merge
from pathlib import Path

import cv2
import numpy as np

from vwnav.assemble import assemble, choose_features
from vwnav.bench.estimator.flown import Metric, NavigatedFlight, RenderedScenario, Run
from vwnav.bench.estimator.plots import save_error_plot
from vwnav.bench.estimator.rendered_errors import with_errors
from vwnav.bench.estimator.rendered_flight import RENDERED_S, RenderedFlight, images, plan_flight
from vwnav.bench.estimator.run import START_SIGMA_M, against
from vwnav.bench.estimator.streams import MeasurementEvent, MeasurementStream
from vwnav.config import Config, with_features
from vwnav.estimation.beginning.starts import Start
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.context import Ground
from vwnav.estimation.ekf import Ekf
from vwnav.estimation.inputs import Measurement
from vwnav.estimation.states import Innovation
from vwnav.geometry.geodesy import LocalFrame
from vwnav.maps.pack import MapPack
from vwnav.onboard.simulation import map_pack_of
from vwnav.pipeline import Pipeline
from vwnav.recording.track_plot import TrackPlot
from vwnav.screen import say
from vwnav.seams import StepResult
from vwnav.sim.processor import LateExecutor, Processor, SimulatedClock
from vwnav.sim.renderer import default_camera
from vwnav.types import (
    Attitude,
    Estimate,
    FeatureName,
    Frame,
    Height,
    ImuSample,
    Rejected,
    RejectReason,
)

IMAGE_LATE_S = 0.04  # from exposure to the pipeline
_ESTIMATES_HZ = 5.0

Progress = Callable[[float], None]


@dataclass(frozen=True, slots=True, eq=False)
class Navigated:
    """What came out of the pipeline: estimates at a steady rate, and each image's result."""

    estimates: list[Estimate]
    steps: list[StepResult]


class HeardEkf(Ekf):
    """The filter itself; what it is told, and what it says of it, is written down.

    Attributes:
        answers: each measurement with the innovation, in order of arrival.
        cost_s: processor time of each.
    """

    def __init__(
        self, config: EkfConfig, ground: Ground | None = None, *, clock: SimulatedClock
    ) -> None:
        super().__init__(config, ground)
        self._clock = clock
        self.answers: list[tuple[MeasurementEvent, Innovation]] = []
        self.cost_s: list[float] = []

    def handle(self, seen: Measurement) -> Innovation:
        """As the filter does."""
        begin_s = time.process_time()
        answer = super().handle(seen)
        self.cost_s.append(time.process_time() - begin_s)
        self.answers.append((MeasurementEvent(self._clock.now_s, seen), answer))
        return answer


def bench_rendered(
    scenario: RenderedScenario,
    runs: int,
    seed: int,
    seconds: float | None,
    features: FeatureName,
    folder: Path | None,
    show: Callable[[float, str], None],
) -> list[Metric]:
    """Fly one scenario and judge it; tracks over the map and errors over time go to the folder.

    Raises:
        VwnavError: plots are wanted and their package is missing.
    """
    length_s = seconds or RENDERED_S
    flown: list[NavigatedFlight] = []
    for number in range(runs):
        name = f"{scenario.name}-{number + 1}"

        def progress(t_s: float, number: int = number) -> None:
            text = f"{scenario.name}: flight {number + 1} of {runs}, {t_s:.0f} of {length_s:.0f} s"
            show(number * length_s + t_s, text)

        image = None if folder is None else folder / f"{name}-track.png"
        flight = plan_flight(number, seed, length_s, scenario.imu_hz)
        frames = images(flight, default_camera())
        flown.append(fly_rendered(flight, frames, scenario.most_fixes, features, progress, image))
        if folder is not None:
            save_error_plot(flown[-1].run, folder / f"{name}.png")
    return scenario.judge(flown)


def fly_rendered(
    flight: RenderedFlight,
    frames: Iterable[Frame],
    most_fixes: int,
    features: FeatureName,
    progress: Progress,
    image: Path | None = None,
) -> NavigatedFlight:
    """Navigate one flight, then hold it against its truth.

    Args:
        flight: what the autopilot says in it; its truth is not looked at before the end.
        frames: what the camera sees.
        most_fixes: the map is asked until it has given so many; 0 is no limit.
        features: of the map matching.
        progress: told the time of each image.
        image: where to draw the track over the map.
    """
    cv2.setNumThreads(1)  # the same flight gives the same trajectory
    clock = SimulatedClock()
    local_frame = LocalFrame(flight.site.home_lat_deg, flight.site.home_lon_deg, 0.0)
    config = _config(most_fixes, features)
    primary, fallback = choose_features(config.features, say)
    extractors = [primary, *([fallback] if fallback else [])]
    with MapPack.open(map_pack_of(f"sim:{flight.site.seed}", extractors)) as pack:
        assembled = assemble(
            primary, fallback, pack, default_camera(), local_frame, config,
            _executor(flight, clock), say, partial(HeardEkf, clock=clock),
        )  # fmt: skip
        ekf = assembled.ekf
        assert isinstance(ekf, HeardEkf)
        ekf.initialise(Start(t_s=0.0, position_ned_m=np.zeros(3), sigma_m=START_SIGMA_M))
        done = _navigate(assembled.pipeline, clock, frames, flight.telemetry, progress)
        if image is not None:
            _draw(done, flight, TrackPlot(pack, local_frame), image)
    return _flown(flight, ekf, done)


def _config(most_fixes: int, features: FeatureName) -> Config:
    config = with_features(Config(), features, None)
    asked = replace(config.pipeline, most_fixes=most_fixes)
    return config.model_copy(update={"pipeline": asked})


def _executor(flight: RenderedFlight, clock: SimulatedClock) -> LateExecutor:
    """Fixes are as late as in the fast benchmark, counted from the exposure."""
    low_s, high_s = flight.world.fix_latency_s
    lateness_s = low_s - IMAGE_LATE_S, high_s - IMAGE_LATE_S
    late = flight.latencies
    return LateExecutor(clock, Processor(), lambda *_: float(late.uniform(*lateness_s)))


def _navigate(
    pipeline: Pipeline,
    clock: SimulatedClock,
    frames: Iterable[Frame],
    telemetry: list[MeasurementEvent],
    progress: Progress,
) -> Navigated:
    """Hand everything in as it arrives."""
    done, due = Navigated([], []), 1
    for arrival_s, arrived in _in_order(frames, telemetry):
        while due / _ESTIMATES_HZ <= arrival_s:
            now = pipeline.estimate(due / _ESTIMATES_HZ)
            assert now is not None  # it was started on the ground
            done.estimates.append(now)
            due += 1
        clock.now_s = arrival_s
        match arrived:
            case Attitude() | ImuSample() | Height():
                pipeline.feed(arrived)
            case Frame():
                done.steps.append(pipeline.step(arrived))
                progress(arrived.t_s)
    return done


def _in_order(
    frames: Iterable[Frame], telemetry: list[MeasurementEvent]
) -> Iterator[tuple[float, object]]:
    """(arrival, what arrives); images are drawn when their turn comes."""
    told = ((event.arrival_s, event.seen) for event in telemetry)
    seen = ((frame.t_s + IMAGE_LATE_S, frame) for frame in frames)
    return merge(told, seen, key=lambda pair: pair[0])


def _flown(flight: RenderedFlight, ekf: HeardEkf, done: Navigated) -> NavigatedFlight:
    assert ekf.state is not None
    answers = with_errors(ekf.answers, flight.truth)
    stream = MeasurementStream(
        flight.truth, [event for event, _ in answers], flight.measured_yaw_rad
    )
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
    return NavigatedFlight(run, outcomes)


def _draw(done: Navigated, flight: RenderedFlight, track: TrackPlot, path: Path) -> None:
    for step in done.steps:
        track.add(step)
        track.add_truth(flight.truth.position_ned_m[flight.truth.index(step.t_s)])
    track.save(path)
