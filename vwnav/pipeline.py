"""The one path, read this first.

    frame -> undistort -> rectify -> features -> match -> homography -> fix -> EKF -> guidance

`Pipeline.feed` takes the autopilot's measurements as they come, `Pipeline.step` an image to an
`Estimate`; `fly`, `replay` and the tests all run them. Guidance and safety (`vwnav.flight`) turn
estimates into setpoints.
"""

import math
import threading
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from vwnav.estimation.beginning.first_fix import UNKNOWN_AGL_M, FirstFix, start_at
from vwnav.estimation.beginning.lens import LensCheck
from vwnav.estimation.beginning.mount import LEAST_TILT_RAD, tilted
from vwnav.estimation.beginning.other_camera import found_by, found_in, seen_by
from vwnav.estimation.beginning.sequences import Sequences
from vwnav.estimation.beginning.starts import Start, left_by
from vwnav.estimation.disputes import is_told
from vwnav.estimation.events import CameraReturned, Exposed, NedFix, Recalibrated, Untracked
from vwnav.estimation.filtering import Filtering
from vwnav.estimation.inertial.attitudes import yaw_of
from vwnav.estimation.inertial.dates import LEAST_OFFSET_S, misdated
from vwnav.estimation.odometry_gate import CAMERA_GONE_S, MountCheck
from vwnav.estimation.states import States, Verdict
from vwnav.geometry.camera import to_gray
from vwnav.geometry.geodesy import LocalFrame
from vwnav.geometry.rotations import euler_from_rotation, rotation_from_quat
from vwnav.seams import Attempt, FeatureChoice, Localizing, PipelineConfig, StepResult, Tracking
from vwnav.types import (
    Array,
    Attitude,
    Estimate,
    Frame,
    MapFix,
    OdometryMotion,
    Prior,
    Rejected,
    RejectReason,
    Telemetry,
)
from vwnav.vehicle import FoundCamera, Learned

MAX_YAW_SIGMA_RAD = 0.5  # a heading less certain than this is none
MIN_PRIOR_SIGMA_M, TOLD_DOUBT = 3.0, 4.0  # so many times as far around a person's word
MAX_DOUBT, MAX_DOUBTED_AGL_RATIO = 8.0, 0.3
LOST_SIGMA_M = 20.0  # of a place: beyond it images are joined
_GIVES_WAY_S = 0.1  # at most, each time
_NO_MOTION = {Verdict.IMPOSSIBLE: RejectReason.GEOMETRY, Verdict.DISTRUSTED: RejectReason.PRIOR}
MIN_AGL_M = 2.0  # standing on the ground there is nothing to be matched ...
UNSURE_AGL_M = 5.0  # ... unless the height is less sure than any landing leaves it


class Pipeline:
    """From images and measurements to the estimate of position, velocity and heading.

    `feed` and `estimate` may be called from other threads at any time; `step` from one only.
    Python runs one thread at a time: a step waits where the link takes its turn (`link_rests` is
    clear then). Without that estimates were late by half a second on a slow board.
    """

    def __init__(
        self,
        features: FeatureChoice,
        odometry: Tracking,
        ekf: Filtering,
        local_frame: LocalFrame,
        sigma_tilt_rad: float,
        config: PipelineConfig,
        executor: Executor,
        recalibrated: Callable[[FoundCamera], tuple[FeatureChoice, Tracking]] | None = None,
    ) -> None:
        """Put the parts together.

        Args:
            features: chooses the localizer of each attempt.
            odometry: measures motion between images.
            ekf: the filter; `initialise` it first where the start is known.
            local_frame: the run's NED origin.
            sigma_tilt_rad: attitude error that the localizer puts into a fix's covariance.
            config: rates and limits.
            executor: runs the matching: in a thread on board, inline in replay.
            recalibrated: makes both anew for another camera; None where no telemetry tells of it.
        """
        self.local_frame, self._sigma_tilt_rad = local_frame, sigma_tilt_rad
        self._features, self._odometry, self._ekf = features, odometry, ekf
        self._config, self._executor = config, executor
        self._lock, self.link_rests = threading.Lock(), threading.Event()
        self.link_rests.set()
        self._pending: Attempt | None = None
        self._next_attempt_s, self._misses = -np.inf, 0  # attempts since the last fix
        self._recalibrated, is_open = recalibrated, recalibrated is not None
        self._lens, self._mount = LensCheck(is_open), MountCheck(is_open, ekf.attitudes)
        self._camera: FoundCamera | None = None  # where it is not as it was told
        self._first_fix, self._sequences, self._lost = FirstFix(), Sequences(local_frame), True
        self._image_s, self._borne_s = math.inf, -math.inf  # a fix was believed, its heading too
        self.attempts = self.accepted = 0

    def estimate(self, t_s: float) -> Estimate | None:
        """The estimate predicted to `t_s`; None while there is nothing to predict from."""
        with self._lock:
            return self._ekf.estimate(t_s)

    def learned(self) -> Learned | None:
        """What another one may begin with, were this one to end."""
        with self._lock:
            return left_by(self._ekf.state, self._camera)

    def begin(self, start: Start) -> None:
        """Begin there, in another one's place perhaps, with the camera that it has found out."""
        with self._lock:
            self._ekf.initialise(start)
        if self._recalibrated and (camera := found_in(start.learned)):
            self._camera, self._lens.focal_ratio = camera, camera.focal_ratio
            self._features, self._odometry = self._recalibrated(camera)

    def feed(self, measurement: Telemetry | Untracked) -> None:
        """Take a measurement; the estimate lives on them when images stall."""
        with self._lock:
            self._ekf.handle(measurement)

    def give_up(self) -> None:
        """End a search that is under way: nobody waits for its outcome any more."""
        if (attempt := self._pending) is not None:
            attempt.localizer.give_up()

    def covers(self, t_s: float) -> bool:
        """Whether telemetry has reached an exposure: waiting tells no more of the attitude there.

        An image handed to `step` before has a guess, or none; wait `ATTITUDE_WAIT_S` at most.
        """
        with self._lock:
            return self._ekf.covers(t_s)

    def step(self, frame: Frame) -> StepResult:
        """Take one image through the whole path.

        An image whose attitude is not known moves nothing: 10 degrees are 9 m at 50 m, all images
        of a gap to the same side, which no covariance of a fix can say.
        """
        image = frame if frame.image.ndim == 2 else replace(frame, image=to_gray(frame.image))
        if self._camera is not None:
            frame = image = seen_by(self._camera, image)
        gone_s, self._image_s = frame.t_s - self._image_s, frame.t_s
        if gone_s > CAMERA_GONE_S and self.accepted > 0 and self._recalibrated is not None:
            self._lens.ask_again()
            with self._lock:
                self._ekf.handle(CameraReturned(frame.t_s))
        self.link_rests.wait(_GIVES_WAY_S)
        with self._lock:
            attitude = None if self._ekf.counts_heading else self._ekf.attitudes.at(frame.t_s)
            now = self._ekf.estimate(frame.t_s)
            if attitude is not None and now is not None:
                rates_rad_s = self._ekf.attitudes.rates_rad_s(frame.t_s)
                velocity_m_s = rotation_from_quat(now.quat_wxyz).T @ now.velocity_ned_m_s
                image = replace(image, rates_rad_s=rates_rad_s, velocity_body_m_s=velocity_m_s)
        R_ned_body = None if attitude is None else rotation_from_quat(attitude.quat_wxyz)
        motion = self._track(image, attitude, R_ned_body, now)
        outcome = self._collect(frame.t_s) or Rejected(frame.t_s, RejectReason.NOT_TRIED)
        if not (isinstance(motion, Rejected) and motion.reason is RejectReason.NO_FRAME):
            outcome = self._attempt_if_due(image, R_ned_body) or outcome
        return StepResult(frame.t_s, motion, outcome, self.estimate(frame.t_s))

    def _track(
        self, frame: Frame, held: Attitude | None, R_ned_body: Array | None, now: Estimate | None
    ) -> OdometryMotion | Rejected:
        """Motion since the keyframe. In a video alone the images' own turning is the gyro."""
        motion = self._odometry.step(frame, R_ned_body, now.agl_m if now else UNKNOWN_AGL_M)
        if self._lost:
            self._sequences.follow(motion, held or self._odometry.counted_attitude(frame.t_s))
        if now is None and isinstance(motion, OdometryMotion):
            motion = Rejected(frame.t_s, RejectReason.NOT_TRIED, "height above ground unknown")
        self.link_rests.wait(_GIVES_WAY_S)
        with self._lock:
            if self._ekf.counts_heading:
                self._ekf.handle(self._odometry.counted_attitude(frame.t_s))
                if isinstance(motion, Rejected):
                    self._ekf.handle(Untracked(frame.t_s))
                    self._first_fix.broke()
            if isinstance(motion, Rejected):
                self._mount.broke(frame.t_s)
                return motion
            innovation = self._ekf.handle(motion)
        turned = self._mount.turned(motion, innovation, self.accepted > 0, self._borne_s)
        if turned is not None:
            self._lens.mount_turned()
            self._recalibrate(turned)
            return Rejected(frame.t_s, RejectReason.NOT_TRIED, "seen by another camera")
        reason = _NO_MOTION.get(verdict := innovation.verdict)
        if reason is None or self._ekf.counts_heading:  # which does not know its height at first
            return motion
        self._lens.doubted(frame.t_s)
        if verdict is Verdict.IMPOSSIBLE:
            self._odometry.mistook()
        return Rejected(frame.t_s, reason, verdict.value)

    def _attempt_if_due(self, frame: Frame, R_ned_body: Array | None) -> MapFix | Rejected | None:
        """Start matching this image when it is time to; the outcome if it is there at once."""
        if self._pending is not None or frame.t_s < self._next_attempt_s:
            return None
        unseen = R_ned_body is None and not self._ekf.counts_heading
        if unseen or 0 < self._config.most_fixes <= self.accepted:
            return None
        now = self.estimate(frame.t_s)
        if now is not None and now.agl_m < MIN_AGL_M and now.sigma_agl_m < UNSURE_AGL_M:
            return None
        state = self._ekf.state
        off_s = 0.0 if state is None else abs(state.x[States.TIME_OFFSET])
        if state is not None and self._lens.is_open and self._lens.told_by_ways(state):
            self._recalibrate(Recalibrated(state.t_s))
        elif state is not None and np.hypot(*state.x[States.CAMERA_TILT]) > LEAST_TILT_RAD:
            self._recalibrate(tilted(state))
        elif state and off_s > LEAST_OFFSET_S and (event := misdated(state, frame.t_s)):
            self._mount.redated()
            self._recalibrate(event)
            return None
        prior = self._prior(now, R_ned_body)
        begins = state is None or not state.position_known or self._first_fix.doubted
        if begins:
            prior = self._first_fix.prior(prior, frame.t_s, now)
        searching = prior.lat_deg is None
        widely = searching or prior.sigma_m > MIN_PRIOR_SIGMA_M
        interval = self._config.search_interval_s if searching else self._config.fix_interval_s
        self._next_attempt_s = frame.t_s + interval
        with self._lock:
            self._ekf.handle(Exposed(frame.t_s))
        localizer = self._features.next()
        future = self._executor.submit(localizer.localize, frame, prior, frame.index)
        self._lost = begins or self._first_fix.young or searching or prior.sigma_m > LOST_SIGMA_M
        self._pending = Attempt(frame.t_s, localizer, future, begins, now, widely)
        return self._collect(frame.t_s)

    def _collect(self, t_s: float) -> MapFix | Rejected | None:
        """Fuse the attempt that is under way, if it has ended. One that raised has failed."""
        if (attempt := self._pending) is None:
            return None
        if not attempt.future.done():
            overdue = attempt.is_overdue(t_s, self._config.give_up_after_s)
            return self._give_up(attempt, t_s) if overdue else None
        self._pending = None
        self.link_rests.wait(_GIVES_WAY_S)
        try:
            outcome: MapFix | Rejected = attempt.future.result()
        except Exception as error:
            self._features.broke(attempt.localizer, error)
            outcome = Rejected(attempt.t_s, RejectReason.BROKEN, str(error))
        if isinstance(outcome, Rejected) and outcome.reason is RejectReason.TOO_LOW:
            return outcome  # nothing was tried: the map shows nothing that small
        if isinstance(outcome, Rejected) and outcome.weak:
            outcome = self._sequences.join(outcome)
        if isinstance(outcome, MapFix):
            outcome = self._fuse_fix(outcome, attempt)
        if isinstance(outcome, Rejected) and outcome.reason is RejectReason.UNCONFIRMED:
            self.attempts += 1  # found, which is no failure, and not believed yet
            self._next_attempt_s = attempt.t_s + self._config.fix_interval_s
            return outcome
        self._count(attempt.localizer, isinstance(outcome, MapFix))
        return outcome

    def _give_up(self, attempt: Attempt, t_s: float) -> Rejected:
        """Leave an attempt that has taken too long: what it searches for it will not find."""
        self._pending = None
        if not attempt.future.cancel():
            attempt.localizer.give_up()
        self._count(attempt.localizer, succeeded=False)
        return Rejected(attempt.t_s, RejectReason.GIVEN_UP, f"after {t_s - attempt.t_s:.0f} s")

    def _count(self, localizer: Localizing, succeeded: bool) -> None:
        self.attempts += 1
        self.accepted += succeeded
        self._misses = 0 if succeeded else self._misses + 1
        if not succeeded:
            self._first_fix.missed()
            self._lens.missed()
        self._features.report(localizer, succeeded)

    def _prior(self, now: Estimate | None, R_ned_body: Array | None) -> Prior:
        """What the filter knows, as the localizer wants it.

        A filter that is sure of itself and finds nothing is doubted: its place and its heading may
        be wrong by more than it says; what is not looked for is not found.
        """
        # As the autopilot says it: the filter carries the error of that, and would count it twice.
        tilt = (None, None) if R_ned_body is None else euler_from_rotation(R_ned_body)[:2]
        roll_rad, pitch_rad = tilt
        if now is None:
            return Prior(roll_rad=roll_rad, pitch_rad=pitch_rad)
        yaw_rad = math.remainder(yaw_of(now.quat_wxyz) + now.camera_turn_rad, 2.0 * math.pi)
        doubt = min(2.0 ** (self._misses // self._config.doubt_after), MAX_DOUBT)
        agl_ratio = max(now.sigma_agl_m / max(now.agl_m, 1.0), self._lens.least_agl_ratio)
        sigma_yaw_rad = doubt * (now.sigma_seen_yaw_rad or now.sigma_yaw_rad)
        prior = Prior(
            yaw_rad=yaw_rad if sigma_yaw_rad < MAX_YAW_SIGMA_RAD else None,
            sigma_yaw_rad=sigma_yaw_rad, agl_m=now.agl_m, readout_s=self._odometry.readout_s,
            sigma_agl_ratio=max(agl_ratio, min(doubt * agl_ratio, MAX_DOUBTED_AGL_RATIO)),
            roll_rad=roll_rad, pitch_rad=pitch_rad, slope_ne=now.slope_ne,
        )  # fmt: skip
        if (sigma_m := now.sigma_horizontal_m) > self._config.max_prior_sigma_m:
            return prior
        lat_deg, lon_deg, _ = self.local_frame.to_geodetic(now.position_ned_m)
        if now.t_last_fix_s is None and (state := self._ekf.state) is not None and is_told(state):
            doubt = max(doubt, TOLD_DOUBT)
        sigma_m = doubt * max(sigma_m, MIN_PRIOR_SIGMA_M)
        return replace(prior, lat_deg=float(lat_deg), lon_deg=float(lon_deg), sigma_m=sigma_m)

    def _fuse_fix(self, fix: MapFix, attempt: Attempt) -> MapFix | Rejected:
        """Hand a fix to the filter; what its gate refuses is no fix."""
        ned_m = self.local_frame.to_ned(fix.lat_deg, fix.lon_deg, self.local_frame.alt_amsl_m)
        asked = self._lens.is_open or attempt.widely
        off = asked and self._lens.is_off(fix, attempt.then, self._ekf.state)
        misseen, lone = off and self._lens.is_open, off and self._lens.is_lone()
        told = NedFix(
            t_s=fix.t_s, position_ne_m=ned_m[:2], covariance_ne_m2=fix.covariance_ne_m2,
            yaw_rad=fix.yaw_rad, sigma_yaw_rad=fix.sigma_yaw_rad,
            agl_m=None if misseen else fix.agl_m, sigma_agl_m=None if misseen else fix.sigma_agl_m,
            sigma_tilt_rad=self._sigma_tilt_rad if fix.point == "nadir" else 0.0,
        )  # fmt: skip
        with self._lock:
            if lone or (attempt.begins and not self._first_fix.confirmed(fix, attempt.then)):
                why = RejectReason.UNCONFIRMED, "of another height" if lone else "found once"
                return Rejected(fix.t_s, *why, fix.features, fix.stats)
            if attempt.begins and (self._ekf.state is None or self._first_fix.doubted):
                self._ekf.initialise(start_at(fix, ned_m))
                self._first_fix.began()
            innovation = self._ekf.handle(told)
        if innovation.accepted:
            if self._first_fix.young:
                self._first_fix.fused()
            if len(parts := innovation.parts) == 2 and parts[0].verdict is Verdict.FUSED:  # heading
                self._borne_s = fix.t_s
            if misseen and self._lens.told_by_fix() and (state := self._ekf.state) is not None:
                self._recalibrate(Recalibrated(state.t_s))
            return fix
        reason = f"{innovation.verdict.value} (NIS {innovation.nis or 0.0:.0f})"
        return Rejected(fix.t_s, RejectReason.PRIOR, reason, fix.features, fix.stats)

    def _recalibrate(self, event: Recalibrated | None) -> None:
        """Go on with the camera that map or ways have shown, where they have: it was another."""
        if self._recalibrated is None or event is None:
            return
        with self._lock:  # the filter first: the new camera's error would be the old one's to it
            if not self._ekf.handle(event).accepted:
                return
            self._camera = found_by(event, self._lens.focal_ratio, self._camera)  # with its state
        self._features, self._odometry = self._recalibrated(self._camera)
