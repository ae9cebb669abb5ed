"""What explains fixes that are refused in a row: a history told anew in which all are right."""

import math
from typing import Protocol, Self, TypeVar

import numpy as np

from vwnav.estimation.beginning.mount import LEAST_TILT_RAD
from vwnav.estimation.disputes import agreeing
from vwnav.estimation.events import Event, MapStepped, MountDoubted
from vwnav.estimation.inertial.attitudes import AttitudeHistory
from vwnav.estimation.states import FilterState, States, Verdict
from vwnav.geometry.rotations import wrap_pi
from vwnav.types import Array

_TILTED_WORDS = "the camera hangs otherwise than its mount_rpy_deg says: the map tells how"
_STEPPED_WORDS = "the map steps by {:.1f} m here; which of its two pieces is right nothing tells"
_STEPPED, _TILTED = 2, 3  # refused fixes in a row that show the one or the other
_TURNED_RAD = math.radians(10.0)  # within the history
_EXPLAINED = 2  # fixes in the history, at least
_REFUSED_DATED = 6  # where these lie as far behind as the aircraft flies in such a time ...
_TILTED_LATE_S, _STEPPED_LATE_S = (0.2, 0.7), (0.1, 1.0)
_TILTED_BESIDE, _STEPPED_BESIDE = 0.3, 0.7  # ... and beside its way by less than that share
_MOST_STEP_M = 6.0  # between two pieces of a map: by more it is another place
_FOLLOWED_S = 1.0  # since the last image that was, at most: its exposure hunts, or it is frozen
_JUST_BEFORE_S = 2.0  # the last fix that was believed: a place that has drifted since is no step


class FixHistory(Protocol):
    """The last seconds of a filter: `vwnav.estimation.timeline.Timeline`."""

    oldest: FilterState
    newest: FilterState

    def followed_since(self, t_s: float) -> bool:
        """Whether images told ways from then on, in the history, and all were believed."""
        ...

    def told_anew(self, event: Event) -> tuple[Self, list[Verdict]]:
        """Another one, in which an event was too, and what becomes of the fixes after it then."""
        ...


_H = TypeVar("_H", bound=FixHistory)


def explained(history: _H, attitudes: AttitudeHistory) -> tuple[_H, str] | None:
    """The history in which the fixes that were refused in a row are right, and why, in words.

    The camera hangs otherwise, where that is by much; else the map steps. None where neither makes
    all of them right, or they are few: on a starved machine some are refused for other reasons.
    Where they lie behind as those of pictures that are dated wrongly do, it takes longer: ways tell
    that meanwhile.
    """
    rejected = history.newest.rejected_fixes
    if len(rejected) < _STEPPED:
        return None
    off_m = np.mean([each.residual for each in rejected], axis=0)
    velocity_m_s, is_told = history.newest.x[States.VELOCITY_NE], len(rejected) >= _REFUSED_DATED
    no_tilt = _is_behind(off_m, velocity_m_s, _TILTED_LATE_S, _TILTED_BESIDE) and not is_told
    no_step = _is_behind(off_m, velocity_m_s, _STEPPED_LATE_S, _STEPPED_BESIDE) and not is_told
    since_s, by_m = max(rejected[0].t_s, history.oldest.t_s), math.hypot(*off_m)
    may_be_tilt = _may_be_tilt(history, by_m, attitudes)
    if may_be_tilt and len(rejected) >= _TILTED and not no_tilt:
        tilted = _told_anew(history, MountDoubted(since_s))
        if tilted is not None and np.hypot(*tilted.newest.x[States.CAMERA_TILT]) > LEAST_TILT_RAD:
            return tilted, _TILTED_WORDS
    waits = no_step or (may_be_tilt and len(rejected) <= _TILTED)
    if waits or by_m > _MOST_STEP_M or not _is_sudden(history.newest):
        return None
    stepped = _told_anew(history, MapStepped(since_s, by_m))
    return None if stepped is None else (stepped, _STEPPED_WORDS.format(by_m))


def _may_be_tilt(history: FixHistory, by_m: float, attitudes: AttitudeHistory) -> bool:
    """Whether a camera that hangs otherwise by much may show places so far off.

    Images that are followed on and on show that nothing has knocked it, and one that was bent
    before shows it where the heading is another. One that was knocked is followed again at once.
    """
    newest, believed_s = history.newest, history.newest.t_last_fix_s
    unseen = newest.anchor is not None and newest.t_s - newest.tracked_s > _FOLLOWED_S
    if unseen or by_m < LEAST_TILT_RAD * newest.agl_m:
        return False
    then, now = (attitudes.exposure(t_s).yaw_rad for t_s in (history.oldest.t_s, newest.t_s))
    turned = abs(wrap_pi(now - then)) > _TURNED_RAD
    return turned or believed_s is None or not history.followed_since(believed_s)


def _is_sudden(state: FilterState) -> bool:
    """Whether refused fixes want the same, and one shortly before them was believed."""
    rejected, believed_s = state.rejected_fixes, state.t_last_fix_s
    if believed_s is None or rejected[0].t_s - believed_s > _JUST_BEFORE_S:
        return False
    return len(agreeing(rejected, 0.0)) == len(rejected)


def _told_anew(history: _H, event: MountDoubted | MapStepped) -> _H | None:
    """As if the event had been before the fixes; None where one of them is refused yet."""
    other, verdicts = history.told_anew(event)
    is_right = all(verdict is Verdict.FUSED for verdict in verdicts)
    return other if len(verdicts) >= _EXPLAINED and is_right else None


def _is_behind(
    off_m: Array, velocity_m_s: Array, late_s: tuple[float, float], most_beside: float
) -> bool:
    """Whether (2,) is behind the aircraft by as much as it flies while a late picture comes."""
    behind_s = -float(off_m @ velocity_m_s) / max(float(velocity_m_s @ velocity_m_s), 1.0)
    beside_m = math.hypot(*(off_m + behind_s * velocity_m_s))
    return late_s[0] < behind_s < late_s[1] and beside_m < most_beside * math.hypot(*off_m)
