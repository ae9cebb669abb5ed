"""The flight's steps and threads: what reaches the autopilot, and what must not end a flight."""

import math
import threading
import time
from collections import deque
from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest
from vehicles import FLYING

from vwnav.clock import WallClock
from vwnav.errors import LinkError, VwnavError
from vwnav.mission.mission import FlightEnd, Phase
from vwnav.rules.flight_log import MISSION_HANGS
from vwnav.runtime import FlightRuntime
from vwnav.safety.camera_watch import CameraWatch
from vwnav.safety.estimate_guard import EstimateGuard
from vwnav.seams import ATTITUDE_WAIT_S, GuardedWatcher, StepResult
from vwnav.types import Estimate, Frame, ImuSample, OdometryMotion, Rejected, RejectReason

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
RUNAWAY = replace(ESTIMATE, velocity_ned_m_s=np.array([60.0, 0.0, 0.0]))
LOST = "the estimate is not sent any more"
STANDING = replace(FLYING, armed=False, in_air=False)


@dataclass
class Link:
    """An autopilot that stands; remembers what it was sent and when."""

    vehicle = STANDING
    sent: list = field(default_factory=list)
    sent_s: list = field(default_factory=list)
    texts: list = field(default_factory=list)
    steps: int = 0
    broken_steps: int = 0
    backlog: int = 0
    hangs: bool = False

    def step(self, t_s):
        if self.hangs:
            threading.Event().wait()
        self.steps += 1
        if self.steps <= self.broken_steps:
            raise OSError("link")

    def state(self):
        return self.vehicle

    def take_measurements(self):
        count, self.backlog = 1 + self.backlog, 0
        return count * (ImuSample(time.monotonic(), np.array([0.0, 0.0, -9.8]), np.zeros(3)),)

    def take_orders(self):
        return (), ()

    def send_text(self, text):
        self.texts.append(text)

    def send_estimate(self, estimate):
        self.sent.append(estimate)
        self.sent_s.append(time.monotonic())


@dataclass
class Path:
    """A pipeline that always believes `believed`; an image takes `stall_s` or breaks it."""

    believed: Estimate = ESTIMATE
    stall_s: float = 0.0
    broken: bool = False
    covered: bool = True
    feed_s: float = 0.0
    link_rests: threading.Event = field(default_factory=threading.Event)
    rested: list = field(default_factory=list)
    fed: list = field(default_factory=list)
    seen: list = field(default_factory=list)
    attempts: int = 0

    def estimate(self, t_s):
        return replace(self.believed, t_s=t_s)

    def feed(self, measurement):
        self.fed.append(measurement)
        self.rested.append(self.link_rests.is_set())
        time.sleep(self.feed_s)

    def learned(self):
        return None

    def covers(self, t_s):
        return self.covered

    def step(self, frame):
        self.seen.append((frame.index, time.monotonic() - frame.t_s))
        time.sleep(self.stall_s)
        if self.broken:
            raise ValueError("bad picture")
        motion = OdometryMotion(
            frame.t_s - 0.1, frame.t_s, np.zeros(3), np.eye(3), 0.0, 0.01, 50.0, 100
        )
        return StepResult(frame.t_s, motion, Rejected(frame.t_s, RejectReason.NOT_TRIED), None)


class Images:
    """A noisy camera; `failures` are raised first, one a call, then times are off by `off_s`."""

    def __init__(self, failures=(), frozen=False, size=(48, 64), off_s=()):
        self.closed = threading.Event()
        self.failures = list(failures)
        self.frozen, self.size, self.count, self.off_s = frozen, size, 0, list(off_s)
        self.rng = np.random.default_rng(1)

    def next_frame(self):
        time.sleep(0.005)
        if self.failures:
            raise self.failures.pop()
        self.count += 1
        rng = np.random.default_rng(1) if self.frozen else self.rng
        image = rng.integers(0, 255, self.size, dtype=np.uint8)
        off_s = self.off_s.pop() if self.off_s else 0.0
        return None if self.closed.is_set() else Frame(time.monotonic() + off_s, image, self.count)


@dataclass
class Mission:
    """Ends after some ticks."""

    ticks: int = 8
    end: FlightEnd | None = None
    error: Exception | None = None
    hangs: bool = False
    phase: Phase = Phase.ROUTE
    navigation: list = field(default_factory=list)

    def tick(self, t_s, navigation):
        self.ticks -= 1
        self.navigation.append(navigation)
        if self.error is not None:
            raise self.error
        if self.hangs:
            threading.Event().wait()
        if self.ticks == 0:
            self.end = FlightEnd(None)


@dataclass
class Record:
    events: list = field(default_factory=list)
    frames: list = field(default_factory=list)
    full: bool = False

    def saw_frame(self, frame, step):
        self.frames.append(step)
        if self.full:
            raise OSError(28, "No space left on device")

    def saw_tick(self, *_):
        if self.full:
            raise OSError(28, "No space left on device")

    def event(self, text):
        self.events.append(text)
        if self.full:
            raise OSError(28, "No space left on device")


@dataclass
class Handle:
    """To the watchdog; remembers when it was told that the navigator ends."""

    report = None
    left_s: list = field(default_factory=list)

    def leave(self):
        self.left_s.append(time.monotonic())


def fly(path=None, mission=None, images=None, link=None, record=None, handle=None, notices=()):
    path, mission, link = path or Path(), mission or Mission(), link or Link()
    images, record, handle = images or Images(), record or Record(), handle or Handle()
    runtime = FlightRuntime(
        path, mission, link, EstimateGuard(), handle, CameraWatch(64, 48),
        GuardedWatcher(record), deque(notices),
    )  # fmt: skip
    try:
        end = runtime.run(images, WallClock())
    finally:
        images.closed.set()
    return SimpleNamespace(end=end, link=link, path=path, record=record, mission=mission)


def test_estimates_and_telemetry_go_on_while_an_image_stalls():
    flown = fly(Path(stall_s=5.0))
    assert flown.end.reason is None
    assert len(flown.path.seen) == 1
    assert len(flown.link.sent) >= 5
    assert len(flown.path.fed) == flown.link.steps  # each measurement once


def test_who_computes_an_image_is_told_that_the_link_takes_its_turn():
    flown = fly()
    assert flown.path.rested
    assert not any(flown.path.rested)
    assert flown.path.link_rests.is_set()


def test_it_is_known_whether_the_newest_image_told_a_motion_or_one_is_late():
    path, images = Path(), Images()
    runtime = FlightRuntime(
        path, Mission(), Link(), EstimateGuard(), Handle(), CameraWatch(64, 48),
        GuardedWatcher(Record()), deque(),
    )  # fmt: skip

    def follows() -> bool:
        runtime.step_link(time.monotonic())
        return runtime.navigation.follows

    assert not follows()
    frame = images.next_frame()
    runtime.step_vision(frame, frame.t_s)
    assert follows()
    path.broken = True
    frame = images.next_frame()
    runtime.step_vision(frame, frame.t_s)
    assert not follows()


def test_estimates_leave_at_50_hz_predicted_to_now_with_the_age_of_the_last_fix():
    fixed_s = time.monotonic()
    flown = fly(Path(believed=replace(ESTIMATE, t_last_fix_s=fixed_s)), Mission(ticks=25))
    link = flown.link
    assert np.median(np.diff(link.sent_s)) == pytest.approx(0.02, abs=0.005)
    late_s = np.array(link.sent_s) - [estimate.t_s for estimate in link.sent]
    assert np.median(late_s) < 0.01
    assert np.all(np.diff([each.t_s - each.t_last_fix_s for each in link.sent]) > 0.0)


def test_images_that_break_the_pipeline_never_switch_vision_off(caplog):
    flown = fly(Path(broken=True), Mission(ticks=20))
    assert sum(bool(each.exc_info) for each in caplog.records) == 1  # thirty a second fill a screen
    assert flown.end.reason is None
    assert len(flown.path.seen) > 40
    assert sum("could not be used" in text for text in flown.record.events) == 1


@pytest.mark.parametrize("off_s", [math.nan, 3600.0, -3600.0])
def test_an_image_with_a_false_time_is_not_waited_for_nor_used_and_the_next_ones_are(off_s):
    images = Images(off_s=[off_s, off_s])
    flown = fly(images=images, mission=Mission(ticks=20))
    assert len(flown.path.seen) > 20
    assert min(index for index, _ in flown.path.seen) == 3
    assert all(math.isfinite(step.t_s) for step in flown.record.frames)
    assert sum("not of now" in text for text in flown.record.events) == 1


def test_a_camera_that_fails_is_asked_again_and_the_flight_goes_on():
    flown = fly(mission=Mission(ticks=40), images=Images([OSError("cable")]))
    assert flown.end.reason is None
    assert flown.path.seen
    assert sum("camera fails" in text for text in flown.record.events) == 1


def test_a_disk_that_is_full_ends_no_flight_and_is_said_once():
    flown = fly(record=Record(full=True))
    assert flown.end.reason is None
    assert flown.path.seen
    assert sum("recording fails" in text for text in flown.record.events) == 1


@pytest.mark.parametrize("full", [False, True])
def test_what_the_filter_found_out_is_told_to_the_record_and_to_the_ground_stations(full):
    found = ["the rangefinder is not believed", "the camera hangs 6 degrees round"]
    flown = fly(record=Record(full=full), notices=found)
    assert flown.end.reason is None
    assert flown.link.texts == found
    assert [text for text in flown.record.events if text in found] == found


@pytest.mark.parametrize(
    ("path", "images", "told"),
    [
        (Path(broken=True), None, "a picture could not be used: ValueError('bad picture')"),
        (None, Images([OSError("cable")]), "the camera fails, flying on without pictures: cable"),
        (Path(believed=RUNAWAY), None, f"{LOST}: the estimate moves at 60 m/s"),
    ],
    ids=["picture", "camera", "estimate"],
)
def test_what_befalls_the_loops_is_told_to_the_ground_stations_too(path, images, told):
    """In flight nobody reads the companion's screen."""
    flown = fly(path, Mission(ticks=20), images)
    assert told in flown.record.events
    assert told in flown.link.texts


def test_a_step_of_the_link_that_fails_is_tried_again():
    flown = fly(link=Link(broken_steps=3))
    assert flown.end.reason is None
    assert flown.link.sent


def test_a_runaway_estimate_is_neither_sent_nor_flown_on_and_the_mission_knows_why():
    flown = fly(Path(believed=RUNAWAY))
    assert flown.link.sent == []
    assert flown.mission.navigation[-1].estimate is None
    assert "60 m/s" in flown.mission.navigation[-1].lost


def test_the_mission_flies_on_the_estimate_that_was_sent():
    flown = fly()
    assert flown.mission.navigation[-1].estimate in flown.link.sent


def test_an_image_waits_for_telemetry_of_its_exposure_and_not_for_ever():
    flown = fly(Path(covered=False), Mission(ticks=20))
    waits_s = [waited_s for _, waited_s in flown.path.seen]
    assert (
        waits_s[0] >= ATTITUDE_WAIT_S
    )  # the last one may have been cut short by the end of the flight


@pytest.mark.parametrize(
    ("images", "word"),
    [(Images(frozen=True), "repeats its pictures"), (Images(size=(60, 80)), "calibration")],
    ids=["frozen", "another size"],
)
def test_images_that_cannot_be_true_are_not_seen_but_have_their_row(images, word):
    flown = fly(images=images, mission=Mission(ticks=15))
    assert len(flown.path.seen) <= 1
    assert len(flown.record.frames) > 10
    seen_s = flown.mission.navigation[-1].seen_s
    assert seen_s is None or time.monotonic() - seen_s > 0.3
    assert any(word in text for text in flown.record.events)


def test_what_breaks_the_mission_is_raised_once_it_is_down_and_estimates_go_on_till_then():
    link = Link()
    link.vehicle = FLYING
    threading.Timer(1.0, lambda: setattr(link, "vehicle", STANDING)).start()
    began_s = time.monotonic()
    with pytest.raises(ZeroDivisionError):
        fly(mission=Mission(error=ZeroDivisionError()), link=link)
    assert "the mission broke: the watchdog lands the aircraft (ZeroDivisionError())" in link.texts
    assert time.monotonic() - began_s > 0.9
    assert link.steps > 30


def test_a_mission_that_hangs_is_one_that_broke():
    link = Link()
    link.vehicle = FLYING
    threading.Timer(4.0, lambda: setattr(link, "vehicle", STANDING)).start()
    record = Record()
    with pytest.raises(VwnavError, match="the loop of the mission hangs"):
        fly(mission=Mission(hangs=True), link=link, record=record)
    assert MISSION_HANGS in record.events
    assert MISSION_HANGS in link.texts
    assert link.steps > 120  # estimates went on


@pytest.mark.parametrize(
    ("link", "error"), [(Link(hangs=True), LinkError), (Link(broken_steps=10_000), OSError)]
)
def test_a_link_that_hangs_or_fails_on_and_on_ends_the_program_at_once(link, error):
    """The watchdog is told first, so that the second navigator begins meanwhile."""
    mission, handle = Mission(ticks=10_000), Handle()
    with pytest.raises(error):
        fly(Path(stall_s=5.0), mission, link=link, handle=handle)
    assert 15 < len(mission.navigation) < 50
    assert time.monotonic() - handle.left_s[0] < 1.0


def test_a_link_that_catches_up_with_much_telemetry_on_a_busy_machine_does_not_hang():
    link = Link(backlog=350)
    flown = fly(Path(feed_s=0.01), Mission(ticks=90), link=link)  # 3.5 s of it
    assert flown.end.reason is None
    assert len(flown.path.fed) > 350


def test_a_mission_that_breaks_beside_an_autopilot_that_is_gone_ends_too():
    link = Link()
    link.vehicle = replace(FLYING, silence_s=61.0)
    with pytest.raises(ZeroDivisionError):
        fly(mission=Mission(error=ZeroDivisionError()), link=link)
