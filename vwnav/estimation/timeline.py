"""What may happen to the filter, and the last seconds of it in order of time.

Every measurement is applied at its own time; one that comes late goes where it belongs, and what
came after it is applied again.
"""

import bisect
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from vwnav.estimation.kalman import Innovation, Verdict
from vwnav.estimation.states import FilterState, States
from vwnav.geometry.rotations import wrap_pi
from vwnav.types import Array, Height, OdometryMotion, Range, Stationary


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NedFix:
    """A map fix in the filter's own frame.

    Attributes:
        t_s: exposure of the image.
        position_ne_m: (2,) north and east of the camera. covariance_ne_m2: (2, 2).
        yaw_rad: true heading; None when the fix has none. agl_m: likewise.
        sigma_tilt_rad: the attitude error that `covariance_ne_m2` contains. It moves the fix by
            AGL times tilt, slowly: the filter carries it as a state, so it is taken out.
        sigma_map_m: likewise what all fixes of a place share: the map's own error.
    """

    t_s: float
    position_ne_m: Array
    covariance_ne_m2: Array
    yaw_rad: float | None = None
    sigma_yaw_rad: float | None = None
    agl_m: float | None = None
    sigma_agl_m: float | None = None
    sigma_tilt_rad: float = 0.0
    sigma_map_m: float = 0.0

    def sensible(self) -> bool:
        """Whether every number is finite and every covariance positive."""
        return (
            math.isfinite(self.t_s)
            and np.shape(self.position_ne_m) == (2,)
            and bool(np.all(np.isfinite(self.position_ne_m)))
            and is_covariance(self.covariance_ne_m2, 2)
            and _pair_sensible(self.yaw_rad, self.sigma_yaw_rad)
            and _pair_sensible(self.agl_m, self.sigma_agl_m)
            and math.isfinite(self.sigma_tilt_rad)
            and math.isfinite(self.sigma_map_m)
        )


@dataclass(frozen=True, slots=True, eq=False)
class Displacement:
    """Odometry between its keyframe and an image, at that image's exposure."""

    t_s: float
    motion: OdometryMotion

    def sensible(self) -> bool:
        """Whether it is finite, forward in time, and its covariances are positive."""
        m = self.motion
        return (
            math.isfinite(m.t0_s)
            and math.isfinite(m.t1_s)
            and m.t1_s > m.t0_s
            and np.shape(m.displacement_ned_m) == (3,)
            and bool(np.all(np.isfinite(m.displacement_ned_m)))
            and is_covariance(m.covariance_ned_m2, 3)
            and _pair_sensible(m.yaw_increment_rad, m.sigma_yaw_rad)
            and math.isfinite(m.agl_m)
            and m.agl_m > 0.0
            and 0.0 <= m.tilt_share <= 1.0
            and math.isfinite(m.tilts_along)
        )


def between(before: OdometryMotion, after: OdometryMotion) -> OdometryMotion:
    """The way from one image to a later one that were both compared with the same keyframe.

    For a keyframe that the filter has forgotten: over a spot where nothing changes odometry keeps
    it for minutes, and a filter that begins anew meanwhile would have no ways at all.
    """
    return replace(
        after,
        t0_s=before.t1_s,
        displacement_ned_m=after.displacement_ned_m - before.displacement_ned_m,
        covariance_ned_m2=after.covariance_ned_m2 + before.covariance_ned_m2,
        yaw_increment_rad=wrap_pi(after.yaw_increment_rad - before.yaw_increment_rad),
        sigma_yaw_rad=math.hypot(after.sigma_yaw_rad, before.sigma_yaw_rad),
    )


@dataclass(frozen=True, slots=True, eq=False)
class NewKeyframe:
    """Odometry starts a keyframe: the position is cloned.

    The clone is where the keyframe *seems* to have been taken: `covariance_ned_m2` and
    `sigma_yaw_rad` are what the keyframe itself adds to every displacement measured from it.
    """

    t_s: float
    covariance_ned_m2: Array
    sigma_yaw_rad: float


@dataclass(frozen=True, slots=True)
class Exposed:
    """An image was taken that is now being matched to the map: its pose is cloned.

    However long the search takes, its fix meets the clone.
    """

    t_s: float

    def sensible(self) -> bool:
        """Whether the time is finite."""
        return math.isfinite(self.t_s)


@dataclass(frozen=True, slots=True)
class Untracked:
    """An image of a video alone could not be followed: how it came there nobody knows."""

    t_s: float

    def sensible(self) -> bool:
        """Whether the time is finite."""
        return math.isfinite(self.t_s)


@dataclass(frozen=True, slots=True, eq=False)
class LateFix:
    """The fix of the image whose pose is cloned, older than the history that begins at `t_s`."""

    t_s: float
    fix: NedFix


@dataclass(frozen=True, slots=True)
class Drag:
    """The IMU has felt for a while what the air does to the aircraft."""

    t_s: float


@dataclass(frozen=True, slots=True)
class Misled:
    """The ways that images told since then were not the aircraft's, and no fix had said so."""

    t_s: float
    since_s: float


Told = NedFix | Height | Range | Stationary | Displacement | Exposed | Untracked
Event = Told | NewKeyframe | LateFix | Drag | Misled  # the others are the filter's own

# Order of events at the same time; clones are last, so that they copy what others left.
_ORDER: tuple[type[Event], ...] = (
    Misled, Untracked, LateFix, Stationary, Height, Range, NedFix, Displacement, Drag, NewKeyframe,
    Exposed,
)  # fmt: skip
_RANKS = {kind: rank for rank, kind in enumerate(_ORDER)}


def is_covariance(matrix: Array, n: int) -> bool:
    """Whether it is a finite, symmetric, positive definite matrix (n, n)."""
    if np.shape(matrix) != (n, n) or not np.all(np.isfinite(matrix)):
        return False
    scale = float(np.max(np.abs(matrix)))
    if scale > 1e12 or np.max(np.abs(matrix - matrix.T)) > 1e-6 * scale:
        return False
    return bool(np.linalg.eigvalsh(matrix)[0] > 1e-12 * max(scale, 1e-6))


def _pair_sensible(value: float | None, sigma: float | None) -> bool:
    if value is None:
        return True
    return math.isfinite(value) and sigma is not None and 1e-9 < sigma < 1e6


Apply = Callable[[FilterState, Event], tuple[FilterState, Innovation]]
Order = tuple[float, int]  # time and rank


@dataclass(slots=True)
class _Entry:
    order: Order
    event: Event
    state: FilterState


_order_of = attrgetter("order")


class Timeline:
    """The last seconds of the filter.

    The state is always what it would be had every event come in order: inserting one applies all
    later ones again. But for its `reset_counter`, which others have seen: it never falls, and a
    past that has changed by so much that the newest position jumps counts too.

    Attributes:
        oldest: the state before all events; what is earlier is too late.
        newest: the state after all of them.
    """

    def __init__(self, start: FilterState, apply: Apply, length_s: float, jump_m: float) -> None:
        self.oldest = self.newest = start
        self._apply = apply
        self._length_s = length_s
        self._jump_m = jump_m
        self._entries: list[_Entry] = []

    def keyframe_known(self, t_s: float) -> bool:
        """Whether a keyframe of that time is in the history or in the state before it."""
        anchor = self.oldest.anchor
        if anchor is not None and anchor.t_s == t_s:
            return True
        order = (t_s, _RANKS[NewKeyframe])
        return self._holds(self._place(order), order)

    def insert(self, event: Event) -> Innovation:
        """Apply an event at its time, and everything after it again."""
        if event.t_s < self.oldest.t_s:
            return Innovation(Verdict.TOO_LATE)
        order = (event.t_s, _RANKS[type(event)])
        i = self._place(order)
        if self._holds(i, order):
            return Innovation(Verdict.DUPLICATE)
        state, innovation = self._apply(self._before(i), event)
        self._entries.insert(i, _Entry(order, event, state))
        if i + 1 == len(self._entries):
            self.newest = state
        else:
            self._apply_again(i + 1)
        self._forget()
        return innovation

    def test(self, event: Event) -> Innovation:
        """What `insert` would say of an event, which is left out."""
        if event.t_s < self.oldest.t_s:
            return Innovation(Verdict.TOO_LATE)
        before = self._before(self._place((event.t_s, _RANKS[type(event)])))
        return self._apply(before, event)[1]

    def leave_out(self, *kinds: type[Event]) -> None:
        """As if no event of these kinds had come in the history."""
        self._entries = [entry for entry in self._entries if not isinstance(entry.event, kinds)]
        self._apply_again(0)

    def _apply_again(self, i: int) -> None:
        """The events from `i` on, now that the past is another."""
        told, state = self.newest, self._before(i)
        for entry in self._entries[i:]:
            state, _ = self._apply(state, entry.event)
            entry.state = state
        self.newest = state
        missing = told.reset_counter - state.reset_counter
        if missing >= 0 and _apart_m(told, state) > self._jump_m:
            missing += 1
        if missing > 0:
            self._count(missing)

    def _count(self, resets: int) -> None:
        """As if so many more had been before the history."""
        self.oldest = replace(self.oldest, reset_counter=self.oldest.reset_counter + resets)
        for entry in self._entries:
            state = entry.state
            entry.state = replace(state, reset_counter=state.reset_counter + resets)
        self.newest = self._before(len(self._entries))

    def _place(self, order: Order) -> int:
        return bisect.bisect_left(self._entries, order, key=_order_of)

    def _holds(self, i: int, order: Order) -> bool:
        return i < len(self._entries) and self._entries[i].order == order

    def _before(self, i: int) -> FilterState:
        return self._entries[i - 1].state if i > 0 else self.oldest

    def _forget(self) -> None:
        count = self._place((self.newest.t_s - self._length_s, 0))
        if count > 0:
            self.oldest = self._entries[count - 1].state
            del self._entries[:count]


def _apart_m(told: FilterState, state: FilterState) -> float:
    """Between two newest positions, of which one may be of an earlier moment."""
    flown_m = (state.t_s - told.t_s) * told.x[States.VELOCITY]
    return float(np.linalg.norm((state.x - told.x)[States.POSITION] - flown_m))
