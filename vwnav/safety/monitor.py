"""Who decides: the pilot, the battery, the link, the position, and last of all the route.

A pure state machine over estimates and telemetry; what it decides, the flight loop does. Only a
pilot takes control away for good, and only a pilot gives it back (`SafetyMonitor.resume`).
"""

from dataclasses import dataclass
from enum import Enum

from vwnav.safety.safety_config import SafetyConfig
from vwnav.safety.watches import (
    BatteryLevel,
    BatteryWatch,
    PilotWatch,
    PositionWatch,
    link_silence_s,
)
from vwnav.types import Estimate, VehicleState

__all__ = ["Action", "Decision", "SafetyConfig", "SafetyMonitor"]


class Action(Enum):
    """What may be done now."""

    NAVIGATE = "navigate"
    HOLD = "hold"
    RETURN = "return"
    LAND = "land"
    RELEASE = "release"


@dataclass(frozen=True, slots=True)
class Decision:
    """An action and why.

    Attributes:
        action: what to do.
        reason: empty for NAVIGATE.
        may_travel: False until the first map fix: straight up or down only, wherever one is.
    """

    action: Action
    reason: str
    may_travel: bool


class SafetyMonitor:
    """The hierarchy, highest first: pilot, battery critical, link, battery low, position, route.

    RELEASE stays until `resume`, LAND until a pilot takes over, RETURN until a landing. A low
    battery comes after the link, because without a link nobody flies anywhere.
    """

    def __init__(self, config: SafetyConfig) -> None:
        self._config = config
        self._pilot = PilotWatch(config)
        self._battery = BatteryWatch(config)
        self._position = PositionWatch(config)
        self._land: str | None = None
        self._return: str | None = None

    def resume(self) -> None:
        """The pilot asked for us again: to be called on the pilot's own word only.

        The flight mode alone is not that word: PX4 goes back to Offboard by itself when setpoints
        return.
        """
        self._pilot.resume()

    def step(self, estimate: Estimate, vehicle: VehicleState, t_s: float) -> Decision:
        """The decision for this moment; to be called at every tick, in order of time."""
        self._pilot.step(vehicle.mode, self._land is not None, t_s)
        self._battery.step(vehicle.battery_ratio, t_s)
        self._position.step(estimate, t_s)
        if self._pilot.released is not None:
            return self._decision(Action.RELEASE, self._pilot.released)
        hold = self._consider(vehicle)
        if self._land is not None:
            return self._decision(Action.LAND, self._land)
        if hold is not None:
            return self._decision(Action.HOLD, hold)
        if self._return is not None:
            return self._decision(Action.RETURN, self._return)
        return self._decision(Action.NAVIGATE, "")

    def _decision(self, action: Action, reason: str) -> Decision:
        return Decision(action, reason, self._position.had_fix)

    def _consider(self, vehicle: VehicleState) -> str | None:
        """Decide on landing and return, which stay; the reason to hold, which does not."""
        if self._battery.level is BatteryLevel.CRITICAL:
            self._land = self._land or "battery critical"
        silence_s = link_silence_s(vehicle)
        if silence_s > self._config.link_land_s:
            self._land = self._land or "the autopilot has gone silent"
        if silence_s > self._config.link_hold_s or not vehicle.connected:
            return "the autopilot is not heard"
        if self._battery.level is BatteryLevel.LOW:
            self._go_home("battery low")
        return self._consider_position()

    def _consider_position(self) -> str | None:
        bad_s, reason = self._position.bad_s, self._position.reason
        if bad_s is None or (self._return is not None and self._position.usable):
            return None
        if bad_s < self._config.hold_time_s:
            return reason
        self._go_home(reason)
        if not self._position.usable:
            self._land = self._land or reason
        return None

    def _go_home(self, reason: str) -> None:
        """Return; land instead when there was never a fix, for then we are still above home."""
        if not self._position.had_fix:
            self._land = self._land or reason
        elif self._position.usable:
            self._return = self._return or reason
