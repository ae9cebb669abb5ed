"""Whole flights that see nothing: what a filter would believe is told, all else is as it flies.

Six sevenths of the cost of a flight in lockstep are images and the filter. What is looked for here
lies between mission, watchdog, its spare one and the autopilot: so days are flown by the hundred.
"""

from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vwnav.bench.flights.fly import fly
from vwnav.bench.flights.navigator import Equipped
from vwnav.bench.flights.noted_link import LockstepWatcher
from vwnav.bench.flights.scenario import Flown, Scenario
from vwnav.bench.flights.world import Place, World
from vwnav.estimation.beginning.starts import Start
from vwnav.geometry.geodesy import LocalFrame
from vwnav.recording.input_log import About
from vwnav.safety.camera_watch import CameraWatch
from vwnav.seams import StepResult
from vwnav.sim.lockstep_camera import LockstepCamera
from vwnav.sim.processor import LateExecutor
from vwnav.types import (
    Array,
    Attitude,
    Estimate,
    Frame,
    MapFix,
    OdometryMotion,
    Rejected,
    RejectReason,
    Telemetry,
)
from vwnav.vehicle import Learned

_FIX_EVERY_S = 0.4
_MAP_SHOWS_M = 12.0  # less from below
_SEES_M = 0.3  # below, an image shows nothing that moves
_BLIND_AFTER_S, _DEAF_AFTER_S = 0.5, 0.2
_DRIFT_M_S = 0.4  # of what flies blind; of what is deaf too, half of what an aircraft can do
_ACCELERATES_M_S2 = 2.0
_UNKNOWN_M, _SIGMA_M = 300.0, 0.3
_FIXES_TO_BEGIN = 2


class ToldPipeline:
    """A `vwnav.pipeline.Pipeline`, and the filter in it: knows the truth while images come.

    Without images it drifts, without telemetry it goes on as it went, and it says how unsure it is.

    Args:
        clock: tells the time.
        truth: position and velocity (3,) in NED about the run's origin, and quat_wxyz (4,), now.
    """

    def __init__(
        self,
        clock: Callable[[], float],
        truth: Callable[[], tuple[Array, Array, Array]],
        local_frame: LocalFrame,
        seed: int,
    ) -> None:
        self._clock, self._truth, self.local_frame = clock, truth, local_frame
        self._rng = np.random.default_rng(seed)
        self._begun = self._known = False
        self._told_s = self._heard_s = self._image_s = -np.inf
        self._heard: tuple[Array, Array, Array] | None = None
        self._drift_m_s = np.zeros(2)
        self._off_m, self._sigma_m = np.zeros(2), _UNKNOWN_M
        self._fix_s: float | None = None
        self._before: Frame | None = None
        self._sought, self._counter = 0, 0
        self.attempts = self.accepted = 0

    # ---- as the pipeline

    def begin(self, start: Start) -> None:
        """Begin there."""
        self._begun, self._known = True, start.position_ned_m is not None
        self._image_s = self._told_s = start.t_s
        if start.position_ned_m is not None:
            self._off_m = start.position_ned_m[:2] - self._truth()[0][:2]
            self._sigma_m = start.sigma_m

    def feed(self, measurement: Telemetry) -> None:
        """Telemetry is heard: by it the motion is known."""
        if isinstance(measurement, Attitude) and measurement.t_s >= self._told_s:
            self._told_s = measurement.t_s
            self._heard_s, self._heard = self._clock(), self._truth()

    def covers(self, t_s: float) -> bool:
        """Whether telemetry has reached an exposure."""
        return self._told_s >= t_s

    def learned(self) -> Learned | None:
        """Nothing."""

    def give_up(self) -> None:
        """Nothing is under way."""

    def step(self, frame: Frame) -> StepResult:
        """An image: motion, and every now and then a fix."""
        height_m = -float(self._truth()[0][2])
        before, self._before = self._before, frame
        motion: OdometryMotion | Rejected = Rejected(frame.t_s, RejectReason.FEW_MATCHES)
        outcome: MapFix | Rejected = Rejected(frame.t_s, RejectReason.NOT_TRIED)
        if before is not None and height_m > _SEES_M and self.covers(frame.t_s):
            motion = OdometryMotion(
                before.t_s, frame.t_s, np.zeros(3), np.eye(3), 0.0, 0.01, height_m, 100
            )
            if self._known:
                self._see(frame.t_s)
            due = self._fix_s is None or frame.t_s - self._fix_s >= _FIX_EVERY_S
            if due and height_m > _MAP_SHOWS_M:
                outcome = self._fix(frame.t_s)
        return StepResult(frame.t_s, motion, outcome, self.estimate(frame.t_s))

    def estimate(self, t_s: float) -> Estimate | None:
        """What is believed."""
        if not self._begun or self._heard is None:
            return None
        position, velocity, quat_wxyz = self._heard
        blind_s = max(t_s - max(self._image_s, 0.0) - _BLIND_AFTER_S, 0.0)
        deaf_s = max(t_s - self._heard_s, 0.0)
        off_m_s = self._drift_m_s if blind_s > 0.0 else np.zeros(2)
        here, how = position + velocity * deaf_s, velocity.copy()
        here[:2] += self._off_m + off_m_s * blind_s
        how[:2] += off_m_s
        late_s = max(deaf_s - _DEAF_AFTER_S, 0.0)
        sigma_m_s = 0.15 + 0.1 * blind_s + _ACCELERATES_M_S2 * late_s
        sigma_m = self._sigma_m + 1.5 * _DRIFT_M_S * blind_s
        sigma_m += _ACCELERATES_M_S2 * late_s * (1.0 + late_s)
        variances = np.array([sigma_m, sigma_m, 0.5, sigma_m_s, sigma_m_s, 0.2]) ** 2
        return Estimate(
            t_s=t_s, position_ned_m=here, velocity_ned_m_s=how, covariance=np.diag(variances),
            quat_wxyz=quat_wxyz, sigma_yaw_rad=0.03, agl_m=max(-float(here[2]), 0.0),
            sigma_agl_m=0.3, t_last_fix_s=self._fix_s, reset_counter=self._counter,
        )  # fmt: skip

    def _see(self, t_s: float) -> None:
        """Motion is seen again: what was drifted until now stays."""
        blind_s = max(t_s - self._image_s - _BLIND_AFTER_S, 0.0)
        self._off_m = self._off_m + self._drift_m_s * blind_s
        self._sigma_m += 1.5 * _DRIFT_M_S * blind_s
        self._image_s = t_s
        self._drift_m_s = self._rng.normal(0.0, _DRIFT_M_S, 2)

    def _fix(self, t_s: float) -> MapFix | Rejected:
        self.attempts += 1
        self._fix_s = t_s
        self._sought += not self._known
        if not self._known and self._sought < _FIXES_TO_BEGIN:
            return Rejected(t_s, RejectReason.UNCONFIRMED)
        self.accepted += 1
        off_m = self._rng.normal(0.0, 0.2, 2)
        self._counter += not self._known or float(np.hypot(*(off_m - self._off_m))) > 1.0
        self._begun = self._known = True
        self._off_m, self._sigma_m, self._image_s = off_m, _SIGMA_M, t_s
        place = self._truth()[0]
        lat_deg, lon_deg, _ = self.local_frame.to_geodetic(place)
        return MapFix(
            t_s, float(lat_deg), float(lon_deg), 0.25 * np.eye(2), None, None, None, None,
            "nadir", "learned",
        )  # fmt: skip


class _Noise:
    """Draws images that show nothing, no two of them alike."""

    def __init__(self, place: Place) -> None:
        shape = (place.camera.height_px, place.camera.width_px)
        self._image = np.random.default_rng(1).integers(60, 200, shape, dtype=np.uint8)
        self._row = 0

    def render(self, *_: object) -> NDArray[np.uint8]:
        """The image of a moment."""
        self._row += 1
        return np.roll(self._image, self._row, axis=0)


class ToldWorld(World):
    """A flight in lockstep whose navigators are told what they would see."""

    def _camera(self, place: Place) -> LockstepCamera:
        return LockstepCamera(_Noise(place), self._stands_ned_m, 1.0 / self.setup.image_hz, 0.04)

    def _equipped(self, place: Place) -> Equipped:
        camera, config = place.camera, self.setup.config
        told: Any = ToldPipeline(self.clock, self._truth_now, self.local_frame, self.setup.seed)
        executor = LateExecutor(self.clock, self.processor, lambda: self.costs.match)
        watch = CameraWatch(camera.width_px, camera.height_px)
        record = LockstepWatcher(self.note, self.clock)
        about = About("learned", "", "nadir", self.local_frame, None)
        return Equipped(self.setup.mission, self.local_frame, config, watch, told, told, executor,
                        record, deque(), about)  # fmt: skip

    def _truth_now(self) -> tuple[Array, Array, Array]:
        body = self.core.vehicle.body
        return (
            self._stands_ned_m + np.array([body.n, body.e, body.d]),
            np.array([body.vn, body.ve, body.vd]),
            np.array([body.qw, body.qx, body.qy, body.qz]),
        )


def fly_told(scenario: Scenario, place: Place) -> Flown:
    """Fly it to its end, without eyes."""
    return fly(scenario, place, make=ToldWorld)
