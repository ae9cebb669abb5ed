"""Which estimates an autopilot may be given: none that we would not fly on ourselves.

An autopilot chases whatever it is told. One that has lost its position comes down level by itself
when estimates stop; one that follows a runaway estimate flies away. So what was lost comes back
only as a new estimate, with another reset counter: after several fixes that agree, or, where a gap
is all that was wrong with it, as soon as its velocity is sure again, with a place that is told as
unproven.

`EstimateGuard` stands at the navigator's exit; `relay_guard` stands in the watchdog.
"""

import math
from dataclasses import replace

import numpy as np

from vwnav.safety.estimate_track import Track, Trial, at_least, is_finite, sigma, tilt_rad
from vwnav.safety.safety_config import EstimateLimits
from vwnav.types import Estimate

_VELOCITY_LOST = "the estimate's velocity is lost"
_WITHIN_SIGMAS, _SURER = 2.0, 0.7  # of a jump to where it settles
_RESTLESS = "the estimate jumps again and again"


class EstimateGuard:
    """The navigator's: every estimate on its way to the autopilot goes through `admit`.

    Args:
        limits: the bounds.
        first_counter: added to the reset counter; a navigator that continues another one's
            flight hands the last counter in that was sent, and comes as a new estimate.

    Attributes:
        lost_since_s: since when nothing is sent in flight; None while estimates are sent.
        reason: why that is so, or why nothing was sent last.
    """

    def __init__(self, limits: EstimateLimits | None = None, first_counter: int = 0) -> None:
        self._limits = limits if limits is not None else EstimateLimits()
        self._renewals = first_counter
        self._last: Estimate | None = None
        self._jumped_t_s = -math.inf
        self._held_back_since_s = math.inf
        self._track = self._new_track()
        self._trial: Trial | None = None
        self._unproven: Trial | None = None
        self._may_resume = self._only_missed = self._had_no_velocity = False
        self.lost_since_s: float | None = None
        self.reason = ""

    def admit(
        self,
        estimate: Estimate | None,
        t_s: float,
        armed: bool = True,
        seen_s: float | None = None,
    ) -> Estimate | None:
        """The estimate as it is to be sent, with its own reset counter; None to send nothing.

        Args:
            estimate: the filter's, None where it has none.
            t_s: now; to be called at every turn of the sending loop.
            armed: on the ground, disarmed, nothing flies on it: it may jump and come back freely.
            seen_s: exposure of the last image that told a motion or a place, None before one did.
        """
        if estimate is None or not self._is_of_now(estimate, t_s):
            self._miss(t_s, armed)
            return None
        fault = self._fault(estimate)
        if not armed:
            return self._on_ground(estimate, fault)
        if self.lost_since_s is None:
            gap_s = estimate.t_s - self._last.t_s if self._last is not None else math.inf
            broken = fault or self._break(estimate, gap_s)
            if broken is None:
                return self._sent(self._with_proof(estimate, t_s))
            self.lose(broken, t_s)
            self._may_resume = gap_s > self._limits.max_gap_s or broken == _VELOCITY_LOST
            is_found = self._unproven is not None or self._settles(estimate)  # by a fix
            self._only_missed = self._may_resume or (is_found and broken == _RESTLESS)
            self._had_no_velocity = broken == _VELOCITY_LOST
        return self._try(estimate, fault, t_s, seen_s)

    def lose(self, reason: str, t_s: float) -> None:
        """Send nothing more until fixes have shown a new estimate; for what only the caller knows.

        A watchdog that does not hand the estimates on has found something wrong with them.
        """
        if self.lost_since_s is None:
            self.lost_since_s, self._only_missed, self._had_no_velocity = t_s, False, False
        self.reason, self._trial, self._may_resume = reason, None, False

    def follow_relay(self, hands_on: bool, t_s: float) -> None:
        """A new one counts from when the watchdog hands it on, which looks at it for a while."""
        if hands_on or self.lost_since_s is not None:
            self._held_back_since_s = math.inf
            return
        self._jumped_t_s = max(self._jumped_t_s, t_s)
        self._held_back_since_s = min(self._held_back_since_s, t_s)
        if t_s - self._held_back_since_s > self._limits.held_back_s:
            self.lose("the watchdog does not hand it on", t_s)

    def miss(self, reason: str, t_s: float) -> None:
        """Likewise for a gap, which is all that is wrong: its velocity brings it back sooner."""
        is_new = self.lost_since_s is None
        self.lose(reason, t_s)
        self._only_missed = self._only_missed or is_new

    def _is_of_now(self, estimate: Estimate, t_s: float) -> bool:
        """One that is late is left out; if that goes on, the gap makes it lost."""
        is_fresh = abs(t_s - estimate.t_s) <= self._limits.max_age_s
        return is_fresh and (self._last is None or estimate.t_s >= self._last.t_s)

    def _miss(self, t_s: float, armed: bool) -> None:
        """None of now: lost, once it has lasted too long to go on as the same."""
        since_s = self._last.t_s if self._last is not None else -math.inf
        if armed and self.lost_since_s is None and t_s - since_s > self._limits.brief_gap_s:
            self.miss("there is no estimate of now", t_s)

    def _fault(self, estimate: Estimate) -> str | None:
        """What is wrong with it, by itself."""
        limits = self._limits
        if not is_finite(estimate):
            return "the estimate is not finite"
        speed_m_s = float(np.hypot(*estimate.velocity_ned_m_s[:2]))
        if not speed_m_s < limits.max_speed_m_s:
            return f"the estimate moves at {speed_m_s:.0f} m/s"
        if not tilt_rad(estimate.quat_wxyz) <= limits.max_tilt_rad:
            return "the estimate is tilted beyond what an aircraft flies"
        if not sigma(estimate, 3) < limits.max_velocity_sigma_m_s:
            return _VELOCITY_LOST
        sigma_m = sigma(estimate, 0)
        stands = estimate.t_last_fix_s is None and self._unproven is None
        if not stands and not sigma_m < limits.max_position_sigma_m:
            return f"the estimate's position is uncertain by {sigma_m:.0f} m"
        return None

    def _unsure(self, estimate: Estimate) -> str | None:
        """What keeps it from being a new one."""
        sigma_m = sigma(estimate, 0)
        if sigma_m > self._limits.new_position_sigma_m:
            return f"the estimate's position is uncertain by {sigma_m:.0f} m"
        return self._unsure_velocity(estimate)

    def _unsure_velocity(self, estimate: Estimate) -> str | None:
        sigma_m_s = sigma(estimate, 3)
        if sigma_m_s > self._limits.new_velocity_sigma_m_s:
            return f"the estimate's velocity is uncertain by {sigma_m_s:.1f} m/s"
        return None

    def _break(self, estimate: Estimate, gap_s: float) -> str | None:
        """What does not fit those before it."""
        if self._last is None:
            return "there is no estimate yet that was flown on"
        if gap_s > self._limits.max_gap_s:
            return f"there was no estimate for {gap_s:.1f} s"
        if estimate.reset_counter != self._last.reset_counter:
            if estimate.t_s - self._jumped_t_s < self._limits.steady_s:
                return _RESTLESS
            self._track.clear()
            return self._take_jump(estimate, self._last)
        if self._track.jumped(estimate.t_s, *_north_east(estimate)):
            return "the estimate jumped"
        if self._velocity_jumped(estimate, self._last):
            return "the estimate's velocity jumped"
        return None

    def _take_jump(self, estimate: Estimate, before: Estimate) -> str | None:
        """Why it is lost by one; wide, it may move in what it had said, by a fix as unproven."""
        moved_m = float(np.hypot(*(estimate.position_ned_m - before.position_ned_m)[:2]))
        is_wide = self._unproven is not None or moved_m <= sigma(before, 0)
        unsure = self._unsure(estimate)
        if unsure is None or not is_wide:
            return unsure
        unsure, by_fix = self._unsure_velocity(estimate), estimate.t_last_fix_s
        if unsure is None and self._unproven is None and by_fix != before.t_last_fix_s:
            t_s, counter = estimate.t_s, estimate.reset_counter
            self._unproven = Trial(t_s, counter, self._new_track(), False, fixes_from_s=t_s)
        return unsure

    def _settles(self, estimate: Estimate) -> bool:
        """Whether it stays within what the one before had said, and its place is much surer."""
        if (before := self._last) is None:
            return False
        moved_m = math.dist(_north_east(estimate), _north_east(before))
        within_m = _WITHIN_SIGMAS * sigma(before, 0)
        return moved_m <= within_m and sigma(estimate, 0) <= _SURER * sigma(before, 0)

    def _velocity_jumped(self, estimate: Estimate, before: Estimate) -> bool:
        step_m_s = estimate.velocity_ned_m_s[:2] - before.velocity_ned_m_s[:2]
        return float(np.hypot(*step_m_s)) > self._limits.max_velocity_jump_m_s

    def _on_ground(self, estimate: Estimate, fault: str | None) -> Estimate | None:
        self.lost_since_s, self._trial, self._unproven = None, None, None
        self._track.clear()
        if fault is not None:
            self.reason, self._last = fault, None
            return None
        return self._sent(estimate)

    def _sent(self, estimate: Estimate) -> Estimate:
        self.lost_since_s, self._trial, self.reason = None, None, ""
        if self._last is not None and estimate.reset_counter != self._last.reset_counter:
            self._jumped_t_s = max(self._jumped_t_s, estimate.t_s)
        self._last = estimate
        self._track.add(estimate.t_s, *_north_east(estimate))
        return replace(estimate, reset_counter=estimate.reset_counter + self._renewals)

    def _try(
        self, estimate: Estimate, fault: str | None, t_s: float, seen_s: float | None
    ) -> Estimate | None:
        """Watch a lost estimate; it comes back as a new one, or as the same after a brief gap."""
        if fault is not None:
            self._trial = None
            self._had_no_velocity = self._had_no_velocity or fault == _VELOCITY_LOST
            self._only_missed = self._only_missed and fault == _VELOCITY_LOST
            self._may_resume = self._may_resume and fault == _VELOCITY_LOST
            return None
        place = (estimate.t_s, *_north_east(estimate))
        trial = self._trial
        if trial is None or estimate.reset_counter != trial.counter or trial.track.jumped(*place):
            last_s = self._last.t_s if self._last is not None else -math.inf
            is_brief = estimate.t_s - last_s <= self._limits.brief_gap_s
            resume = trial is None and self._may_resume and is_brief
            assert self.lost_since_s is not None
            counter = estimate.reset_counter
            trial = Trial(t_s, counter, self._new_track(), resume, self.lost_since_s)
            self._trial = trial
        trial.track.add(*place)
        self._count_fix(trial, estimate)
        if self._goes_on(trial, estimate, t_s):
            return self._sent(self._with_proof(estimate, t_s))
        self._watch_velocity(trial, estimate, seen_s)
        is_proven = self._unsure(estimate) is None and self._is_proven(trial, t_s)
        if is_proven or self._has_velocity(trial, estimate):
            self._renew(estimate)
            self._unproven = None if is_proven else trial
            return self._sent(self._with_proof(estimate, t_s))
        return None

    def _renew(self, estimate: Estimate) -> None:
        self._renewals += 1
        self._jumped_t_s = estimate.t_s
        self._track.clear()

    def _with_proof(self, estimate: Estimate, t_s: float) -> Estimate:
        """As it is once fixes have shown it, another new one then; until then a wide one."""
        trial = self._unproven
        if trial is None:
            return estimate
        self._count_fix(trial, estimate)
        is_steady = estimate.t_s - self._jumped_t_s >= self._limits.steady_s
        if is_steady and self._unsure(estimate) is None and self._is_proven(trial, t_s):
            self._unproven = None
            self._renew(estimate)
            return estimate
        return at_least(estimate, self._limits.unproven_sigma_m)

    def _count_fix(self, trial: Trial, estimate: Estimate) -> None:
        t_fix_s = estimate.t_last_fix_s
        is_new = t_fix_s is not None and t_fix_s >= trial.fixes_from_s
        if is_new and t_fix_s not in trial.fixes_t_s[-1:]:
            assert t_fix_s is not None
            trial.fixes_t_s.append(t_fix_s)

    def _is_proven(self, trial: Trial, t_s: float) -> bool:
        fixes_t_s, limits = trial.fixes_t_s, self._limits
        if len(fixes_t_s) < limits.new_fixes or t_s - trial.since_s < limits.new_fixes_s:
            return False
        return fixes_t_s[-1] - fixes_t_s[0] >= limits.new_fixes_s

    def _watch_velocity(self, trial: Trial, estimate: Estimate, seen_s: float | None) -> None:
        """Since when it has been measured, sure, and the same from one to the next.

        Seen by images since it was lost. One that was not sure meanwhile, and is so again, has
        been measured too: by the air that the accelerometer feels.
        """
        before, trial.before = trial.before, estimate
        jumped = before is not None and self._velocity_jumped(estimate, before)
        oldest_s = max(trial.fixes_from_s, estimate.t_s - self._limits.max_gap_s)
        self._had_no_velocity |= self._unsure_velocity(estimate) is not None
        is_measured = self._had_no_velocity or (seen_s is not None and seen_s >= oldest_s)
        if not is_measured or self._unsure_velocity(estimate):
            trial.velocity_since_s = None
        elif trial.velocity_since_s is None or jumped:
            trial.velocity_since_s = estimate.t_s

    def _has_velocity(self, trial: Trial, estimate: Estimate) -> bool:
        """It was only missed, and how it moves has been sure for a while."""
        limits, since_s = self._limits, trial.velocity_since_s
        if not self._only_missed or since_s is None:
            return False
        is_steady = estimate.t_s - since_s >= limits.unproven_s
        return is_steady and sigma(estimate, 0) < limits.max_position_sigma_m

    def _goes_on(self, trial: Trial, estimate: Estimate, t_s: float) -> bool:
        """After a brief stall: steady again, and where it would be by now. Asked once."""
        last = self._last
        if not trial.may_resume or last is None or t_s - trial.since_s < self._limits.settle_s:
            return False
        trial.may_resume = False
        if estimate.reset_counter != last.reset_counter:
            return False
        span_s = estimate.t_s - last.t_s
        expected_ne_m = last.position_ned_m[:2] + last.velocity_ned_m_s[:2] * span_s
        off_m = float(np.hypot(*(estimate.position_ned_m[:2] - expected_ne_m)))
        jumped = self._track.jumped(estimate.t_s, *_north_east(estimate))
        return not jumped and off_m <= self._drift_m(span_s)

    def _drift_m(self, span_s: float) -> float:
        return self._limits.max_jump_m + self._limits.settle_drift_m_s * span_s

    def _new_track(self) -> Track:
        return Track(self._limits.max_speed_m_s, self._limits.max_jump_m)


def _north_east(estimate: Estimate) -> tuple[float, float]:
    return float(estimate.position_ned_m[0]), float(estimate.position_ned_m[1])
