"""What the safety monitor watches: the pilot, the battery and the position, each on its own."""

import math
from enum import IntEnum

import numpy as np

from vwnav.safety.safety_config import SafetyConfig
from vwnav.types import Estimate, FlightMode, VehicleState

# Modes in which nobody else has taken over, by how far we have got.
_TAKING_OFF = frozenset({FlightMode.TAKEOFF, FlightMode.HOLD, FlightMode.OFFBOARD})
_STEERING = frozenset({FlightMode.OFFBOARD})
_LANDING = frozenset(
    {FlightMode.OFFBOARD, FlightMode.HOLD, FlightMode.LAND, FlightMode.DESCEND, FlightMode.UNKNOWN}
)


class PilotWatch:
    """Notices that somebody else has the aircraft, and remembers it until `resume`.

    Any mode that we did not ask for counts, whether a pilot's stick or a failsafe of the autopilot
    chose it: neither is to be fought.
    """

    def __init__(self, config: SafetyConfig) -> None:
        self._config = config
        self._own_modes = frozenset(FlightMode)
        self._unknown_since_s: float | None = None
        self.released: str | None = None

    def resume(self) -> None:
        """Forget the takeover; the next OFFBOARD is the start of our control again."""
        self.released = None
        self._own_modes = frozenset(FlightMode)
        self._unknown_since_s = None

    def step(self, mode: FlightMode, landing: bool, t_s: float) -> None:
        """One look at the mode; `landing` when we have asked for a landing."""
        if mode is FlightMode.OFFBOARD:
            self._own_modes = _STEERING
        elif mode is FlightMode.TAKEOFF and self._own_modes != _STEERING:
            self._own_modes = _TAKING_OFF
        own_modes = self._own_modes | _LANDING if landing else self._own_modes
        if mode is not FlightMode.UNKNOWN or mode in own_modes:
            self._unknown_since_s = None
        if mode in own_modes or self.released is not None:
            return
        if mode is FlightMode.UNKNOWN:
            # A name that the link does not know, or has lost for a moment.
            self._unknown_since_s = t_s if self._unknown_since_s is None else self._unknown_since_s
            if t_s - self._unknown_since_s >= self._config.unknown_mode_s:
                self.released = "the flight mode is one that is not ours"
        elif mode is FlightMode.MANUAL:
            self.released = "the pilot took over"
        else:
            self.released = f"the flight mode was changed to {mode.value}, not by us"


class BatteryLevel(IntEnum):
    """How much is left, in three steps."""

    CRITICAL = 0
    LOW = 1
    ENOUGH = 2


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
    """

    def __init__(self, config: SafetyConfig) -> None:
        self._config = config
        self._bad_since_s: float | None = None
        self.had_fix = False
        self.usable = False
        self.bad_s: float | None = None
        self.reason = ""

    def step(self, estimate: Estimate, t_s: float) -> None:
        """One estimate."""
        self.had_fix = self.had_fix or estimate.t_last_fix_s is not None
        sigma_m = self._sigma_m(estimate, t_s)
        self.usable = self.had_fix and sigma_m <= self._config.return_sigma_m
        reason = self._complaint(estimate, sigma_m, t_s)
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

    def _complaint(self, estimate: Estimate, sigma_m: float, t_s: float) -> str | None:
        if not math.isfinite(sigma_m):
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


def link_silence_s(vehicle: VehicleState) -> float:
    """Seconds since the autopilot was last heard; infinity when that is not known."""
    return vehicle.heartbeat_age_s if math.isfinite(vehicle.heartbeat_age_s) else math.inf
