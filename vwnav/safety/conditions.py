"""What the safety monitor watches: the pilot, the link, the battery, the camera, the position."""

import math

import numpy as np

from vwnav.safety.safety_config import SafetyConfig
from vwnav.safety.situation import BatteryLevel
from vwnav.types import Estimate
from vwnav.vehicle import FlightMode, VehicleState

# Modes in which nobody else has taken over, by how far we have got.
_TAKING_OFF = frozenset({FlightMode.TAKEOFF, FlightMode.HOLD, FlightMode.OFFBOARD})
_TAKING_OFF_ONLY = _TAKING_OFF - {FlightMode.HOLD}
_STEERING = frozenset({FlightMode.OFFBOARD})
# No end of a take-off but a failsafe: PX4 waits in Hold before it returns.
_HELD_UP = (FlightMode.HOLD, FlightMode.TAKEOFF)
_LANDING = frozenset(
    {FlightMode.OFFBOARD, FlightMode.HOLD, FlightMode.LAND, FlightMode.DESCEND, FlightMode.UNKNOWN}
)
_FELL_TO_STICKS = "the autopilot fell back to the sticks, which are heard: they have the aircraft"
_LONGEST_STEP_S = 0.2  # of waking time: a longer one was our own sleep, not the other's silence


class PilotWatch:
    """Notices that somebody else has the aircraft, and remembers it until `resume`.

    Any mode that we did not ask for counts, whoever chose it: it is not to be fought. Only where
    the autopilot itself says that our mode is still the intended one (PX4's CURRENT_MODE) it is a
    failsafe, which may end by itself; one of the sticks too, to which PX4 of the 1.16 era falls
    back, but where sticks are heard: who moves them then changes nothing that PX4 tells.

    Attributes:
        released: why the aircraft is not ours any more.
        failsafe: the mode that the autopilot flies in our place, while it does.
        is_told: that it is one; not yet, in the moment until the autopilot says who chose the mode.
    """

    def __init__(self, config: SafetyConfig) -> None:
        self._config = config
        self._own_modes = frozenset(FlightMode)
        self._unknown_since_s: float | None = None
        self.released: str | None = None
        self.failsafe: FlightMode | None = None
        self.is_told = False

    def resume(self) -> None:
        """Forget the takeover; our control begins again with the autopilot's answer."""
        self.released = self.failsafe = None
        self._own_modes = frozenset(FlightMode)
        self._unknown_since_s = None

    def step(
        self,
        mode: FlightMode,
        landing: bool,
        t_s: float,
        intended: FlightMode | None = None,
        has_sticks: bool = False,
        steers: bool = False,
    ) -> None:
        """One look at the mode.

        Args:
            mode: what is flown.
            landing: we have asked for a landing.
            t_s: now.
            intended: the mode that somebody asked for; UNKNOWN until the autopilot has told.
            has_sticks: it is flown by sticks that are heard.
            steers: our mode was accepted: one that is told since is ours no more, also where it
                came before ours was told.
        """
        if steers or mode is FlightMode.OFFBOARD:
            self._own_modes = _STEERING
        elif mode is FlightMode.TAKEOFF and self._own_modes != _STEERING:
            self._own_modes = _TAKING_OFF
        elif (mode, intended) == _HELD_UP and self._own_modes != _STEERING:
            self._own_modes = _TAKING_OFF_ONLY
        own_modes = self._own_modes | _LANDING if landing else self._own_modes
        self.failsafe, self.is_told = None, False
        if mode in own_modes or self.released is not None:
            self._unknown_since_s = None
        elif has_sticks:
            self.released = _FELL_TO_STICKS if intended in self._own_modes else _not_ours(mode)
        elif mode is not FlightMode.UNKNOWN and intended in self._own_modes:
            self.failsafe, self.is_told = mode, True
            self._unknown_since_s = None
        elif FlightMode.UNKNOWN in (mode, intended):
            # It has not been told, or who wanted it has not.
            self._unknown_since_s = t_s if self._unknown_since_s is None else self._unknown_since_s
            self.failsafe = mode
            if t_s - self._unknown_since_s >= self._config.unknown_mode_s:
                self.released = _not_ours(mode)
        else:
            self.released = _not_ours(mode)


def _not_ours(mode: FlightMode) -> str:
    if mode is FlightMode.MANUAL:
        return "the pilot took over"
    if mode in (FlightMode.OTHER, FlightMode.UNKNOWN):
        return "the flight mode is one that is not ours"
    return f"the flight mode was changed to {mode.value}, not by us"


class LinkWatch:
    """For how long the autopilot has been silent while we listened.

    A navigator that slept finds old telemetry when it wakes: that was not the autopilot's silence.

    Attributes:
        silence_s: since it was last heard, our own sleep left out.
        gap_s: the longest recent silence of the link or of ourselves: what makes an autopilot fly
            its failsafe for lost setpoints. 0 when there was none within `gap_memory_s`.
    """

    def __init__(self, config: SafetyConfig) -> None:
        self._config = config
        self._t_s: float | None = None
        self._gap_t_s = -math.inf
        self.silence_s = 0.0
        self.gap_s = 0.0

    def step(self, vehicle: VehicleState, t_s: float) -> None:
        """One look at what was heard last."""
        step_s = 0.0 if self._t_s is None else max(t_s - self._t_s, 0.0)
        self._t_s = t_s
        awake_s = self.silence_s + min(step_s, _LONGEST_STEP_S)
        unheard_s = vehicle.silence_s if math.isfinite(vehicle.silence_s) else math.inf
        self.silence_s = min(unheard_s, awake_s)
        gap_s = max(self.silence_s, step_s)
        remembered = t_s - self._gap_t_s <= self._config.gap_memory_s
        if gap_s >= self._config.gap_s:
            self.gap_s = max(self.gap_s, gap_s) if remembered else gap_s
            self._gap_t_s = t_s
        elif not remembered:
            self.gap_s = 0.0


class LossWatch:
    """For how long something that was heard once is not heard any more.

    Attributes:
        lost_s: negative while it is heard, and when it never was.
    """

    def __init__(self) -> None:
        self._heard_s: float | None = None
        self.lost_s = -math.inf

    def step(self, heard: bool, t_s: float) -> None:
        """One look."""
        if heard:
            self._heard_s = t_s
        lost = self._heard_s is not None and not heard
        self.lost_s = t_s - self._heard_s if lost and self._heard_s is not None else -math.inf


class BatteryWatch:
    """The level of the battery. It only falls: a voltage that recovers has no more energy in it."""

    def __init__(self, config: SafetyConfig) -> None:
        self._config = config
        self._below_since_s: dict[BatteryLevel, float] = {}
        self.level = BatteryLevel.ENOUGH

    def step(self, ratio: float | None, t_s: float) -> None:
        """One reading; None when the autopilot does not say."""
        for level, limit in (
            (BatteryLevel.LOW, self._config.battery_low_ratio),
            (BatteryLevel.CRITICAL, self._config.battery_critical_ratio),
        ):
            if ratio is None or not ratio < limit:
                self._below_since_s.pop(level, None)
                continue
            since_s = self._below_since_s.setdefault(level, t_s)
            if t_s - since_s >= self._config.battery_time_s:
                self.level = min(self.level, level)


class PositionWatch:
    """Whether the position is good enough to fly on, or at least to fly home on.

    Attributes:
        had_fix: there has been a map fix.
        usable: the way home can be found with it.
        bad_s: for how long it has been out of its bounds; None while it is within them.
        reason: why it was so last.
        warning: why it is poor, though within its bounds; empty when it is not.
    """

    def __init__(self, config: SafetyConfig) -> None:
        self._config = config
        self._bad_since_s: float | None = None
        self.had_fix = False
        self.usable = False
        self.bad_s: float | None = None
        self.reason = ""
        self.warning = ""

    def step(self, estimate: Estimate | None, t_s: float) -> None:
        """One estimate; None while there is none to fly on."""
        fixed = estimate is not None and estimate.t_last_fix_s is not None
        self.had_fix = self.had_fix or fixed
        sigma_m = math.inf if estimate is None else self._sigma_m(estimate, t_s)
        self.usable = self.had_fix and sigma_m <= self._config.return_sigma_m
        reason = self._complaint(estimate, sigma_m, t_s)
        self.warning = self._warning(estimate, sigma_m, t_s)
        if reason is None:
            self._bad_since_s = self.bad_s = None
            return
        self.reason = reason
        self._bad_since_s = t_s if self._bad_since_s is None else self._bad_since_s
        self.bad_s = t_s - self._bad_since_s

    def _sigma_m(self, estimate: Estimate, t_s: float) -> float:
        """Sigma of a finite and fresh estimate, else infinity."""
        fresh = abs(t_s - estimate.t_s) <= self._config.estimate_age_s
        finite = all(
            bool(np.all(np.isfinite(array)))
            for array in (estimate.position_ned_m, estimate.velocity_ned_m_s, estimate.covariance)
        )
        return estimate.sigma_horizontal_m if fresh and finite else math.inf

    def _complaint(self, estimate: Estimate | None, sigma_m: float, t_s: float) -> str | None:
        if estimate is None or not math.isfinite(sigma_m):
            return "no position estimate"
        if not self.had_fix:
            return None  # unknown so far, and nobody travels on it
        limit_m = self._config.hold_sigma_m
        if self._bad_since_s is not None:
            limit_m *= self._config.resume_sigma_ratio
        if not sigma_m <= limit_m:
            return f"position uncertain by {sigma_m:.0f} m"
        t_fix_s = estimate.t_last_fix_s
        if t_fix_s is None or not t_s - t_fix_s <= self._config.hold_fix_age_s:
            return f"no map fix for {self._config.hold_fix_age_s:.0f} s"
        return None

    def _warning(self, estimate: Estimate | None, sigma_m: float, t_s: float) -> str:
        if estimate is None or estimate.t_last_fix_s is None:
            return ""
        limit_m = self._config.slow_sigma_m
        if self.warning:
            limit_m *= self._config.resume_sigma_ratio
        if sigma_m > limit_m:
            return f"position uncertain by {sigma_m:.0f} m"
        if t_s - estimate.t_last_fix_s > self._config.slow_fix_age_s:
            return f"no map fix for {self._config.slow_fix_age_s:.0f} s"
        return ""
