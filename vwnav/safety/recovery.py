"""What may be asked of an autopilot that flies its own failsafe after a gap of link or estimates.

PX4 chases what comes back: in Descend it takes the first estimates that return and flies after
them, whatever they say. So a new estimate has to stand, and the autopilot's own position has to
agree with it, before it is asked for anything; and after more than a second it is only landed.
"""

from enum import Enum

import numpy as np

from vwnav.safety.safety_config import SafetyConfig
from vwnav.types import Estimate
from vwnav.vehicle import FlightMode, VehicleState

_AGREES_S = 1.0
_AGREES_M = 3.0
_AGREES_SIGMAS = 3.0
_HOLD_WAIT_S = 2.0
# What PX4 falls back to for want of one; MANUAL in the 1.16 era, with nobody at the sticks.
_WITHOUT_POSITION = frozenset({FlightMode.LAND, FlightMode.DESCEND, FlightMode.MANUAL})
_UNMANNED_S = 5.0  # in a mode of the sticks that nobody chose, which holds its height for good


class Wish(Enum):
    """What is to be done now."""

    WAIT = "wait"  # ask for nothing, send no setpoint
    STAY = "stay"  # setpoints of zero velocity, and nothing else
    GO_ON = "go on"  # it is back in our mode
    HOLD = "hold"  # ask for it, once
    LAND = "land"


class Recovery:
    """One failsafe, from its beginning.

    Back in our mode after a long gap the aircraft is landed all the same: what PX4 does by itself
    when setpoints return is nobody's decision.

    One that no gap explains (radio, battery, fence) is the autopilot's to fly to its end. Setpoints
    of zero velocity go on meanwhile: PX4 still intends Offboard, and does not follow them, but
    without them it adds a second failsafe to the first one, and offboard loss (Land) outranks the
    return that it was going to fly.

    Args:
        explained: a gap of the link, or an estimate that was lost, explains it.
    """

    def __init__(self, config: SafetyConfig, explained: bool) -> None:
        self._config = config
        self._explained = explained
        self._gap_s = 0.0  # the longest, however long ago
        self._agrees_since_s: float | None = None
        self._held_s: float | None = None
        self._unmanned_since_s: float | None = None

    @property
    def has_asked(self) -> bool:
        """Hold has been asked for."""
        return self._held_s is not None

    def has_brought(self, vehicle: VehicleState) -> bool:
        """It flies the Hold that was asked for, or will once it has a position: that is ours.

        Any other mode in the meantime is somebody's, or a failsafe that no gap of ours explains.
        """
        waits = vehicle.intended_mode is FlightMode.HOLD and vehicle.mode in _WITHOUT_POSITION
        brought = vehicle.mode is FlightMode.HOLD or waits
        return self.has_asked and brought and not vehicle.has_sticks

    def step(
        self, vehicle: VehicleState, estimate: Estimate | None, gap_s: float, t_s: float
    ) -> Wish:
        """The wish of this tick; `gap_s` is how long link or estimates were missing lately.

        An aircraft that the autopilot has brought down is asked for nothing more: back in our mode,
        which PX4 falls back to once nothing is wrong, it would take off again.
        """
        self._gap_s = gap_s = max(self._gap_s, gap_s)
        if not vehicle.in_air:
            return Wish.WAIT
        if self._held_s is not None:
            if vehicle.mode is FlightMode.HOLD:
                return Wish.LAND
            untold = vehicle.intended_mode is FlightMode.UNKNOWN and not vehicle.failsafe
            waited = t_s - self._held_s >= _HOLD_WAIT_S
            return Wish.LAND if waited and not (untold or vehicle.may_be_pilots) else Wish.WAIT
        if vehicle.mode in (FlightMode.OFFBOARD, FlightMode.TAKEOFF):
            return Wish.GO_ON if gap_s <= self._config.resume_gap_s else Wish.LAND
        if self._is_unmanned_for_long(vehicle, t_s):
            return Wish.LAND
        if not self._explained:
            # From the first moment: who asked for the mode is told up to two seconds later. But in
            # one of the sticks that may be a pilot.
            waits = vehicle.may_be_pilots or vehicle.mode is FlightMode.UNKNOWN
            return Wish.WAIT if waits else Wish.STAY
        if not vehicle.failsafe:
            return Wish.WAIT  # whose mode it is has not been told yet
        if gap_s <= self._config.resume_gap_s and estimate is not None:
            return Wish.STAY
        if estimate is None or not _agrees(vehicle, estimate):
            self._agrees_since_s = None
            return Wish.WAIT
        self._agrees_since_s = t_s if self._agrees_since_s is None else self._agrees_since_s
        if t_s - self._agrees_since_s < _AGREES_S:
            return Wish.WAIT
        if vehicle.mode is FlightMode.HOLD:
            return Wish.LAND  # a Hold that is asked for from now on is a person's
        self._held_s = t_s
        return Wish.HOLD

    def _is_unmanned_for_long(self, vehicle: VehicleState, t_s: float) -> bool:
        """PX4 refuses to land without a position: then the operator reads that, at least."""
        if vehicle.mode is not FlightMode.MANUAL or not vehicle.is_fallback:
            self._unmanned_since_s = None
            return False
        since_s = self._unmanned_since_s
        self._unmanned_since_s = t_s if since_s is None else since_s
        return t_s - self._unmanned_since_s >= _UNMANNED_S


def _agrees(vehicle: VehicleState, estimate: Estimate) -> bool:
    """The autopilot's own position is where the estimate has the aircraft."""
    own = vehicle.own_position_ned_m
    if own is None:
        return False
    apart_m = float(np.hypot(*(own - estimate.position_ned_m)[:2]))
    return apart_m <= max(_AGREES_M, _AGREES_SIGMAS * estimate.sigma_horizontal_m)
