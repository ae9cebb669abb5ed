"""Real time around the pipeline: what reaches the autopilot, and what stops it."""

import threading
import time
from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest
from vehicles import FLYING

from vwnav.flight import FlightEnd
from vwnav.runtime import FlightRuntime
from vwnav.safety.estimate_guard import is_flyable
from vwnav.types import Attitude, Estimate, Frame, ImuSample

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
ESTIMATE = Estimate(
    t_s=0.0,
    position_ned_m=np.zeros(3),
    velocity_ned_m_s=np.zeros(3),
    covariance=np.eye(6) * 0.1,
    quat_wxyz=LEVEL,
    sigma_yaw_rad=0.1,
    agl_m=50.0,
    sigma_agl_m=1.0,
    t_last_fix_s=None,
    reset_counter=0,
)
VEHICLE = replace(FLYING, attitude=Attitude(0.0, LEVEL))


@dataclass
class Link:
    sent: list = field(default_factory=list)
    sent_s: list = field(default_factory=list)

    def state(self):
        return VEHICLE

    def attitude_at(self, t_s):
        return VEHICLE.attitude

    def take_imu(self):
        return (ImuSample(time.monotonic(), np.array([0.0, 0.0, -9.8]), np.zeros(3)),)

    def send_estimate(self, estimate):
        self.sent.append(estimate)
        self.sent_s.append(time.monotonic())


@dataclass
class Path:
    """A pipeline that always believes `estimate`; a picture takes `stall_s` or breaks it."""

    believed: Estimate = ESTIMATE
    stall_s: float = 0.0
    broken: bool = False
    sensed: int = 0
    imu: list = field(default_factory=list)
    steps: int = 0

    def estimate(self, t_s):
        return replace(self.believed, t_s=t_s)

    def sense(self, t_s, sensors):
        self.sensed += 1
        self.imu += sensors.imu

    def step(self, frame, sensors):
        self.steps += 1
        time.sleep(self.stall_s)
        if self.broken:
            raise ValueError("bad picture")
        return SimpleNamespace()


class Pictures:
    def __init__(self):
        self.closed = threading.Event()

    def next_frame(self):
        time.sleep(0.005)
        return None if self.closed.is_set() else Frame(time.monotonic(), np.zeros((4, 4)), 0)


@dataclass
class Mission:
    """Ends after some ticks."""

    ticks: int = 8
    end: FlightEnd | None = None
    error: Exception | None = None

    def tick(self, t_s, estimate):
        self.ticks -= 1
        if self.error is not None:
            raise self.error
        if self.ticks == 0:
            self.end = FlightEnd(None)


def fly(path, mission=None):
    link, pictures = Link(), Pictures()
    watcher = SimpleNamespace(saw_frame=lambda *_: None, saw_tick=lambda *_: None)
    mission = mission or Mission()
    try:
        return link, FlightRuntime(path, mission, link, pictures, watcher).run()
    finally:
        pictures.closed.set()


def test_estimates_and_telemetry_go_on_while_a_picture_stalls():
    path = Path(stall_s=5.0)
    link, end = fly(path)
    assert end.reason is None
    assert path.steps == 1
    assert len(link.sent) >= 5
    assert path.sensed >= 5
    assert len(path.imu) == path.sensed  # each sample once


def test_estimates_leave_at_50_hz_predicted_to_now_with_the_age_of_the_last_fix():
    fixed_s = time.monotonic()
    path = Path(believed=replace(ESTIMATE, t_last_fix_s=fixed_s))
    link, _ = fly(path, Mission(ticks=25))
    assert np.median(np.diff(link.sent_s)) == pytest.approx(0.02, abs=0.005)
    late_s = np.array(link.sent_s) - [estimate.t_s for estimate in link.sent]
    assert np.median(late_s) < 0.01
    ages_s = [estimate.fix_age_s for estimate in link.sent]
    assert ages_s == pytest.approx(np.array(link.sent_s) - fixed_s, abs=0.2)
    assert np.all(np.diff(ages_s) > 0.0)


def test_pictures_that_break_the_pipeline_do_not_end_the_flight():
    path = Path(broken=True)
    _, end = fly(path)
    assert end.reason is None
    assert path.steps > 1


def test_a_runaway_estimate_is_not_sent():
    path = Path(believed=replace(ESTIMATE, covariance=np.eye(6) * 400.0))
    link, _ = fly(path)
    assert link.sent == []


def test_what_breaks_the_mission_is_raised():
    with pytest.raises(ZeroDivisionError):
        fly(Path(), Mission(error=ZeroDivisionError()))


@pytest.mark.parametrize(
    ("speed_m_s", "sigma_m_s", "good"), [(9.0, 0.5, True), (60.0, 0.5, False), (9.0, 8.0, False)]
)
def test_an_estimate_is_flown_on_while_its_velocity_is_known(speed_m_s, sigma_m_s, good):
    covariance = np.eye(6) * sigma_m_s**2
    velocity = np.array([speed_m_s, 0.0, 0.0])
    estimate = replace(ESTIMATE, velocity_ned_m_s=velocity, covariance=covariance)
    assert is_flyable(estimate) is good
