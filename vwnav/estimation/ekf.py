"""The estimator: every measurement at its own time, in any order; the estimate at any time.

Read `states.py` and `config.py` first (what is estimated, the Kalman update, all noises), then
`process.py` (how it moves), `fixes.py`, `odometry.py` and `heights.py` (what each measurement
says), `timeline.py` (which of them it is, and late ones).
"""

import math
from collections import deque
from collections.abc import Callable

import numpy as np

from vwnav.estimation.beginning.explanations import explained
from vwnav.estimation.beginning.starts import Start, begun_anew, first_state
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.context import Context, Ground, patch_below
from vwnav.estimation.disputes import is_told
from vwnav.estimation.events import (
    Drag,
    Event,
    LateFix,
    LensDoubted,
    Misled,
    NedFix,
    RangeDoubted,
    Recalibrated,
    Told,
)
from vwnav.estimation.inertial.attitude_gate import AttitudeGate
from vwnav.estimation.inertial.attitudes import MAX_GAP_S, AttitudeHistory
from vwnav.estimation.inertial.dates import of_doubtful_date
from vwnav.estimation.inertial.drag import explained_m_s2
from vwnav.estimation.inertial.imu import ImuHistory
from vwnav.estimation.inertial.imu_gate import ImuGate
from vwnav.estimation.inputs import Asked, Input, Measurement
from vwnav.estimation.odometry_gate import OdometryGate
from vwnav.estimation.process import predict
from vwnav.estimation.states import FilterState, Innovation, Verdict, estimate_of
from vwnav.estimation.timeline import Timeline, sensible
from vwnav.types import Attitude, Estimate, Height, ImuSample, OdometryMotion, Range, Stationary

_ATTITUDE_MARGIN_S = 1.0
_SAID_S = 5.0
_RANGE_DOUBTED = "the rangefinder contradicts map and barometer: it is not believed"
_RANGE_AGAIN = "the rangefinder agrees with map and barometer again: it is believed"
_MISLED_S = 10.0  # for so long at most wrong ways are believed
_EXPLAINED_AGAIN_S = 10.0  # refused fixes, at the earliest
_ATTITUDE_LATE_S = 0.1  # by which it is behind the gyro, when it is late


class Ekf:
    """Error-state filter over the autopilot's attitude, barometer and rangefinder, odometry, fixes.

    Not thread-safe: one thread, or a lock around it. `estimate` tells it the time; what is far
    ahead of it is refused. No measurement ever raises: what is not sensible is refused and said so.

    Attributes:
        attitudes: the autopilot's, as they are believed.
        counts_heading: a video alone: its attitude is level, with the heading of odometry.
    """

    def __init__(self, config: EkfConfig, ground: Ground | None = None) -> None:
        """Prepare.

        Args:
            config: noises and limits.
            ground: terrain heights of the map in the filter's own frame, where it has them.
        """
        self.counts_heading = config.odometry_turns_attitude
        self._config = config
        length_s = config.history_s + _ATTITUDE_MARGIN_S
        gap_s = math.inf if self.counts_heading else MAX_GAP_S
        self.attitudes = AttitudeHistory(length_s, gap_s)
        self._imu = ImuHistory(self.attitudes, length_s)
        self._attitude_gate = AttitudeGate(self.attitudes, self._imu)
        self._imu_gate = ImuGate(self.attitudes, self._imu)
        self._odometry_gate = OdometryGate(self.attitudes, self._imu, config)
        self._explained_s = self._restarted_s = self._drag_s = -math.inf
        self._context = Context(config, self.attitudes, self._imu, ground)
        self._timeline: Timeline | None = None
        self._asked_s = -math.inf
        self._input_log: Callable[[Input], None] = deque[Input](maxlen=0).append  # keeps none
        self._say: Callable[[str], None] = lambda _: None
        self._refused_ways = 0  # in a row

    def covers(self, t_s: float) -> bool:
        """Whether waiting for telemetry tells no more of the attitude at an exposure.

        An attitude has come since, or the gyro alone reaches far beyond: attitudes are late.
        """
        if self.counts_heading or self.attitudes.newest_s >= t_s:
            return True
        gyro_s = self.attitudes.gyro.newest_s
        return gyro_s >= t_s + _ATTITUDE_LATE_S and self.attitudes.knows(t_s)

    @property
    def state(self) -> FilterState | None:
        """The state after the newest event; None before a start."""
        return None if self._timeline is None else self._timeline.newest

    def record(self, input_log: Callable[[Input], None]) -> None:
        """Hand every input from now on to `input_log` too, refused ones as well, in their order.

        A new filter of the same settings and ground that takes them gives the same estimates.
        """
        self._input_log = input_log

    def on_event(self, say: Callable[[str], None]) -> None:
        """Tell `say` in a sentence when the state has left its envelope and begins anew.

        Also when the ways that images tell are not believed any more, and when they are again.
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
        first = first_state(start, self._config)
        if self._timeline is not None:  # others have seen its counter
            first = first._replace(reset_counter=self._timeline.newest.reset_counter + 1)
        self._timeline = Timeline(first, self._context)
        self._input_log(start)
        # A start may be long ago: a first search took its time.
        self._asked_s = max(start.t_s, self._asked_s)
        self.attitudes.forget_after(self._asked_s + self._config.ahead_s)

    def handle(self, seen: Measurement) -> Innovation:
        """Take a measurement of any kind."""
        self._input_log(seen)
        match seen:
            case Attitude():
                return self._handle_attitude(seen)
            case ImuSample():
                return self._handle_imu(seen)
            case OdometryMotion():
                return self._handle_odometry(seen)
            case NedFix():
                return self._handle_fix(seen)
            case Recalibrated():
                self._odometry_gate.other_camera()
        refusal = self._refusal(seen)
        if refusal is not None or self._timeline is None:
            return Innovation(refusal or Verdict.NOT_STARTED)
        if isinstance(seen, Height | Range | Stationary):
            self._attitude_gate.heard(seen.t_s)
        return self._insert(seen)

    def _range_changed(self, again: bool) -> None:
        """The rangefinder is believed again, or not any more: nor what it drew the height to."""
        assert self._timeline is not None
        if not again:
            newest = self._timeline.newest
            self._timeline.leave_out(Range)
            self._timeline.insert(RangeDoubted(newest.t_s, newest.range_trust.drawn_m))
        self._say(_RANGE_AGAIN if again else _RANGE_DOUBTED)

    def _handle_attitude(self, attitude: Attitude) -> Innovation:
        """Take the autopilot's attitude, unaltered: its heading bias is one of the states."""
        if (refusal := self._refusal(attitude)) is not None:
            return Innovation(refusal)
        if self.counts_heading:
            self.attitudes.add(attitude)
            return Innovation(Verdict.FUSED)
        return Innovation(self._attitude_gate.take(attitude))

    def _handle_imu(self, sample: ImuSample) -> Innovation:
        """Take a sample of the IMU, in order of time and after the attitude of its moment."""
        refusal = self._refusal(sample)
        if refusal is not None:
            self._imu.miss()
            return Innovation(refusal)
        self._attitude_gate.heard(sample.t_s)
        was_lost = self._imu_gate.lost
        verdict = self._imu_gate.take(sample)
        if self._imu_gate.lost != was_lost:
            self._imu_changed()
        if self._timeline is not None:
            if self._timeline.slipped(self._imu.slipped_s):
                self._odometry_gate.forgive()
            if sample.t_s >= self._drag_s + self._config.drag_interval_s:
                self._drag_s = sample.t_s
                self._meet_air(verdict, sample.t_s)
        return Innovation(verdict)

    def _meet_air(self, verdict: Verdict, t_s: float) -> None:
        """Hold what the IMU feels against what the air does, also while it is not believed."""
        assert self._timeline is not None
        if verdict is Verdict.FUSED:
            self._imu_gate.saw_drag(self._insert(Drag(t_s)))
        elif self._imu_gate.lost and (held := self.attitudes.held(t_s)).known:
            explained = explained_m_s2(self._timeline.newest, held.quat_wxyz)
            self._imu_gate.compare(*explained, t_s)

    def _imu_changed(self) -> None:
        """What was felt until now is not believed any more, or what comes is again."""
        if self._imu_gate.lost and self._timeline is not None:
            self._timeline.leave_out(Drag)
        self._say(self._imu_gate.words)

    def _handle_fix(self, fix: NedFix) -> Innovation:
        """Take a map fix; the heading and AGL in it are judged one by one (`parts`).

        One that is older than the history meets the clone of its image's pose, if it was told
        when that was taken (`Exposed`).
        """
        refusal = self._refusal(fix)
        if refusal is not None or self._timeline is None:
            return Innovation(refusal or Verdict.NOT_STARTED)
        if self._odometry_gate.lost:
            fix = of_doubtful_date(fix, self._timeline.newest, self.attitudes)
        # At the beginning of the history: an image taken since may have been cloned in its place.
        oldest_s = self._timeline.oldest.t_s
        innovation = self._insert(fix if fix.t_s >= oldest_s else LateFix(oldest_s, fix))
        if not innovation.accepted:
            return self._explain(self._timeline) or innovation
        self._odometry_gate.fixes += fix.agl_m is not None or fix.yaw_rad is None  # in scale
        self._imu_gate.fixes_s.append(fix.t_s)
        return innovation

    def _explain(self, timeline: Timeline) -> Innovation | None:
        """Go on with what makes fixes right that were refused in a row, where something does."""
        newest = timeline.newest
        again = newest.t_s < self._explained_s + _EXPLAINED_AGAIN_S
        if again or is_told(newest) or self._odometry_gate.lost or self.counts_heading:
            return None
        if (found := explained(timeline, self.attitudes)) is None:
            return None
        self._timeline, words = found
        self._explained_s = self._timeline.newest.t_s
        self._say(words)
        return Innovation(Verdict.FUSED)

    def _handle_odometry(self, motion: OdometryMotion) -> Innovation:
        """Take the motion since a keyframe, in NED as the autopilot's own heading has it.

        One of ways that mostly contradict the IMU is refused, and those before it too.
        """
        innovation, gate = self._meet_way(motion), self._odometry_gate
        if innovation.verdict in (Verdict.FUSED, Verdict.GATED):
            assert self._timeline is not None
            agrees = innovation.verdict is Verdict.FUSED
            if not gate.lost:
                self._refused_ways = 0 if agrees else self._refused_ways + 1
            doubtful = not (agrees or gate.lost)
            if doubtful and self._imu_gate.refused_ways(self._refused_ways, motion.t1_s):
                self._imu_changed()
                gate.forgive()
            elif gate.learn(innovation, motion, self._timeline.newest):
                if gate.lost or gate.lens_doubted:
                    self._take_ways_back()
                self._say(gate.words)
        told = gate.lost and innovation.verdict is not Verdict.IMPOSSIBLE
        return Innovation(Verdict.DISTRUSTED) if told else innovation

    def _take_ways_back(self) -> None:
        """Ways contradict the IMU: those in the history go, and what older ones have taught.

        Not where map fixes had agreed with them: then the older ones were right.
        """
        assert self._timeline is not None
        newest, believed_s = self._timeline.newest, self._odometry_gate.believed_s
        have_taught = not self._odometry_gate.borne and believed_s < self._timeline.oldest.t_s
        self._timeline.leave_out_ways()
        if self._odometry_gate.lens_doubted:
            self._insert(LensDoubted(newest.t_s))
        elif have_taught:
            self._insert(Misled(newest.t_s, max(believed_s, newest.t_s - _MISLED_S)))

    def _meet_way(self, motion: OdometryMotion) -> Innovation:
        """Insert it, or only ask what would become of it while none is believed."""
        event = self._odometry_gate.displacement(motion)
        refusal = self._refusal(event)
        if refusal is not None or self._timeline is None:
            return Innovation(refusal or Verdict.NOT_STARTED)
        admitted = self._odometry_gate.admit(motion, event, self._timeline)
        if isinstance(admitted, Verdict):
            return Innovation(admitted)
        return self._timeline.test(admitted) if self._odometry_gate.lost else self._insert(admitted)

    def estimate(self, t_s: float) -> Estimate | None:
        """The estimate at `t_s` by prediction (at the newest event if that is later).

        None before the start, and before the first attitude: nobody knows how it flies.
        """
        if self._timeline is None:
            return None
        self._input_log(Asked(t_s))
        if math.isfinite(t_s):
            self._asked_s = t_s
        if self.attitudes.newest_s == -math.inf:
            return None
        state = self._timeline.newest
        if t_s > state.t_s:
            state = predict(state, t_s, self._context)
        held = self.attitudes.held(state.t_s)
        table = np.zeros(2)
        if self._context.ground is not None and (patch := patch_below(state, self._context)):
            table = np.array([patch.per_north, patch.per_east])
        return estimate_of(state, held.quat_wxyz, held.open_rad, table)

    def _insert(self, event: Event) -> Innovation:
        """Into the timeline; a state that no aircraft has begins anew."""
        assert self._timeline is not None
        before = self._timeline.newest
        doubted = before.range_trust.doubted_s is not None
        innovation = self._timeline.insert(event)
        if (self._timeline.newest.range_trust.doubted_s is not None) != doubted:
            self._range_changed(doubted)
        newest = self._timeline.newest
        if newest.map_error.told_m > before.map_error.told_m:
            self._say(newest.map_error.words)
        if (why := self._timeline.outside) is not None:
            self._timeline = Timeline(begun_anew(newest, self._config), self._context)
            again, self._restarted_s = newest.t_s < self._restarted_s + _SAID_S, newest.t_s
            if not again:
                self._say(f"the estimate left its envelope ({why}) and begins anew")
        return innovation

    def _refusal(self, seen: Told | Attitude | ImuSample) -> Verdict | None:
        """Why it is not taken: no sense in it, or far ahead of the newest time that is known.

        Attitudes and samples of before the start are kept; no time is known then.
        """
        if not sensible(seen):
            return Verdict.NOT_FINITE
        if self._timeline is None:
            return None if isinstance(seen, Attitude | ImuSample) else Verdict.NOT_STARTED
        newest_s = max(self._asked_s, self._timeline.newest.t_s, self.attitudes.newest_s)
        return Verdict.AHEAD if seen.t_s > newest_s + self._config.ahead_s else None
