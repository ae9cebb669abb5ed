"""The estimator: every measurement at its own time, in any order; the estimate at any time.

Read `states.py` first (what is estimated, with all noises), then `process.py` (how it moves),
`fusion.py` and `fixes.py` (what each measurement says), `timeline.py` (late ones).
"""

import math
from collections.abc import Callable
from functools import partial

from vwnav.estimation.config import EkfConfig
from vwnav.estimation.context import Context, Ground
from vwnav.estimation.fusion import apply
from vwnav.estimation.inertial.attitude_gate import AttitudeGate
from vwnav.estimation.inertial.attitudes import MAX_GAP_S, AttitudeHistory, GyroHistory, is_rotation
from vwnav.estimation.inertial.imu import ImuHistory, is_sensible
from vwnav.estimation.inertial.imu_trust import ImuTrust
from vwnav.estimation.inputs import Asked, Input, Measurement
from vwnav.estimation.odometry_trust import OdometryTrust, of_doubtful_date, possible, shaken
from vwnav.estimation.process import predict
from vwnav.estimation.states import (
    FilterState,
    Start,
    begun_anew,
    estimate_of,
    first_state,
    outside,
)
from vwnav.estimation.timeline import (
    Displacement,
    Drag,
    Event,
    EventRank,
    Exposed,
    LateFix,
    NedFix,
    NewKeyframe,
    Timeline,
    between,
)
from vwnav.estimation.updates import Innovation, Verdict
from vwnav.types import Attitude, Estimate, Height, ImuSample, OdometryMotion, Range, Stationary

__all__ = ["Ekf", "EkfConfig", "Innovation", "NedFix", "Start", "Verdict"]

_ATTITUDE_MARGIN_S = 1.0
_SAID_S = 5.0
_ATTITUDE_LATE_S = 0.1  # by which it is behind the gyro, when it is late
_IMU_OF_NOW_S = 0.2  # so old it may be to have felt a picture's way


class Ekf:
    """Error-state filter over the autopilot's attitude, barometer and rangefinder, odometry, fixes.

    Not thread-safe: one thread, or a lock around it. `estimate` tells it the time; a measurement
    far ahead of the newest time known is refused. No measurement ever raises: what is not sensible
    is refused and said so.
    """

    def __init__(self, config: EkfConfig, ground: Ground | None = None) -> None:
        """Prepare.

        Args:
            config: noises and limits.
            ground: terrain heights of the map in the filter's own frame, where it has them.
        """
        self._config = config
        length_s = config.history_s + _ATTITUDE_MARGIN_S
        gap_s = math.inf if config.odometry_turns_attitude else MAX_GAP_S
        self._gyro = GyroHistory(length_s)
        self._attitudes = AttitudeHistory(length_s, self._gyro, gap_s)
        self._imu = ImuHistory(self._attitudes, self._gyro, length_s)
        self._gate = AttitudeGate(self._attitudes, self._imu)
        self._context = Context(config, self._attitudes, self._imu, ground)
        self._timeline: Timeline | None = None
        self._asked_s = -math.inf
        self._tape: Callable[[Input], None] | None = None
        self._say: Callable[[str], None] = lambda _: None
        self._restarted_s = -math.inf
        self._newest_way: OdometryMotion | None = None
        self._trust = OdometryTrust()
        self._imu_trust = ImuTrust()
        self._drag_s = -math.inf

    @property
    def initialised(self) -> bool:
        """Whether there is a state."""
        return self._timeline is not None

    @property
    def counts_heading(self) -> bool:
        """A video alone, by its settings: its attitude is level with the heading of odometry."""
        return self._config.odometry_turns_attitude

    def covers(self, t_s: float) -> bool:
        """Whether waiting for telemetry tells no more of the attitude at an exposure.

        An attitude has come since, or the gyro alone reaches far beyond: attitudes are late.
        """
        newest_s = self._attitudes.newest_s
        if self.counts_heading or (newest_s is not None and newest_s >= t_s):
            return True
        return self._gyro.newest_s >= t_s + _ATTITUDE_LATE_S and self._attitudes.tell(t_s)

    def attitude_at(self, t_s: float) -> Attitude | None:
        """The autopilot's attitude at an exposure; None where telemetry does not reach."""
        return self._attitudes.at(t_s)

    @property
    def state(self) -> FilterState | None:
        """The state after the newest event, for recordings and tests."""
        return None if self._timeline is None else self._timeline.head

    def record(self, tape: Callable[[Input], None]) -> None:
        """Hand every input from now on to `tape` too, refused ones as well, in their order.

        A new filter of the same settings and ground that takes them gives the same estimates.
        """
        self._tape = tape

    def on_event(self, say: Callable[[str], None]) -> None:
        """Tell `say` in a sentence when the state has left its envelope and begins anew.

        Also when the ways that pictures tell are not believed any more, and when they are again.
        What happens again within seconds (an aircraft that truly flies faster than aircraft do) is
        not said again.
        """
        self._say = say

    def take(self, seen: Input) -> Estimate | None:
        """Take an input of any kind; the estimate where one was asked for.

        Raises:
            ValueError: a start that makes no sense.
        """
        match seen:
            case Start():
                self.initialise(seen)
            case Asked(t_s):
                return self.estimate(t_s)
            case _:
                self.handle(seen)
        return None

    def initialise(self, start: Start) -> None:
        """Begin, or begin anew; attitudes that came before are kept, those from the future not.

        Raises:
            ValueError: the start is not finite or a sigma is not positive.
        """
        self._begin(first_state(start, self._config))
        self._note(start)
        # A start may be long ago: a first search took its time.
        self._asked_s = max(start.t_s, self._asked_s)
        self._attitudes.forget_after(self._asked_s + self._config.ahead_s)

    def _begin(self, state: FilterState) -> None:
        step = partial(apply, context=self._context)
        self._timeline = Timeline(state, step, self._config.history_s, self._config.jump_m)

    def handle(self, seen: Measurement) -> Innovation:
        """Take a measurement of any kind."""
        match seen:
            case Attitude():
                return self._handle_attitude(seen)
            case ImuSample():
                return self._handle_imu(seen)
            case OdometryMotion():
                return self._handle_odometry(seen)
            case NedFix():
                return self._handle_fix(seen)
            case _:
                return self._handle_event(seen)

    def _handle_attitude(self, attitude: Attitude) -> Innovation:
        """Take the autopilot's attitude, unaltered: its heading bias is one of the states."""
        self._note(attitude)
        if not is_rotation(attitude):
            return Innovation(Verdict.NOT_FINITE)
        if self._timeline is not None and self._ahead(attitude.t_s):
            return Innovation(Verdict.AHEAD)
        if self._config.odometry_turns_attitude:
            self._attitudes.add(attitude)
            return Innovation(Verdict.FUSED)
        return Innovation(self._gate.take(attitude))

    def _handle_imu(self, sample: ImuSample) -> Innovation:
        """Take a sample of the IMU, in order of time and after the attitude of its moment.

        While samples come, they move the estimate between measurements, instead of the attitude's
        thrust and the slow acceleration.
        """
        self._note(sample)
        if not is_sensible(sample):
            return Innovation(Verdict.NOT_FINITE)
        if self._timeline is not None and self._ahead(sample.t_s):
            return Innovation(Verdict.AHEAD)
        self._gate.heard(sample.t_s)
        if not self._imu.believes(sample):
            return Innovation(Verdict.GATED)
        if not self._feels_gravity(sample):
            return Innovation(Verdict.DISTRUSTED)
        if not self._imu.add(sample):
            return Innovation(Verdict.TOO_LATE)
        if self._timeline is not None and sample.t_s >= self._drag_s + self._config.drag_interval_s:
            self._drag_s = sample.t_s
            self._insert(Drag(sample.t_s))
        return Innovation(Verdict.FUSED)

    def _feels_gravity(self, sample: ImuSample) -> bool:
        """Else nothing that it has told in the history counts, nor does what comes."""
        if not self._attitudes.tell(sample.t_s):
            return not self._imu_trust.lost
        if self._imu_trust.saw(sample, self._attitudes.quat_at(sample.t_s)):
            if self._imu_trust.lost:
                self._imu.forget()
                if self._timeline is not None:
                    self._timeline.leave_out(EventRank.DRAG)
            self._say(self._imu_trust.words)
        return not self._imu_trust.lost

    def _handle_fix(self, fix: NedFix) -> Innovation:
        """Take a map fix; the heading and AGL in it are judged one by one (`parts`).

        One that is older than the history meets the clone of its picture's pose, if it was told
        when that was taken (`Exposed`).
        """
        self._note(fix)
        refusal = self._refusal(fix)
        if refusal is not None or self._timeline is None:
            return Innovation(refusal or Verdict.NOT_STARTED)
        if self._trust.lost:
            fix = of_doubtful_date(fix, self._timeline.head)
        # At the beginning of the history: a picture taken since may have been cloned in its place.
        oldest_s = self._timeline.oldest_s
        innovation = self._insert(fix if fix.t_s >= oldest_s else LateFix(oldest_s, fix))
        if innovation.accepted:
            self._trust.saw_fix()
        return innovation

    def _handle_odometry(self, motion: OdometryMotion) -> Innovation:
        """Take the motion since a keyframe, in NED as the autopilot's own heading has it.

        One of ways that mostly contradict the IMU is refused, and those before it too.
        """
        self._note(motion)
        innovation = self._meet_way(motion)
        if innovation.verdict in (Verdict.FUSED, Verdict.GATED):
            self._judge_ways(innovation.accepted)
        return Innovation(Verdict.DISTRUSTED) if self._trust.lost else innovation

    def _meet_way(self, motion: OdometryMotion) -> Innovation:
        """Insert it, or only ask what would become of it while none is believed."""
        event = Displacement(shaken(motion, self._gyro, self._config))
        refusal = self._refusal(event)
        if refusal is not None or self._timeline is None:
            return Innovation(refusal or Verdict.NOT_STARTED)
        if not possible(motion, self._timeline.head, self._config):
            return Innovation(Verdict.IMPOSSIBLE)
        before, self._newest_way = self._newest_way, motion
        if not self._timeline.keyframe_known(motion.t0_s) and motion.t0_s < self._timeline.oldest_s:
            if before is None or not before.t0_s == motion.t0_s < before.t1_s < motion.t1_s:
                return Innovation(Verdict.NO_ANCHOR)
            event = Displacement(shaken(between(before, motion), self._gyro, self._config))
        if not self._seen_upright(event.motion):
            return Innovation(Verdict.NO_ATTITUDE)
        if not self._anchored(event.motion):
            return Innovation(Verdict.NO_ANCHOR)
        if event.t_s > self._gyro.newest_s + _IMU_OF_NOW_S:
            self._trust = OdometryTrust()  # nothing contradicts them any more
        return self._timeline.test(event) if self._trust.lost else self._insert(event)

    def _judge_ways(self, agrees: bool) -> None:
        assert self._timeline is not None
        if self._trust.saw(agrees, self._timeline.head):
            if self._trust.lost:
                self._timeline.leave_out(EventRank.ODOMETRY, EventRank.FIX)
            self._say(self._trust.words)

    def _anchored(self, motion: OdometryMotion) -> bool:
        """Whether its keyframe is cloned, from now on if not before."""
        assert self._timeline is not None
        if self._timeline.keyframe_known(motion.t0_s):
            return True
        share = self._config.anchor_share
        covariance = share * motion.covariance_ned_m2
        sigma_yaw_rad = math.sqrt(share) * motion.sigma_yaw_rad
        return self._timeline.insert(NewKeyframe(motion.t0_s, covariance, sigma_yaw_rad)).accepted

    def _seen_upright(self, motion: OdometryMotion) -> bool:
        """Whether attitudes that are believed tell how its pictures were turned to the ground."""
        assert self._timeline is not None
        refused = self._gate.refused(motion.t1_s) or self._gate.refused(motion.t0_s)
        if refused or self._attitudes.at(motion.t1_s) is None:
            return False
        known = self._timeline.keyframe_known(motion.t0_s)
        return known or self._attitudes.at(motion.t0_s) is not None

    def estimate(self, t_s: float) -> Estimate | None:
        """The estimate at `t_s` by prediction (at the newest event if that is later).

        None before the start, and before the first attitude: nobody knows how it flies.
        """
        if self._timeline is None:
            return None
        self._note(Asked(t_s))
        if math.isfinite(t_s):
            self._asked_s = t_s
        if self._attitudes.newest_s is None:
            return None
        state = predict(self._timeline.head, t_s, self._context)
        turned_rad = self._attitudes.turned_unseen_rad(state.t_s)
        return estimate_of(state, self._attitudes.quat_at(state.t_s), turned_rad)

    def _note(self, seen: Input) -> None:
        if self._tape is not None:
            self._tape(seen)

    def _handle_event(self, event: Height | Range | Stationary | Exposed) -> Innovation:
        self._note(event)
        refusal = self._refusal(event)
        if refusal is not None or self._timeline is None:
            return Innovation(refusal or Verdict.NOT_STARTED)
        if isinstance(event, Height | Range | Stationary):
            self._gate.heard(event.t_s)
        return self._insert(event)

    def _insert(self, event: Event) -> Innovation:
        """Into the timeline; a state that no aircraft has begins anew."""
        assert self._timeline is not None
        innovation = self._timeline.insert(event)
        why = outside(self._timeline.head, self._config)
        if why is not None:
            head = self._timeline.head
            self._begin(begun_anew(head, self._config))
            again, self._restarted_s = head.t_s < self._restarted_s + _SAID_S, head.t_s
            if not again:
                self._say(f"the estimate left its envelope ({why}) and begins anew")
        return innovation

    def _refusal(self, event: Event) -> Verdict | None:
        if not event.sensible():
            return Verdict.NOT_FINITE
        if self._timeline is None:
            return Verdict.NOT_STARTED
        if self._ahead(event.t_s):
            return Verdict.AHEAD
        return None

    def _ahead(self, t_s: float) -> bool:
        head_s = -math.inf if self._timeline is None else self._timeline.head.t_s
        attitude_s = self._attitudes.newest_s
        newest_s = max(self._asked_s, head_s, -math.inf if attitude_s is None else attitude_s)
        return t_s > newest_s + self._config.ahead_s
