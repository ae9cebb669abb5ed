"""The one path: what is tried when, what is fused, and which features stand in."""

import math
import threading
import time
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from vwnav.estimation.beginning.starts import Start
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.ekf import Ekf
from vwnav.estimation.events import Untracked
from vwnav.estimation.states import States
from vwnav.geometry.camera import to_gray
from vwnav.geometry.geodesy import LocalFrame
from vwnav.geometry.rotations import (
    euler_from_rotation,
    quat_from_rotation,
    rotation_from_euler,
    wrap_pi,
)
from vwnav.pipeline import Pipeline
from vwnav.seams import FeatureChoice, InlineExecutor, PipelineConfig
from vwnav.types import (
    Attitude,
    Frame,
    Height,
    MapFix,
    OdometryMotion,
    Prior,
    Rejected,
    RejectReason,
)
from vwnav.vehicle import FoundCamera, Learned

HOME = LocalFrame(60.4, 22.5, 0.0)
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
IMAGE = np.zeros((48, 64, 3), np.uint8)


@dataclass
class FakeLocalizer:
    """Answers with a fix at (north, east) metres, or a rejection."""

    north_east_m: tuple[float, float] | None = (0.0, 0.0)
    reason: RejectReason = RejectReason.FEW_INLIERS
    priors: list[Prior] = field(default_factory=list)
    error: Exception | None = None
    given_up: int = 0

    def give_up(self):
        self.given_up += 1

    def localize(self, frame: Frame, prior: Prior, seed: int) -> MapFix | Rejected:
        self.priors.append(prior)
        if self.error is not None:
            raise self.error
        if self.north_east_m is None:
            return Rejected(frame.t_s, self.reason, features="learned")
        lat_deg, lon_deg, _ = HOME.to_geodetic(np.array([*self.north_east_m, -50.0]))
        return MapFix(
            t_s=frame.t_s,
            lat_deg=float(lat_deg),
            lon_deg=float(lon_deg),
            covariance_ne_m2=np.eye(2) * 0.5,
            yaw_rad=0.0,
            sigma_yaw_rad=0.02,
            agl_m=50.0,
            sigma_agl_m=1.0,
            point="nadir",
            features="learned",
        )


@dataclass
class Climbing(FakeLocalizer):
    """Sees itself by a share higher or lower than it is, on the way up from 22 m at 2 m/s.

    Heights that the prior does not reach it does not find.
    """

    focal_ratio: float = 1.0

    def localize(self, frame: Frame, prior: Prior, seed: int) -> MapFix | Rejected:
        found = super().localize(frame, prior, seed)
        seen_m = (22.0 + 2.0 * frame.t_s) / self.focal_ratio
        reach = 1.1 + 2.5 * prior.sigma_agl_ratio
        if isinstance(found, Rejected) or not 1.0 / reach < seen_m / prior.agl_m < reach:
            return Rejected(frame.t_s, RejectReason.FEW_INLIERS, features="learned")
        return replace(found, agl_m=seen_m)


@dataclass
class NoOdometry:
    """Finds nothing; remembers the attitudes it was handed."""

    attitudes: list = field(default_factory=list)
    readout_s: tuple[float, float] = (0.0, 0.015)

    def step(self, frame, R_ned_body, agl_m):
        self.attitudes.append(R_ned_body)
        return Rejected(frame.t_s, RejectReason.FEW_KEYPOINTS)

    def counted_attitude(self, t_s):
        return Attitude(t_s, LEVEL)


LEFT, RIGHT = 40, 200  # how bright an image is there


@dataclass
class Tilting(NoOdometry):
    """Stays where it is and tilts; a camera turned by so much shows it, known to be by less."""

    turn_rad: float = 0.0
    known_rad: float = 0.0
    mirrors: bool = False
    left: list[int] = field(default_factory=list)
    rng: Any = field(default_factory=lambda: np.random.default_rng(1))

    def step(self, frame, R_ned_body, agl_m):
        tilt_rad, turns_rad = 0.03 * self.rng.normal(size=2), 0.5 * np.pi * np.arange(4)
        c, s = np.cos(self.turn_rad - self.known_rad), np.sin(self.turn_rad - self.known_rad)
        seen_rad = np.array([[c, s], [-s, c]]) @ tilt_rad
        self.left.append(int(frame.image[0, 0]))
        if self.mirrors and self.left[-1] != LEFT:
            seen_rad *= [-1.0, 1.0]
        c, s = np.cos(turns_rad), np.sin(turns_rad)
        told_rad = np.stack([c * tilt_rad[0] + s * tilt_rad[1], c * tilt_rad[1] - s * tilt_rad[0]])
        told_rad = np.column_stack([told_rad, told_rad[:, :2] * [[-1.0], [1.0]]])
        ratios = (seen_rad @ told_rad - 0.5 * tilt_rad @ tilt_rad) / 0.01**2
        return OdometryMotion(
            frame.t_s - 0.1, frame.t_s, np.zeros(3), 0.01 * np.eye(3), 0.0, 0.01, agl_m, 80,
            tilts_along=float(ratios[0]), tilts_turned=ratios[1:],
        )  # fmt: skip


@dataclass
class Hanging(NoOdometry):
    """Finds out after two seconds that it is always the same picture."""

    def step(self, frame, R_ned_body, agl_m):
        hangs = frame.t_s > 2.0
        return Rejected(frame.t_s, RejectReason.NO_FRAME if hangs else RejectReason.FEW_MATCHES)


@dataclass
class Racing(NoOdometry):
    """Tells 50 m/s; counts how often it is told that it mistook the ground."""

    mistakes: int = 0

    def step(self, frame, R_ned_body, agl_m):
        way_m, since_s = np.array([5.0, 0.0, 0.0]), frame.t_s - 0.1
        return OdometryMotion(since_s, frame.t_s, way_m, 0.01 * np.eye(3), 0.0, 0.01, agl_m, 80)

    def mistook(self):
        self.mistakes += 1


def make_pipeline(
    primary,
    fallback=None,
    start=None,
    executor=None,
    said=None,
    most_fixes=0,
    ekf_config=None,
    odometry=None,
    recalibrated=None,
):
    config = PipelineConfig(fallback_after=3, primary_retry_every=2, most_fixes=most_fixes)

    def choose(primary):
        said_here = said if said is not None else []
        return FeatureChoice(primary, fallback, config, said_here.append)

    def made_anew(camera):
        turned = odometry or NoOdometry()
        turned.known_rad = euler_from_rotation(np.reshape(camera.R_mount, (3, 3)))[2]
        return choose(recalibrated(camera.focal_ratio)), turned

    ekf = Ekf(ekf_config or EkfConfig())
    if start is not None:
        ekf.initialise(start)
    executor = executor or InlineExecutor()
    return Pipeline(
        choose(primary), odometry or NoOdometry(), ekf, HOME, 0.02, config, executor,
        None if recalibrated is None else made_anew,
    )  # fmt: skip


def fly(pipeline, seconds: float, rate_hz: float = 10.0, t0_s: float = 0.0, attitude=LEVEL):
    """Hovers at 50 m; without attitude where that is None."""
    times = t0_s + np.arange(1, round(seconds * rate_hz) + 1) / rate_hz
    steps = []
    for i, t_s in enumerate(times):
        if attitude is not None:
            pipeline.feed(Attitude(t_s, attitude))
        pipeline.feed(Height(t_s, 50.0))
        steps.append(pipeline.step(Frame(t_s, IMAGE, i)))
    return steps


def above_home(sigma_m: float = 5.0) -> Start:
    return Start(t_s=0.0, position_ned_m=np.array([0.0, 0.0, -50.0]), sigma_m=sigma_m, agl_m=50.0)


@pytest.mark.parametrize(("sigma_agl_m", "looks"), [(0.3, False), (30.0, True)])
def test_a_height_too_low_to_see_is_looked_from_only_while_it_is_unsure(sigma_agl_m, looks):
    localizer, position = FakeLocalizer(None), np.array([0.0, 0.0, -1.0])
    start = Start(t_s=0.0, position_ned_m=position, sigma_m=5.0, agl_m=1.0, sigma_agl_m=sigma_agl_m)
    pipeline = make_pipeline(localizer, start=start)
    for i in range(1, 11):
        pipeline.feed(Attitude(0.1 * i, LEVEL))
        pipeline.step(Frame(0.1 * i, IMAGE, i))
    assert bool(localizer.priors) is looks


def test_a_fix_moves_the_estimate_and_the_next_prior_is_tighter():
    localizer = FakeLocalizer((4.0, -3.0))
    steps = fly(make_pipeline(localizer, start=above_home()), 5.0)
    assert steps[-1].estimate.position_ned_m[:2] == pytest.approx([4.0, -3.0], abs=0.7)
    assert localizer.priors[-1].sigma_m < localizer.priors[0].sigma_m


def test_a_way_that_no_aircraft_flies_is_no_motion_seen_and_looked_for_afresh():
    odometry = Racing()
    steps = fly(make_pipeline(FakeLocalizer(), start=above_home(), odometry=odometry), 2.0)
    assert all(isinstance(step.motion, Rejected) for step in steps)
    assert odometry.mistakes == len(steps)


def test_a_video_alone_goes_on_following_as_it_may_only_be_higher_than_thought():
    odometry, config = Racing(), EkfConfig().without_telemetry()
    pipeline = make_pipeline(
        FakeLocalizer(), start=above_home(), odometry=odometry, ekf_config=config
    )
    steps = fly(pipeline, 2.0, attitude=None)
    assert all(isinstance(step.motion, OdometryMotion) for step in steps[1:])
    assert odometry.mistakes == 0


def test_images_carry_how_the_body_moves_where_that_is_known():
    """Turning by 0.5 rad/s to the right, as attitudes around the exposure say."""
    frames = []

    class Looking(FakeLocalizer):
        def localize(self, frame, prior, seed):
            frames.append(frame)
            return super().localize(frame, prior, seed)

    for start in (None, above_home()):
        pipeline = make_pipeline(Looking(), start=start)
        for i in range(1, 100):
            turned = quat_from_rotation(rotation_from_euler(0.0, 0.0, 0.01 * i))
            pipeline.feed(Attitude(0.02 * i, turned))
        pipeline.step(Frame(1.0, IMAGE, 0))
    without, with_it = frames
    assert without.rates_rad_s is None
    assert with_it.rates_rad_s == pytest.approx([0.0, 0.0, 0.5], abs=1e-6)
    assert np.abs(with_it.velocity_body_m_s).max() < 0.5


def test_a_sure_filter_that_finds_nothing_is_doubted_until_it_finds_something():
    localizer = FakeLocalizer(None)
    pipeline = make_pipeline(localizer, start=above_home(sigma_m=0.5))
    fly(pipeline, 2.0)
    assert max(prior.sigma_m for prior in localizer.priors) < 6.0
    fly(pipeline, 28.0, t0_s=2.0)
    assert max(prior.sigma_m for prior in localizer.priors) > 20.0
    assert 0.1 < localizer.priors[-1].sigma_agl_ratio <= 0.3
    localizer.north_east_m = (0.0, 0.0)
    fly(pipeline, 3.0, t0_s=30.0)  # found twice, by searches a second apart
    assert localizer.priors[-1].sigma_m < 6.0


def test_a_picture_that_is_none_is_not_matched():
    """Where it was taken the aircraft is not any more: matched it was 43 m wrong, 9.6 sigmas."""
    localizer = FakeLocalizer()
    pipeline = make_pipeline(localizer, start=above_home(), odometry=Hanging())
    fly(pipeline, seconds=2.0)
    tried = len(localizer.priors)
    assert tried > 5
    steps = fly(pipeline, seconds=3.0, t0_s=2.0)
    assert len(localizer.priors) == tried
    assert all(isinstance(step.outcome, Rejected) for step in steps)


def test_without_a_start_the_whole_map_is_searched_and_the_first_fix_begins():
    localizer = FakeLocalizer((100.0, 50.0))
    steps = fly(make_pipeline(localizer), 1.0)
    assert localizer.priors[0].lat_deg is None
    assert steps[-1].estimate.position_ned_m[:2] == pytest.approx([100.0, 50.0], abs=1.0)


def test_what_a_search_finds_once_is_not_believed():
    localizer = FakeLocalizer((100.0, 50.0))
    pipeline = make_pipeline(localizer)
    steps = fly(pipeline, 0.1)
    localizer.north_east_m = (400.0, -50.0)
    steps += fly(pipeline, 1.0, t0_s=0.1)
    reasons = [each.outcome.reason for each in steps if isinstance(each.outcome, Rejected)]
    assert reasons.count(RejectReason.UNCONFIRMED) == 2  # there, and then elsewhere
    assert localizer.priors[1].sigma_m < 10.0  # the second image is looked for about the first


def test_nor_in_a_flight_that_knows_its_height_and_not_its_place():
    localizer = FakeLocalizer((100.0, 50.0))
    pipeline = make_pipeline(localizer, start=Start(t_s=0.0, position_ned_m=None, agl_m=50.0))
    (once,) = fly(pipeline, 0.1)
    assert once.outcome.reason is RejectReason.UNCONFIRMED
    steps = fly(pipeline, 1.0, t0_s=0.1)
    assert localizer.priors[1].sigma_m < 10.0
    assert localizer.priors[0].agl_m == pytest.approx(50.0, abs=1.0)
    assert steps[-1].estimate.position_ned_m[:2] == pytest.approx([100.0, 50.0], abs=1.0)


def test_what_was_found_once_and_not_again_is_searched_for_everywhere():
    localizer = FakeLocalizer((100.0, 50.0))
    pipeline = make_pipeline(localizer)
    fly(pipeline, 0.1)
    localizer.north_east_m = None
    fly(pipeline, 2.0, t0_s=0.1)
    assert localizer.priors[1].lat_deg is not None
    assert localizer.priors[-1].lat_deg is None


def test_a_wrong_beginning_is_found_out_within_ten_attempts():
    localizer = FakeLocalizer((100.0, 50.0))
    pipeline = make_pipeline(localizer)
    fly(pipeline, 1.0)
    wrong = len(localizer.priors)
    localizer.north_east_m = None  # ground that looked alike is left behind
    fly(pipeline, 1.2, t0_s=1.0)
    localizer.north_east_m = (-300.0, 80.0)
    steps = fly(pipeline, 3.0, t0_s=2.2)
    assert steps[-1].estimate.position_ned_m[:2] == pytest.approx([-300.0, 80.0], abs=1.0)
    searched = [prior.lat_deg is None for prior in localizer.priors[wrong:]]
    assert searched.index(True) < 8


def test_a_beginning_that_was_right_for_long_is_not_searched_for_again():
    localizer = FakeLocalizer((100.0, 50.0))
    pipeline = make_pipeline(localizer)
    fly(pipeline, 5.0)
    before = len(localizer.priors)
    localizer.north_east_m = None
    fly(pipeline, 5.0, t0_s=5.0)
    assert all(prior.lat_deg is not None for prior in localizer.priors[before:])


def test_a_start_of_unknown_position_searches_but_knows_the_height():
    localizer = FakeLocalizer(None)
    start = Start(t_s=0.0, position_ned_m=None, agl_m=50.0)
    fly(make_pipeline(localizer, start=start), 1.0)
    assert localizer.priors[0].lat_deg is None
    assert localizer.priors[0].agl_m == pytest.approx(50.0, abs=2.0)


def test_an_image_without_attitude_moves_nothing_and_says_why():
    """In place of what is missing nothing is put: no level attitude, no fix of a lean unknown."""
    localizer = FakeLocalizer((30.0, 0.0))
    pipeline = make_pipeline(localizer, start=above_home())
    fly(pipeline, 1.0, attitude=rotated())
    asked, handed = len(localizer.priors), len(pipeline._odometry.attitudes)
    steps = fly(pipeline, 2.0, t0_s=1.2, attitude=None)
    assert len(localizer.priors) == asked
    assert all(R is None for R in pipeline._odometry.attitudes[handed:])
    assert all(isinstance(step.outcome, Rejected) for step in steps)
    assert pipeline._ekf.attitudes.at(3.0) is None


def test_the_estimate_begins_with_the_first_attitude():
    pipeline = make_pipeline(FakeLocalizer(), start=above_home())
    assert fly(pipeline, 1.0, attitude=None)[-1].estimate is None
    assert fly(pipeline, 0.2, t0_s=1.0)[-1].estimate is not None


def test_an_image_is_covered_when_telemetry_has_reached_its_exposure():
    pipeline = make_pipeline(FakeLocalizer(), start=above_home())
    pipeline.feed(Attitude(0.10, LEVEL))
    assert not pipeline.covers(0.11)
    pipeline.feed(Attitude(0.12, LEVEL))
    assert pipeline.covers(0.11)


def test_the_attitude_at_exposure_is_that_of_the_one_history():
    pipeline, R = make_pipeline(FakeLocalizer(), start=above_home()), rotation_from_euler
    for t_s, yaw_rad in ((0.0, 0.2), (0.2, 0.4)):
        pipeline.feed(Attitude(t_s, quat_from_rotation(R(0.1, 0.0, yaw_rad))))
    pipeline.step(Frame(0.1, IMAGE, 0))
    assert pipeline._odometry.attitudes[-1] == pytest.approx(R(0.1, 0.0, 0.3), abs=1e-6)


def test_a_video_alone_needs_no_attitude_and_its_localizer_is_told_none():
    config = EkfConfig().without_telemetry()
    localizer = FakeLocalizer((3.0, 0.0))
    pipeline = make_pipeline(localizer, ekf_config=config)
    steps = [pipeline.step(Frame(0.1 * i, IMAGE, i)) for i in range(30)]
    assert pipeline.covers(99.0)
    assert localizer.priors[-1].roll_rad is None
    assert steps[-1].estimate.position_ned_m[0] == pytest.approx(3.0, abs=0.5)


@pytest.mark.parametrize("alone", [True, False])
def test_that_an_image_was_not_followed_is_told_of_a_video_alone(alone):
    """With telemetry the autopilot goes on telling how it turns."""
    config = EkfConfig().without_telemetry() if alone else EkfConfig()
    pipeline, told = make_pipeline(FakeLocalizer(), ekf_config=config), []
    pipeline._ekf.record(told.append)
    fly(pipeline, 1.0, attitude=None if alone else LEVEL)
    lost_s = [seen.t_s for seen in told if isinstance(seen, Untracked)]
    assert lost_s == ([pytest.approx(0.1 * i) for i in range(1, 11)] if alone else [])


def test_a_first_search_in_the_air_is_told_the_tilt():
    localizer = FakeLocalizer()
    fly(make_pipeline(localizer), 0.2, attitude=rotated())
    assert localizer.priors[0].roll_rad == pytest.approx(0.1)


def rotated():
    return quat_from_rotation(rotation_from_euler(0.1, 0.0, 2.0))


def test_a_fix_that_the_filter_refuses_counts_as_rejected():
    localizer = FakeLocalizer((0.0, 0.0))
    pipeline = make_pipeline(localizer, start=above_home(1.0))
    fly(pipeline, 3.0)
    accepted = pipeline.accepted
    localizer.north_east_m = (150.0, 0.0)
    steps = fly(pipeline, 1.0, t0_s=3.0)
    assert pipeline.accepted == accepted
    assert RejectReason.PRIOR in {
        s.outcome.reason for s in steps if isinstance(s.outcome, Rejected)
    }
    assert np.hypot(*steps[-1].estimate.position_ned_m[:2]) < 2.0


def test_an_image_too_low_for_the_map_is_no_attempt():
    pipeline = make_pipeline(FakeLocalizer(None, RejectReason.TOO_LOW), start=above_home())
    fly(pipeline, 2.0)
    assert pipeline.attempts == 0


def test_after_the_most_fixes_allowed_the_map_is_asked_no_more():
    localizer = FakeLocalizer((2.0, 1.0))
    pipeline = make_pipeline(localizer, start=above_home(), most_fixes=2)
    steps = fly(pipeline, 5.0)
    assert sum(isinstance(step.outcome, MapFix) for step in steps) == 2
    assert len(localizer.priors) == 2


def test_the_fallback_stands_in_and_the_primary_comes_back_by_itself():
    primary, fallback, said = FakeLocalizer(None), FakeLocalizer(), []
    pipeline = make_pipeline(primary, fallback, above_home(), said=said)
    fly(pipeline, 3.0)
    assert fallback.priors
    assert "SIFT stands in" in said[0]
    primary.north_east_m = (0.0, 0.0)
    fly(pipeline, 2.0, t0_s=3.0)
    seen = len(fallback.priors)
    fly(pipeline, 2.0, t0_s=5.0)
    assert len(fallback.priors) == seen
    assert said[-1] == "learned features work again"


def test_where_neither_finds_anything_nothing_is_said_of_it():
    """Low above the ground, in every climb."""
    primary, said = FakeLocalizer(None), []
    pipeline = make_pipeline(primary, FakeLocalizer(None), above_home(), said=said)
    fly(pipeline, 3.0)
    primary.north_east_m = (0.0, 0.0)
    fly(pipeline, 2.0, t0_s=3.0)
    assert said == []


def test_the_same_images_give_the_same_estimates():
    runs = [fly(make_pipeline(FakeLocalizer((2.0, 1.0)), start=above_home()), 3.0) for _ in "ab"]
    first, second = ([s.estimate.position_ned_m for s in run] for run in runs)
    assert np.array_equal(first, second)


def test_matching_in_a_thread_fuses_at_the_exposure():
    with ThreadPoolExecutor(1) as executor:
        pipeline = make_pipeline(FakeLocalizer((4.0, 0.0)), start=above_home(), executor=executor)
        fly(pipeline, 5.0)
    assert pipeline.estimate(5.0).position_ned_m[0] == pytest.approx(4.0, abs=1.0)


def test_a_model_that_fails_at_run_time_is_a_failed_attempt_and_sift_stands_in():
    primary, fallback, said = FakeLocalizer(error=RuntimeError("bad graph")), FakeLocalizer(), []
    pipeline = make_pipeline(primary, fallback, above_home(), said=said)
    steps = fly(pipeline, 6.0)
    assert isinstance(steps[0].outcome, Rejected)
    assert steps[0].outcome.reason is RejectReason.BROKEN
    assert pipeline.accepted > 5
    assert said == ["map matching failed (RuntimeError: bad graph): SIFT stands in"]
    primary.error = None
    fly(pipeline, 3.0, t0_s=6.0)
    assert said[-1] == "learned features work again"


def test_where_nothing_can_stand_in_a_failure_is_said_once_and_tried_again():
    localizer, said = FakeLocalizer(error=RuntimeError("bad graph")), []
    pipeline = make_pipeline(localizer, None, above_home(), said=said)
    fly(pipeline, 3.0)
    assert len(said) == 1
    localizer.error = None
    fly(pipeline, 2.0, t0_s=3.0)
    assert pipeline.accepted > 0


@dataclass
class SlowExecutor(Executor):
    """What a search finds comes `late_s` after its image, by the images' own time."""

    late_s: float
    now_s: float = 0.0

    def submit(self, fn, /, frame, *args):
        return SlowFuture(self, frame.t_s + self.late_s, fn(frame, *args))


class SlowFuture(Future):
    def __init__(self, executor, due_s, result):
        super().__init__()
        self._executor, self._due_s = executor, due_s
        self.set_running_or_notify_cancel()
        self.set_result(result)

    def done(self):
        return self._executor.now_s >= self._due_s


def drift(pipeline, executor, localizer, seconds, height_m=50.0):
    """Flies north at 3 m/s, which only the filter's fixes and odometry tell."""
    pipeline._odometry = MovingNorth()
    steps = []
    for i in range(round(seconds * 10)):
        t_s = 0.1 * (i + 1)
        executor.now_s = t_s
        localizer.north_east_m = (100.0 + SPEED_M_S * t_s, 50.0)
        pipeline.feed(Attitude(t_s, LEVEL))
        pipeline.feed(Height(t_s, height_m))
        steps.append(pipeline.step(Frame(t_s, IMAGE, i)))
    return steps


SPEED_M_S = 3.0


class MovingNorth:
    last_s: float | None = None
    readout_s = 0.0, 0.015

    def step(self, frame, R_ned_body, agl_m):
        before_s, self.last_s = self.last_s, frame.t_s
        if before_s is None:
            return Rejected(frame.t_s, RejectReason.FEW_KEYPOINTS)
        way = np.array([SPEED_M_S * (frame.t_s - before_s), 0.0, 0.0])
        cov = 0.05**2 * np.eye(3)
        return OdometryMotion(before_s, frame.t_s, way, cov, 0.0, 0.01, agl_m, 80)


@pytest.mark.parametrize("late_s", [0.3, 2.5, 6.0])
@pytest.mark.parametrize("known", [True, False])
def test_a_fix_is_used_however_long_its_search_took(late_s, known):
    localizer, executor = FakeLocalizer(), SlowExecutor(late_s)
    position = np.array([100.0, 50.0, -50.0]) if known else None
    start = Start(
        t_s=0.0, position_ned_m=position, sigma_m=20.0, agl_m=50.0, sigma_velocity_m_s=5.0
    )
    pipeline = make_pipeline(localizer, start=start, executor=executor)
    found = drift(pipeline, executor, localizer, 26.0, 50.0 if known else 0.0)[-1].estimate
    assert pipeline.accepted >= 3
    error_m = found.position_ned_m[:2] - (100.0 + SPEED_M_S * found.t_s, 50.0)
    assert np.hypot(*error_m) < min(2.0, 3.0 * found.sigma_horizontal_m)
    assert known or found.reset_counter >= 1


def test_without_any_start_a_first_fix_of_long_ago_begins():
    localizer, executor = FakeLocalizer(), SlowExecutor(6.0)
    pipeline = make_pipeline(localizer, executor=executor)
    found = drift(pipeline, executor, localizer, 32.0)[-1].estimate  # the first is confirmed
    error_m = found.position_ned_m[:2] - (100.0 + SPEED_M_S * found.t_s, 50.0)
    assert pipeline.accepted >= 3
    assert np.hypot(*error_m) < min(3.0, 3.0 * found.sigma_horizontal_m)


def test_a_hopeless_search_is_given_up():
    localizer, executor = FakeLocalizer(), SlowExecutor(1e6)
    pipeline = make_pipeline(localizer, start=above_home(), executor=executor)
    steps = drift(pipeline, executor, localizer, 45.0)
    outcomes = [step.outcome for step in steps]
    assert localizer.given_up == 2
    assert [o.reason for o in outcomes].count(RejectReason.GIVEN_UP) == 2


def test_a_search_for_the_very_place_may_take_longer():
    localizer, executor = FakeLocalizer(), SlowExecutor(35.0)
    start = Start(t_s=0.0, agl_m=50.0, sigma_velocity_m_s=5.0)
    pipeline = make_pipeline(localizer, start=start, executor=executor)
    outcomes = [step.outcome for step in drift(pipeline, executor, localizer, 50.0)]
    assert localizer.given_up == 0
    assert RejectReason.UNCONFIRMED in [o.reason for o in outcomes if isinstance(o, Rejected)]


def test_gray_and_colour_images_are_taken():
    assert to_gray(IMAGE).shape == to_gray(IMAGE[..., 0]).shape == (48, 64)


@pytest.mark.parametrize("focal_ratio", [0.8, 1.25, 1.0])
def test_a_lens_that_the_map_shows_to_be_another_is_taken_for_that(focal_ratio):
    """The height stays the barometer's meanwhile; a calibration that is right is left alone."""
    ratios = []

    def recalibrated(ratio):
        ratios.append(ratio)
        return Climbing(focal_ratio=focal_ratio / ratio)

    start = Start(t_s=0.0, position_ned_m=np.array([0.0, 0.0, -22.0]), sigma_m=5.0, agl_m=22.0)
    localizer = Climbing(focal_ratio=focal_ratio)
    said: list[str] = []
    pipeline = make_pipeline(localizer, start=start, recalibrated=recalibrated, said=said)
    for i in range(1, 120):
        t_s = 0.1 * i
        pipeline.feed(Attitude(t_s, LEVEL))
        pipeline.feed(Height(t_s, 22.0 + 2.0 * t_s))
        estimate = pipeline.step(Frame(t_s, IMAGE, i)).estimate
        assert estimate.agl_m == pytest.approx(22.0 + 2.0 * t_s, abs=1.5)
    assert ratios == ([] if focal_ratio == 1.0 else [pytest.approx(focal_ratio, rel=0.03)])
    assert not said  # as that SIFT stood in, where the fix was another camera's
    assert pipeline.accepted > 30


@dataclass
class OverSlabs(Climbing):
    """One look of six passes: at a place like this one, and smaller."""

    def localize(self, frame: Frame, prior: Prior, seed: int) -> MapFix | Rejected:
        found = super().localize(frame, prior, seed)
        if len(self.priors) % 6:
            return Rejected(frame.t_s, RejectReason.FEW_INLIERS, features="learned")
        return found


@pytest.mark.parametrize(("sigma_m", "lens_open"), [(5.0, True), (12.0, False)])
def test_a_lone_place_of_another_height_is_no_fix(sigma_m, lens_open):
    """A place 11 m beside home was, 9.5 sigmas off, in flights with nothing broken.

    And one where pictures had frozen at another height, 62 sigmas, with a lens that was known.
    """
    start = Start(t_s=0.0, position_ned_m=np.array([0.0, 0.0, -22.0]), sigma_m=sigma_m, agl_m=22.0)
    slabs = OverSlabs(north_east_m=(0.0, 11.0), focal_ratio=1.18)
    anew = (lambda _: slabs) if lens_open else None
    pipeline = make_pipeline(slabs, start=start, recalibrated=anew)
    outcomes = []
    for i in range(1, 120):
        t_s = 0.1 * i
        pipeline.feed(Attitude(t_s, LEVEL))
        pipeline.feed(Height(t_s, 22.0 + 2.0 * t_s))
        outcomes.append(pipeline.step(Frame(t_s, IMAGE, i)).outcome)
    assert pipeline.accepted == 0
    reasons = [outcome.reason for outcome in outcomes if isinstance(outcome, Rejected)]
    assert reasons.count(RejectReason.UNCONFIRMED) > 3


@pytest.mark.parametrize(("degrees", "worth"), [(0.0, False), (3.0, False), (20.0, True)])
def test_a_mount_that_images_show_to_be_turned_is_taken_for_that(degrees, worth):
    """And once only: what is left of it is another camera's error, and small."""
    start = Start(t_s=0.0, position_ned_m=np.array([0.0, 0.0, -22.0]), sigma_m=5.0, agl_m=22.0)
    odometry, asked = Tilting(turn_rad=np.radians(degrees)), []

    def recalibrated(ratio):
        asked.append(ratio)
        return FakeLocalizer()

    pipeline = make_pipeline(
        FakeLocalizer(), start=start, odometry=odometry, recalibrated=recalibrated
    )
    for i in range(1, 300):
        pipeline.feed(Attitude(0.1 * i, LEVEL))
        pipeline.feed(Height(0.1 * i, 22.0))
        pipeline.step(Frame(0.1 * i, IMAGE, i))
    assert bool(asked) is worth
    assert np.degrees(odometry.known_rad) == pytest.approx(degrees if worth else 0.0, abs=6.0)


@pytest.mark.parametrize("mirrors", [True, False])
def test_images_that_are_mirrored_are_turned_back_as_soon_as_their_tilting_shows_it(mirrors):
    start = Start(t_s=0.0, position_ned_m=np.array([0.0, 0.0, -22.0]), sigma_m=5.0, agl_m=22.0)
    odometry, asked = Tilting(mirrors=mirrors), []

    def recalibrated(ratio):
        asked.append(ratio)
        return FakeLocalizer([])

    pipeline = make_pipeline(
        FakeLocalizer([]), start=start, odometry=odometry, recalibrated=recalibrated
    )
    seen = np.full((48, 64), RIGHT, np.uint8)
    seen[:, :32] = LEFT
    for i in range(1, 100):
        pipeline.feed(Attitude(0.1 * i, LEVEL))
        pipeline.feed(Height(0.1 * i, 22.0))
        pipeline.step(Frame(0.1 * i, seen[:, ::-1] if mirrors else seen, i))
    assert odometry.left[-1] == LEFT
    assert bool(asked) is mirrors
    assert abs(wrap_pi(odometry.known_rad)) < 0.1


@dataclass
class LostOnce(Tilting):
    """Follows no first image after 3 s; what it shows then is mirrored, as patches of smoke."""

    def step(self, frame, R_ned_body, agl_m):
        lost, self.mirrors = not self.mirrors and frame.t_s > 3.05, frame.t_s > 3.05
        seen = super().step(frame, R_ned_body, agl_m)
        return Rejected(frame.t_s, RejectReason.FEW_MATCHES) if lost else seen


@pytest.mark.parametrize(("map_shows", "gone_s"), [(True, 1.5), (False, 1.5), (False, 0.0)])
def test_images_are_mirrored_where_the_camera_was_gone_and_no_map_bears_them_as_they_are(
    map_shows, gone_s
):
    """Smoke below was taken for that among right fixes, and images half a second late."""
    odometry, asked, localizer = LostOnce(), [], FakeLocalizer()

    def recalibrated(ratio):
        asked.append(ratio)
        return localizer

    pipeline = make_pipeline(
        localizer, start=above_home(), odometry=odometry, recalibrated=recalibrated
    )
    fly(pipeline, 3.0)
    assert pipeline.accepted > 3
    localizer.north_east_m = (0.0, 0.0) if map_shows else None
    fly(pipeline, 6.0, t0_s=3.0 + gone_s)
    assert bool(asked) is (gone_s > 0.0 and not map_shows)


UPRIGHT = tuple(np.eye(3).ravel().tolist())


@pytest.mark.parametrize(
    ("camera", "taken"),
    [
        (FoundCamera(0.8, 1.0, UPRIGHT, 0.02), True),
        (None, False),
        (FoundCamera(0.0, 1.0, UPRIGHT), False),
        (FoundCamera(math.nan, 1.0, UPRIGHT), False),
        (FoundCamera(0.8, 1.0, (1e300,) * 9), False),
        (FoundCamera(0.8, 1.0, UPRIGHT, 3600.0), False),
    ],
)
def test_one_that_goes_on_for_another_takes_the_camera_that_it_found_out_where_it_can_be(
    camera, taken
):
    place = np.array([0.0, 0.0, -50.0])
    start = Start(t_s=0.0, position_ned_m=place, agl_m=50.0, learned=Learned(0.0, (), (), camera))
    ratios, odometry = [], Tilting()

    def recalibrated(ratio):
        ratios.append(ratio)
        return FakeLocalizer([])

    pipeline = make_pipeline(FakeLocalizer([]), odometry=odometry, recalibrated=recalibrated)
    pipeline.begin(start)
    seen = np.full((48, 64), RIGHT, np.uint8)
    seen[:, 32:] = LEFT
    pipeline.feed(Attitude(0.1, LEVEL))
    step = pipeline.step(Frame(0.1, seen, 1))
    assert step.estimate is not None
    assert step.t_s == (0.1 + 0.02 if taken else 0.1)
    assert ratios == ([0.8] if taken else [])
    assert odometry.left == [LEFT if taken else RIGHT]
    left = pipeline.learned()
    assert (None if left is None else left.camera) == (camera if taken else None)


@pytest.mark.parametrize("telemetry", [True, False])
@pytest.mark.parametrize(("gone_s", "opens"), [(0.9, False), (1.2, True)])
def test_the_lens_of_a_camera_that_was_gone_is_asked_for_again_where_telemetry_can_tell(
    gone_s, opens, telemetry
):
    start = Start(t_s=0.0, position_ned_m=np.array([0.0, 0.0, -50.0]), sigma_m=5.0, agl_m=50.0)
    made = (lambda ratio: FakeLocalizer()) if telemetry else None
    pipeline = make_pipeline(FakeLocalizer(), start=start, recalibrated=made)
    fly(pipeline, 2.0)
    assert pipeline.accepted > 0
    before = focal_sigma(pipeline)
    fly(pipeline, 0.1, t0_s=2.0 + gone_s - 0.1)
    after = focal_sigma(pipeline)
    assert (after > 5.0 * before) is (opens and telemetry)


def focal_sigma(pipeline: Pipeline) -> float:
    state = pipeline._ekf.state
    assert state is not None
    return float(np.sqrt(state.P[States.FOCAL, States.FOCAL]))


def test_an_image_waits_for_the_turn_of_the_link_and_not_for_good():
    pipeline = make_pipeline(FakeLocalizer([]))
    pipeline.link_rests.clear()
    done = threading.Event()

    def step() -> None:
        pipeline.step(Frame(1.0, IMAGE, 0))
        done.set()

    thread = threading.Thread(target=step)
    begun_s = time.monotonic()
    thread.start()
    assert not done.wait(0.05)
    pipeline.link_rests.set()
    assert done.wait(5.0)
    pipeline.link_rests.clear()
    pipeline.step(Frame(1.1, IMAGE, 1))  # a link that hangs keeps no image
    thread.join()
    assert time.monotonic() - begun_s < 5.0
