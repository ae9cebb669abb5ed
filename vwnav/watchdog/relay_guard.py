"""The watchdog's guard over estimates that pass, by what the messages carry.

A navigator that slept, or filtered through a gap, streams what it made up meanwhile; an autopilot
would chase it. The bounds are a little wider than those of `EstimateGuard` at the navigator's own
exit, so that the navigator trips first and knows why.
"""

import math
from dataclasses import dataclass

from vwnav.safety.estimate_track import Track, Trial


@dataclass(frozen=True, slots=True, kw_only=True)
class RelayLimits:
    """As `EstimateLimits`, a little wider.

    Attributes:
        brief_gap_s: the navigator's own brief gap, and the time it waits until it is steady.
        wide_position_sigma_m: of a new one that comes with a velocity, `new_velocity_sigma_m_s`
            sure and off the way of its positions by at most `velocity_off_m_s`.
        steady_s: for how long estimates come steadily before they are handed on again, and
            between two jumps that are announced.
        fewest: estimates in that time.
    """

    max_age_s: float = 0.3
    max_speed_m_s: float = 35.0
    max_jump_m: float = 4.0
    max_gap_s: float = 0.5
    brief_gap_s: float = 2.0
    drift_m_s: float = 2.5
    new_position_sigma_m: float = 6.0
    wide_position_sigma_m: float = 65.0
    new_velocity_sigma_m_s: float = 2.0
    velocity_off_m_s: float = 4.0
    steady_s: float = 0.3
    fewest: int = 5


@dataclass(frozen=True, slots=True)
class RelayedPosition:
    """What VISION_POSITION_ESTIMATE and ODOMETRY say: NED about the autopilot's origin.

    Attributes:
        t_s: on the clock of this machine.
        sigma_m: the larger horizontal one.
    """

    t_s: float
    position_ned_m: tuple[float, float, float]
    sigma_m: float
    reset_counter: int


@dataclass(frozen=True, slots=True)
class RelayedVelocity:
    """What VISION_SPEED_ESTIMATE and ODOMETRY say; `sigma_m_s` is the larger horizontal one."""

    t_s: float
    velocity_ned_m_s: tuple[float, float, float]
    sigma_m_s: float


class RelayGuard:
    """The watchdog's, over messages that pass: true means that one may be handed on.

    Args:
        limits: what may pass.

    Attributes:
        last: the position handed on last.
        lost_since_s: since when none is; None while they pass.
        reason: why.
    """

    def __init__(self, limits: RelayLimits | None = None) -> None:
        self._limits = limits if limits is not None else RelayLimits()
        self._track = self._new_track()
        self._trial: Trial | None = None
        self._may_resume = False
        self._jumped_t_s = -math.inf
        self._velocity: RelayedVelocity | None = None
        self.last: RelayedPosition | None = None
        self.lost_since_s: float | None = None
        self.reason = ""

    @property
    def velocity_ne_m_s(self) -> tuple[float, float]:
        """North and east, from the positions of the last second that were handed on."""
        return self._track.velocity_m_s()

    def admit_position(self, position: RelayedPosition, t_s: float, armed: bool) -> bool:
        """Whether this one may pass now; disarmed on the ground it may jump."""
        if not self._is_of_now(position, t_s):
            return False
        numbers = (*position.position_ned_m, position.sigma_m)
        fault = None if all(map(math.isfinite, numbers)) else "a position that is not finite"
        if not armed:
            return self._on_ground(position, fault)
        if self.lost_since_s is None:
            gap_s = position.t_s - self.last.t_s if self.last is not None else math.inf
            broken = fault or self._break(position, gap_s)
            if broken is None:
                return self._pass(position)
            self.lose(broken, t_s)
            self._may_resume = self._limits.max_gap_s < gap_s <= self._limits.brief_gap_s
        return self._try(position, fault, t_s)

    def admit_velocity(self, velocity: RelayedVelocity, t_s: float) -> bool:
        """Whether this one may pass now; one that cannot be takes the positions with it."""
        return self._is_possible(velocity, t_s) and self.lost_since_s is None

    def admit_both(
        self, position: RelayedPosition, velocity: RelayedVelocity, t_s: float, armed: bool
    ) -> bool:
        """Whether a message that tells both may pass now."""
        return self._is_possible(velocity, t_s) and self.admit_position(position, t_s, armed)

    def _is_possible(self, velocity: RelayedVelocity, t_s: float) -> bool:
        numbers = (velocity.t_s, *velocity.velocity_ned_m_s)
        is_finite = all(map(math.isfinite, numbers))
        speed_m_s = math.hypot(*velocity.velocity_ned_m_s[:2])
        if not is_finite or speed_m_s > self._limits.max_speed_m_s:
            self._velocity = None
            if self.lost_since_s is None:
                what = f"of {speed_m_s:.0f} m/s" if is_finite else "that is not finite"
                self.lose(f"a velocity {what}", t_s)
            return False
        is_of_now = abs(t_s - velocity.t_s) <= self._limits.max_age_s
        if is_of_now:
            self._velocity = velocity
        return is_of_now

    def lose(self, reason: str, t_s: float) -> None:
        """Hand nothing more on until it comes as a new one."""
        if self.lost_since_s is None:
            self.lost_since_s = t_s
        self.reason, self._trial, self._may_resume = reason, None, False

    def _is_of_now(self, position: RelayedPosition, t_s: float) -> bool:
        """One that is late is left out; if that goes on, the gap makes it lost."""
        if not abs(t_s - position.t_s) <= self._limits.max_age_s:
            return False
        return self.last is None or position.t_s >= self.last.t_s

    def _break(self, position: RelayedPosition, gap_s: float) -> str | None:
        last = self.last
        if last is None:
            return "no position was handed on yet"
        if gap_s > self._limits.max_gap_s:
            return f"no position for {gap_s:.1f} s"
        if position.reset_counter != last.reset_counter:
            if position.t_s - self._jumped_t_s < self._limits.steady_s:
                return "the position jumps again and again"
            self._track.clear()
            stays_wide = self._unsure(last) is not None and self._has_velocity(position)
            return None if stays_wide else self._unsure(position)
        if self._track.jumped(*_place(position)):
            return "the position jumped"
        return None

    def _unsure(self, position: RelayedPosition) -> str | None:
        if position.sigma_m > self._limits.new_position_sigma_m:
            return f"the new position is uncertain by {position.sigma_m:.0f} m"
        return None

    def _is_wide(self, position: RelayedPosition, trial: Trial) -> bool:
        """Its place is unsure, but how it moves is not, and its positions move so."""
        if not self._has_velocity(position):
            return False
        assert self._velocity is not None
        off_m_s = math.dist(trial.track.velocity_m_s(), self._velocity.velocity_ned_m_s[:2])
        return off_m_s <= self._limits.velocity_off_m_s

    def _has_velocity(self, position: RelayedPosition) -> bool:
        """How it moves is told, and sure, and its place not beyond all measure."""
        limits, velocity = self._limits, self._velocity
        if velocity is None or position.t_s - velocity.t_s > limits.steady_s:
            return False
        is_sure = velocity.sigma_m_s <= limits.new_velocity_sigma_m_s
        return is_sure and position.sigma_m <= limits.wide_position_sigma_m

    def _on_ground(self, position: RelayedPosition, fault: str | None) -> bool:
        self.lost_since_s, self._trial = None, None
        self._track.clear()
        if fault is not None:
            self.reason = fault
            return False
        return self._pass(position)

    def _pass(self, position: RelayedPosition) -> bool:
        self.lost_since_s, self._trial, self.reason = None, None, ""
        if self.last is not None and position.reset_counter != self.last.reset_counter:
            self._jumped_t_s = position.t_s
        self.last = position
        self._track.add(*_place(position))
        return True

    def _try(self, position: RelayedPosition, fault: str | None, t_s: float) -> bool:
        if fault is not None:
            self._trial, self._may_resume = None, False
            return False
        trial, place = self._trial, _place(position)
        gap_s = self._limits.max_gap_s
        if (
            trial is None
            or position.reset_counter != trial.counter
            or trial.track.jumped(*place)
            or trial.track.silent_s(position.t_s) > gap_s
        ):
            resume = trial is None and self._may_resume
            self._trial = trial = Trial(t_s, position.reset_counter, self._new_track(), resume)
        trial.track.add(*place)
        trial.count += 1
        if t_s - trial.since_s < self._limits.steady_s or trial.count < self._limits.fewest:
            return False
        if not (self._is_new(position, trial) or self._goes_on(trial, position)):
            return False
        self._track.clear()
        return self._pass(position)

    def _is_new(self, position: RelayedPosition, trial: Trial) -> bool:
        is_renewed = self.last is None or position.reset_counter != self.last.reset_counter
        return is_renewed and (self._unsure(position) is None or self._is_wide(position, trial))

    def _goes_on(self, trial: Trial, position: RelayedPosition) -> bool:
        """After a brief gap: the same one, about where it would be by now. Asked once."""
        last = self.last
        if not trial.may_resume or last is None or position.reset_counter != last.reset_counter:
            return False
        trial.may_resume = False
        span_s = position.t_s - last.t_s
        north_m, east_m = (
            last.position_ned_m[i] + v * span_s for i, v in enumerate(self.velocity_ne_m_s)
        )
        _, now_north_m, now_east_m = _place(position)
        off_m = math.hypot(now_north_m - north_m, now_east_m - east_m)
        allowed_m = self._limits.max_jump_m + self._limits.drift_m_s * span_s
        return not self._track.jumped(*_place(position)) and off_m <= allowed_m

    def _new_track(self) -> Track:
        return Track(self._limits.max_speed_m_s, self._limits.max_jump_m)


def _place(position: RelayedPosition) -> tuple[float, float, float]:
    return position.t_s, position.position_ned_m[0], position.position_ned_m[1]
