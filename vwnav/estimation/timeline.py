"""What happens to the filter, in order of time: each event predicted to, and corrected by.

Every measurement is applied at its own time; one that comes late goes where it belongs, and what
came after it is applied again.
"""

import bisect
import math
from copy import copy
from dataclasses import replace
from itertools import compress

import numpy as np

from vwnav.estimation.beginning.map_error import LOOK_M
from vwnav.estimation.beginning.misled import apply_misled, apply_untracked
from vwnav.estimation.beginning.other_camera import (
    apply_camera_returned,
    apply_lens_doubted,
    apply_mount_doubted,
    apply_recalibrated,
)
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.context import Context
from vwnav.estimation.disputes import learned_of_map, map_stepped, range_doubted
from vwnav.estimation.events import (
    CameraReturned,
    Displacement,
    Drag,
    Event,
    Exposed,
    LateFix,
    LensDoubted,
    MapStepped,
    Misled,
    MountDoubted,
    NedFix,
    NewKeyframe,
    RangeDoubted,
    Recalibrated,
    Told,
    Untracked,
)
from vwnav.estimation.fixes import apply_exposure, apply_fix
from vwnav.estimation.heights import apply_height, apply_range, apply_stationary
from vwnav.estimation.inertial.attitudes import LONGEST_GAP_S, is_rotation
from vwnav.estimation.inertial.dates import of_doubtful_date
from vwnav.estimation.inertial.drag import apply_drag
from vwnav.estimation.inertial.imu import is_felt
from vwnav.estimation.odometry import (
    apply_displacement,
    apply_keyframe,
)
from vwnav.estimation.process import predict
from vwnav.estimation.states import FilterState, Innovation, States, Verdict
from vwnav.types import Array, Attitude, Height, ImuSample, Range, Stationary

_LARGEST_RANGE_M = 1e5  # no rangefinder sees further
# Order of events at the same time; clones are last, so that they copy what others left, and what
# was seen then was seen by the camera of before.
_ORDER: tuple[type[Event], ...] = (
    Misled, CameraReturned, LensDoubted, MountDoubted, MapStepped, RangeDoubted, Untracked,
    LateFix, Stationary, Height, Range, NedFix, Displacement, Drag, NewKeyframe, Exposed,
    Recalibrated,
)  # fmt: skip
_RANKS = {kind: rank for rank, kind in enumerate(_ORDER)}


class Timeline:
    """The last seconds of the filter.

    The state is always what it would be had every event come in order: inserting one applies all
    later ones again. But for its `reset_counter`, which others have seen: it never falls, and a
    past that has changed by so much that the newest position jumps counts too.

    Attributes:
        oldest: the state before all events; what is earlier is too late.
        newest: the state after all of them.
        outside: why the newest one cannot be that of an aircraft; None while it can.
    """

    def __init__(self, start: FilterState, context: Context) -> None:
        self.oldest = self.newest = start
        self.outside: str | None = None
        self._context = context
        self._orders: list[tuple[float, int]] = []  # time and rank of each event
        self._events: list[Event] = []
        self._states = [start]  # before each event, and after the last

    def keyframe_known(self, t_s: float) -> bool:
        """Whether a keyframe of that time is in the history or in the state before it."""
        anchor = self.oldest.anchor
        if anchor is not None and anchor.t_s == t_s:
            return True
        order = (t_s, _RANKS[NewKeyframe])
        i = bisect.bisect_left(self._orders, order)
        return self._orders[i : i + 1] == [order]

    def insert(self, event: Event) -> Innovation:
        """Apply an event at its time, and everything after it again."""
        if isinstance(event, Recalibrated) and (event.knocked or event.redated_s):
            event = self._knocked(event)
        if event.t_s < self.oldest.t_s:
            return Innovation(Verdict.TOO_LATE)
        order = (event.t_s, _RANKS[type(event)])
        i = bisect.bisect_left(self._orders, order)
        if self._orders[i : i + 1] == [order]:
            return Innovation(Verdict.DUPLICATE)
        state, innovation = apply(self._states[i], event, self._context)
        self._orders.insert(i, order)
        self._events.insert(i, event)
        self._states.insert(i + 1, state)
        if i + 1 < len(self._events):
            self._apply_again(i + 1)
        self.newest = self._states[-1]
        self.outside = outside(self.newest, self._context.config)
        old = bisect.bisect_left(
            self._orders, (self.newest.t_s - self._context.config.history_s, 0)
        )
        del self._orders[:old], self._events[:old], self._states[:old]
        self.oldest = self._states[0]
        return innovation

    def slipped(self, seconds: float) -> bool:
        """Whether the aircraft's time stood for so long: what came since was met where it was not.

        Who was told meanwhile that it flew on is told anew.
        """
        if seconds < LONGEST_GAP_S:
            return False
        counter, flown_m = self.newest.reset_counter, seconds * self.newest.x[States.VELOCITY]
        self._apply_again(0)
        self.newest = self._states[-1]
        jumped = float(np.linalg.norm(flown_m)) > self._context.config.jump_m
        if jumped and self.newest.reset_counter == counter:
            self._states[-1] = self.newest = self.newest._replace(reset_counter=counter + 1)
        return True

    def test(self, event: Event) -> Innovation:
        """What `insert` would say of an event, which is left out."""
        if event.t_s < self.oldest.t_s:
            return Innovation(Verdict.TOO_LATE)
        i = bisect.bisect_left(self._orders, (event.t_s, _RANKS[type(event)]))
        return apply(self._states[i], event, self._context)[1]

    def leave_out(self, *kinds: type[Event], since_s: float = -math.inf) -> list[Event]:
        """As if no event of these kinds had come in the history, `since_s`; those there were."""
        goes = [isinstance(each, kinds) and each.t_s >= since_s for each in self._events]
        out = list(compress(self._events, goes))
        kept = [i for i, gone in enumerate(goes) if not gone]
        self._orders = [self._orders[i] for i in kept]
        self._events = [self._events[i] for i in kept]
        self._apply_again(0)
        self.oldest, self.newest = self._states[0], self._states[-1]
        return out

    def leave_out_ways(self) -> None:
        """As if no way had come in the history, and each fix of a doubtful date."""
        for event in self.leave_out(Displacement, NedFix):
            if isinstance(event, NedFix):
                self.insert(of_doubtful_date(event, self.newest, self._context.attitudes))

    def followed_since(self, t_s: float) -> bool:
        """Whether images told ways from then on, in the history, and all were believed."""
        later = [event for event in self._events if event.t_s > t_s]
        told = any(isinstance(event, Displacement) for event in later)
        lost = any(isinstance(event, Untracked) for event in later)
        refused = any(each.t_s > t_s for each in self.newest.rejected_ways)
        return told and not (lost or refused)

    def told_anew(self, event: Event) -> tuple["Timeline", list[Verdict]]:
        """Another one, in which an event was too, and what becomes of the fixes after it then."""
        other, order = copy(self), (event.t_s, _RANKS[type(event)])
        i = bisect.bisect_left(self._orders, order)
        other._orders = [*self._orders[:i], order, *self._orders[i:]]
        other._events = [*self._events[:i], event, *self._events[i:]]
        answers = other._apply_again(i)
        other.newest = other._states[-1]
        other.outside = outside(other.newest, self._context.config)
        later = zip(other._events[i:], answers, strict=True)
        return other, [answer.verdict for seen, answer in later if isinstance(seen, NedFix)]

    def _knocked(self, event: Recalibrated) -> Recalibrated:
        """What was seen since by a camera that hung otherwise goes, and what it has taught."""
        self.leave_out(Displacement, NedFix, since_s=event.t_s)
        if event.t_s >= self.oldest.t_s:
            return event
        self.insert(Misled(self.oldest.t_s, event.t_s))
        return replace(event, t_s=self.oldest.t_s)

    def _apply_again(self, first: int) -> list[Innovation]:
        """The events from `first` on, now that the past is another, and what became of each."""
        told, state = self.newest, self._states[first]
        states, answers = self._states[: first + 1], []
        for event in self._events[first:]:
            state, answer = apply(state, event, self._context)
            states.append(state)
            answers.append(answer)
        # Of the two newest positions one may be of an earlier moment.
        flown_m = (state.t_s - told.t_s) * told.x[States.VELOCITY]
        apart_m = math.hypot(*((state.x - told.x)[States.POSITION] - flown_m).tolist())
        missing = told.reset_counter - state.reset_counter
        if missing >= 0 and apart_m > self._context.config.jump_m:
            missing += 1
        if missing > 0:  # as if so many more had been before the history
            states = [each._replace(reset_counter=each.reset_counter + missing) for each in states]
        self._states = states
        return answers


def apply(state: FilterState, event: Event, context: Context) -> tuple[FilterState, Innovation]:
    """Predict to an event's time, which is not before the state's, then correct by what it says."""
    if event.t_s > state.t_s:
        state = predict(state, event.t_s, context)
    after, innovation = _corrected(state, event, context)
    one_fix = isinstance(event, NedFix | LateFix) and innovation.verdict is Verdict.FUSED
    way_m = math.dist(after.x[States.POSITION_NE], after.map_error.seen_ne_m) if one_fix else 0.0
    if way_m > LOOK_M and not after.rejected_fixes:
        after = learned_of_map(after, context.config)
    apart_m = math.dist(after.x[States.POSITION].tolist(), state.x[States.POSITION].tolist())
    if apart_m > context.config.jump_m and after.reset_counter == state.reset_counter:
        after = after._replace(reset_counter=state.reset_counter + 1)
    return after, innovation


def _corrected(
    state: FilterState, event: Event, context: Context
) -> tuple[FilterState, Innovation]:
    """A state by an event of its own time."""
    attitudes, config = context.attitudes, context.config
    match event:
        case NedFix():
            return apply_fix(state, event, context)
        case Displacement(_, motion):
            return apply_displacement(state, motion, context)
        case LateFix(_, fix):
            return apply_fix(state, fix, context, late=True)
        case Exposed():
            return apply_exposure(state, attitudes), Innovation(Verdict.FUSED)
        case Untracked():
            return apply_untracked(state, config), Innovation(Verdict.FUSED)
        case Misled():
            return apply_misled(state, event, config), Innovation(Verdict.FUSED)
        case RangeDoubted(_, drawn_m):
            return range_doubted(state, drawn_m), Innovation(Verdict.FUSED)
        case Recalibrated():
            return apply_recalibrated(state, event, config), Innovation(Verdict.FUSED)
        case MountDoubted(t_s):
            yaw_rad = attitudes.exposure(t_s).yaw_rad - float(state.x[States.HEADING_BIAS])
            return apply_mount_doubted(state, yaw_rad), Innovation(Verdict.FUSED)
        case MapStepped(_, by_m):
            return map_stepped(state, by_m), Innovation(Verdict.FUSED)
        case CameraReturned():
            return apply_camera_returned(state), Innovation(Verdict.FUSED)
        case LensDoubted():
            return apply_lens_doubted(state, config), Innovation(Verdict.FUSED)
        case NewKeyframe():
            return apply_keyframe(state, event, attitudes), Innovation(Verdict.FUSED)
        case Height():
            return apply_height(state, event, config)
        case Range():
            return apply_range(state, event, attitudes, config)
        case Drag():
            return apply_drag(state, context)
        case Stationary():
            return apply_stationary(state, context)


def sensible(event: Told | Attitude | ImuSample) -> bool:
    """Whether its numbers are finite, its covariances positive, and it can be at all."""
    if not math.isfinite(event.t_s):
        return False
    match event:
        case Attitude():
            return is_rotation(event.quat_wxyz)
        case ImuSample():
            return is_felt(event)
        case Height(_, height_m):
            return math.isfinite(height_m)
        case Range(_, distance_m):
            return 0.0 < distance_m < _LARGEST_RANGE_M
        case NedFix():
            return (
                _normal(event.position_ne_m, event.covariance_ne_m2, 2)
                and _normal_or_none(event.yaw_rad, event.sigma_yaw_rad)
                and _normal_or_none(event.agl_m, event.sigma_agl_m)
                and math.isfinite(event.sigma_tilt_rad)
                and math.isfinite(event.sigma_map_m)
            )
        case Displacement(_, way):
            return (
                way.t0_s < way.t1_s
                and math.isfinite(way.t0_s)
                and _normal(way.displacement_ned_m, way.covariance_ned_m2, 3)
                and _normal_or_none(way.yaw_increment_rad, way.sigma_yaw_rad)
                and math.isfinite(way.agl_m)
                and way.agl_m > 0.0
                and 0.0 <= way.tilt_share <= 1.0
                and math.isfinite(way.tilts_along)
                and (way.tilts_turned is None or bool(np.all(np.isfinite(way.tilts_turned))))
                and (
                    way.slope_ne is None
                    or (
                        way.slope_covariance is not None
                        and _normal(way.slope_ne, way.slope_covariance, 2)
                    )
                )
            )
        case _:
            return True


def outside(state: FilterState, config: EkfConfig) -> str | None:
    """Why a state cannot be that of an aircraft; None while it can."""
    x, P = state.x, state.P
    is_finite = math.isfinite(float(x.sum())) and math.isfinite(float(P.sum()))
    if not is_finite or P.diagonal().min() < 0.0:
        return "it is not finite"
    north, east, down = x[States.VELOCITY].tolist()
    if math.hypot(north, east) > config.most_speed_m_s:
        return f"{math.hypot(north, east):.0f} m/s"
    if abs(down) > config.most_climb_m_s:
        return f"{-down:.0f} m/s of climb"
    tilt_rad = math.hypot(*x[States.TILT].tolist())
    if tilt_rad > config.most_tilt_rad:
        return f"the attitude off by {math.degrees(tilt_rad):.0f} degrees of tilt"
    return None


def _normal(mean: Array, covariance: Array, n: int) -> bool:
    """Whether it is a finite (n,) with a symmetric, positive definite covariance (n, n)."""
    if np.shape(mean) != (n,) or np.shape(covariance) != (n, n):
        return False
    if not (np.all(np.isfinite(mean)) and np.all(np.isfinite(covariance))):
        return False
    scale = float(np.max(np.abs(covariance)))
    if scale > 1e12 or np.max(np.abs(covariance - covariance.T)) > 1e-6 * scale:
        return False
    return bool(np.linalg.eigvalsh(covariance)[0] > 1e-12 * max(scale, 1e-6))


def _normal_or_none(value: float | None, sigma: float | None) -> bool:
    if value is None:
        return True
    return math.isfinite(value) and sigma is not None and 1e-9 < sigma < 1e6
