"""One flight's streams played into a filter, and its estimates held against the truth."""

import math
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from vwnav.bench.estimator.flown import Rows, Run
from vwnav.bench.estimator.streams import MeasurementEvent, MeasurementStream
from vwnav.bench.estimator.world import TrueTrajectory
from vwnav.estimation.beginning.starts import Start
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.ekf import Ekf
from vwnav.estimation.events import NedFix
from vwnav.estimation.inputs import Measurement
from vwnav.estimation.states import Innovation
from vwnav.geometry.rotations import rotation_from_quat, vector_from_rotation, wrap_pi
from vwnav.types import Array, Attitude, Estimate, ImuSample, OdometryMotion

START_SIGMA_M = 3.0
_SAME_RAD = math.radians(0.25)  # what interpolation between noisy attitudes makes of them


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


def rectified(seen: Measurement, ekf: Ekf, stream: MeasurementStream) -> Measurement:
    """`seen` in a stream that knows its autopilot's attitudes; anything else as it is.

    Where an attitude is late or lost the filter, not the autopilot, tells it: it carries the last
    one on, and an image is rectified with that. What it tells leans by the error of that attitude.
    """
    if stream.measured_quats is None:
        return seen
    if isinstance(seen, NedFix) and np.all(np.isfinite(seen.position_ne_m)):
        turn = _turn(seen.t_s, ekf, stream)
        if turn is not None:
            agl_m = float(stream.truth.agl_m[stream.truth.index(seen.t_s)])
            return replace(seen, position_ne_m=seen.position_ne_m + agl_m * _shift(turn))
    if isinstance(seen, OdometryMotion):
        turn0, turn1 = (_turn(t_s, ekf, stream) for t_s in (seen.t0_s, seen.t1_s))
        if turn0 is not None or turn1 is not None:
            zero, one = (np.zeros(3) if turn is None else turn for turn in (turn0, turn1))
            way = seen.displacement_ned_m + np.cross(zero, seen.displacement_ned_m)
            way[:2] += seen.tilt_share * seen.agl_m * (_shift(one) - _shift(zero))
            return replace(seen, displacement_ned_m=way)
    return seen


def _turn(t_s: float, ekf: Ekf, stream: MeasurementStream) -> Array | None:
    """(3,) NED rotation vector from the autopilot's attitude to that of the filter."""
    known = ekf.attitudes.at(t_s)
    if known is None or stream.measured_quats is None:
        return None
    R_measured = rotation_from_quat(stream.measured_quats[stream.truth.index(t_s)])
    turn = vector_from_rotation(rotation_from_quat(known.quat_wxyz) @ R_measured.T)
    return turn if float(np.linalg.norm(turn)) > _SAME_RAD else None


def _shift(turn: Array) -> Array:
    """(2,) by how much the ground point that seems to be below moves, per AGL."""
    return np.array([-turn[1], turn[0]])
