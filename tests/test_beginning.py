"""Images that are each too weak for a fix, joined by the pipeline along their way."""

from dataclasses import dataclass, field

import numpy as np

from vwnav.estimation.beginning.starts import Start
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.ekf import Ekf
from vwnav.geometry.geodesy import LocalFrame
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
    WeakFix,
)

HOME = LocalFrame(60.4, 22.5, 0.0)
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
IMAGE = np.zeros((48, 64), np.uint8)
HEIGHT_M, NORTH_M_S, RATE_HZ = 50.0, 20.0, 5.0


@dataclass
class WeakLocalizer:
    """Finds every image where it was taken, `off_m` beside it, but too weakly for a fix."""

    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))
    off_m: float = 0.0
    scattered_m: float = 0.5
    priors: list[Prior] = field(default_factory=list)

    def give_up(self):
        raise AssertionError("no search takes long here")

    def localize(self, frame: Frame, prior: Prior, seed: int) -> MapFix | Rejected:
        self.priors.append(prior)
        north_m, east_m = self.rng.normal(0.0, self.scattered_m, 2)
        ned_m = np.array([NORTH_M_S * frame.t_s + north_m, self.off_m + east_m, -HEIGHT_M])
        lat_deg, lon_deg, _ = HOME.to_geodetic(ned_m)
        fix = MapFix(
            t_s=frame.t_s,
            lat_deg=float(lat_deg),
            lon_deg=float(lon_deg),
            covariance_ne_m2=0.5**2 * np.eye(2),
            yaw_rad=float(self.rng.normal(0.0, 0.01)),
            sigma_yaw_rad=0.01,
            agl_m=HEIGHT_M,
            sigma_agl_m=0.5,
            point="nadir",
            features="learned",
        )
        weak = WeakFix(fix, decades=2.0, needed=6.0, seen_m=50.0)
        return Rejected(frame.t_s, RejectReason.FEW_INLIERS, weak=(weak,))


class NorthwardOdometry:
    """Each image is the keyframe of the next."""

    readout_s = 0.0, 0.015

    def __init__(self) -> None:
        self._before_s: float | None = None

    def counted_attitude(self, t_s):
        return Attitude(t_s, LEVEL)

    def step(self, frame, R_ned_body, agl_m):
        before_s, self._before_s = self._before_s, frame.t_s
        if before_s is None or R_ned_body is None:
            return Rejected(frame.t_s, RejectReason.NOT_TRIED)
        way_m = NORTH_M_S * (frame.t_s - before_s) * agl_m / HEIGHT_M
        return OdometryMotion(
            t0_s=before_s,
            t1_s=frame.t_s,
            displacement_ned_m=np.array([way_m, 0.0, 0.0]),
            covariance_ned_m2=0.05**2 * np.eye(3),
            yaw_increment_rad=0.0,
            sigma_yaw_rad=0.003,
            agl_m=agl_m,
            tracks=90,
        )


class NoOdometry(NorthwardOdometry):
    def step(self, frame, R_ned_body, agl_m):
        return Rejected(frame.t_s, RejectReason.FEW_MATCHES)


def flown(localizer, odometry, start=None, seconds=20.0):
    """The pipeline and its steps, flying north at 20 m/s, 50 m up."""
    config = PipelineConfig()
    choice = FeatureChoice(localizer, None, config, lambda _: None)
    ekf = Ekf(EkfConfig())
    if start is not None:
        ekf.initialise(start)
    pipeline = Pipeline(choice, odometry, ekf, HOME, 0.02, config, InlineExecutor())
    steps = []
    for number in range(1, round(seconds * RATE_HZ) + 1):
        t_s = number / RATE_HZ
        for early_s in (0.1, 0.0):
            pipeline.feed(Attitude(t_s - early_s, LEVEL))
            pipeline.feed(Height(t_s - early_s, HEIGHT_M))
        steps.append(pipeline.step(Frame(t_s, IMAGE, number)))
    return steps


def fixes(steps) -> list[MapFix]:
    return [step.outcome for step in steps if isinstance(step.outcome, MapFix)]


def test_weak_images_together_begin_a_flight_that_none_of_them_could():
    steps = flown(WeakLocalizer(), NorthwardOdometry())
    reasons = [step.outcome.reason for step in steps if isinstance(step.outcome, Rejected)]
    assert RejectReason.UNCONFIRMED in reasons  # found once, as any other first fix
    assert {fix.placed_by for fix in fixes(steps)} == {"sequence"}
    off_m = steps[-1].estimate.position_ned_m[:2] - [NORTH_M_S * steps[-1].t_s, 0.0]
    assert np.hypot(*off_m) < 4.0


def test_without_odometry_weak_images_stay_what_they_are():
    assert not fixes(flown(WeakLocalizer(), NoOdometry()))


def test_places_that_scatter_are_never_joined():
    assert not fixes(flown(WeakLocalizer(scattered_m=200.0), NorthwardOdometry()))


def test_after_an_outage_weak_images_bring_the_place_back():
    start = Start(
        t_s=0.0,
        position_ned_m=np.array([0.0, 0.0, -HEIGHT_M]),
        sigma_m=60.0,
        agl_m=HEIGHT_M,
        sigma_velocity_m_s=15.0,
    )
    steps = flown(WeakLocalizer(off_m=70.0), NorthwardOdometry(), start)
    found = next(step for step in steps if isinstance(step.outcome, MapFix))
    off_m = found.estimate.position_ned_m[:2] - [NORTH_M_S * found.t_s, 70.0]
    assert np.hypot(*off_m) < 3.0


def test_while_the_place_is_known_weak_images_do_not_move_it():
    start = Start(t_s=0.0, position_ned_m=np.array([0.0, 0.0, -HEIGHT_M]), sigma_m=1.0, agl_m=50.0)
    steps = flown(WeakLocalizer(off_m=5.0), NorthwardOdometry(), start, seconds=6.0)
    assert not fixes(steps)


def test_what_is_recorded_of_an_image_holds_no_weak_places():
    steps = flown(WeakLocalizer(), NoOdometry(), seconds=3.0)
    assert not any(step.outcome.weak for step in steps)
