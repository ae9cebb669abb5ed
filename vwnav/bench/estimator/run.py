"""One flight's streams played into a filter, and its estimates held against the truth."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vwnav.bench.estimator.rectified import rectified
from vwnav.bench.estimator.streams import MeasurementEvent, MeasurementStream
from vwnav.bench.estimator.world import TrueTrajectory
from vwnav.estimation.ekf import Ekf, EkfConfig, Innovation, NedFix, Start
from vwnav.estimation.states import FilterState
from vwnav.geometry.rotations import wrap_pi
from vwnav.types import Array, Attitude, Estimate, ImuSample, OdometryMotion

START_SIGMA_M = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Estimates at a steady rate against the truth, one row each.

    Attributes:
        t_s: (n,). error_ne_m (n, 2), error_v_m_s (n, 3), error_yaw_rad (n,), error_agl_m (n,):
            estimate minus truth.
        P: (n, 6, 6) of position and velocity. sigma_yaw_rad, sigma_agl_m: (n,).
        agl_m: (n,) true. way_m: (n,) flown so far, horizontally.
    """

    t_s: Array
    error_ne_m: Array
    error_v_m_s: Array
    error_yaw_rad: Array
    error_agl_m: Array
    P: Array
    sigma_yaw_rad: Array
    sigma_agl_m: Array
    agl_m: Array
    way_m: Array


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """A flight through the filter.

    Attributes:
        answers: each event but attitudes and IMU samples, which are many and never compared, with
            what the filter said of it. cost_s: (n,) processor time of each.
        busy_s: processor time of all, estimates included.
    """

    stream: MeasurementStream
    rows: Rows
    estimates: list[Estimate]
    answers: list[tuple[MeasurementEvent, Innovation]]
    last: FilterState
    cost_s: Array
    busy_s: float


def play(
    stream: MeasurementStream,
    config: EkfConfig | None = None,
    start: Start | None = None,
    rate_hz: float = 5.0,
    drop: Callable[[MeasurementEvent], bool] | None = None,
    say: Callable[[str], None] | None = None,
) -> Run:
    """Play a stream into a new filter as it arrives, from standing on the ground.

    `drop(event)` leaves events out; `say` takes the filter's sentences.
    """
    ekf = Ekf(config or EkfConfig(), ground=stream.ground)
    ekf.initialise(
        start or Start(t_s=0.0, position_ned_m=np.zeros(3), sigma_m=START_SIGMA_M, agl_m=0.15)
    )
    if say is not None:
        ekf.on_event(say)
    estimates: list[Estimate] = []
    answers: list[tuple[MeasurementEvent, Innovation]] = []
    cost_s: list[float] = []
    begin_s = time.process_time()
    due, end_s = 1, float(stream.truth.t_s[-1])
    for event in stream.events:
        if drop is not None and drop(event):
            continue
        while due / rate_hz <= min(event.arrival_s, end_s):
            now = ekf.estimate(due / rate_hz)
            assert now is not None  # attitudes come from the first moment on
            estimates.append(now)
            due += 1
        event_s = time.process_time()
        answer = ekf.handle(rectified(event.seen, ekf, stream))
        if not isinstance(event.seen, Attitude | ImuSample):
            cost_s.append(time.process_time() - event_s)
            answers.append((event, answer))
    busy_s = time.process_time() - begin_s
    assert ekf.state is not None
    rows = against(stream.truth, estimates)
    return Run(stream, rows, estimates, answers, ekf.state, np.array(cost_s), busy_s)


def against(truth: TrueTrajectory, estimates: list[Estimate]) -> Rows:
    """Errors of estimates."""
    at = np.array([truth.index(e.t_s) for e in estimates])
    steps = np.hypot(*np.diff(truth.position_ned_m[:, :2], axis=0, prepend=0.0).T)
    yaws = np.array([heading(e) for e in estimates])
    return Rows(
        t_s=np.array([e.t_s for e in estimates]),
        error_ne_m=np.array([e.position_ned_m[:2] for e in estimates])
        - truth.position_ned_m[at, :2],
        error_v_m_s=np.array([e.velocity_ned_m_s for e in estimates]) - truth.velocity_ned_m_s[at],
        error_yaw_rad=np.array(
            [wrap_pi(a - b) for a, b in zip(yaws, truth.yaw_rad[at].tolist(), strict=True)]
        ),
        error_agl_m=np.array([e.agl_m for e in estimates]) - truth.agl_m[at],
        P=np.array([e.covariance for e in estimates]),
        sigma_yaw_rad=np.array([e.sigma_yaw_rad for e in estimates]),
        sigma_agl_m=np.array([e.sigma_agl_m for e in estimates]),
        agl_m=truth.agl_m[at],
        way_m=np.cumsum(steps)[at],
    )


def heading(estimate: Estimate) -> float:
    """Yaw of an estimate, radians."""
    w, x, y, z = estimate.quat_wxyz.tolist()
    return math.atan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))


def pictures(run: Run) -> int:
    """How many pictures odometry has seen."""
    return sum(isinstance(event.seen, OdometryMotion) for event, _ in run.answers)


def accepted_wrong(run: Run, wrong_m: float) -> int:
    """How many accepted fixes were further off than that."""
    return sum(
        isinstance(event.seen, NedFix) and answer.accepted and event.error_m > wrong_m
        for event, answer in run.answers
    )
