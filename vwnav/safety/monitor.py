"""Who decides: the pilot, the battery, the link, the position, and last of all the route.

A pure state machine over estimates and telemetry; what it decides, the flight loop does. Only a
pilot takes control away for good, and only a pilot gives it back (`SafetyMonitor.resume`).
"""

import math
from dataclasses import dataclass
from enum import Enum

from vwnav.safety.safety_config import SafetyConfig
from vwnav.safety.watches import (
    BatteryLevel,
    BatteryWatch,
    LinkWatch,
    PilotWatch,
    PositionWatch,
)
from vwnav.types import Navigation, VehicleState

__all__ = ["Action", "Decision", "SafetyConfig", "SafetyMonitor"]


class Action(Enum):
    """What may be done now."""

    NAVIGATE = "navigate"
    HOLD = "hold"
    RETURN = "return"
    LAND = "land"
    YIELD = "yield"  # the autopilot flies a failsafe that may end by itself
    RELEASE = "release"


@dataclass(frozen=True, slots=True)
class Decision:
    """An action and why; `reason` is empty for NAVIGATE."""

    action: Action
    reason: str


class SafetyMonitor:
    """The hierarchy, highest first: pilot, battery critical, link, battery low, position, route.

    RELEASE stays until `resume`, LAND until a pilot takes over, RETURN until a landing. A low
    battery comes after the link, because without a link nobody flies anywhere.
    """

    def __init__(self, config: SafetyConfig) -> None:
        self._config = config
        self._pilot = PilotWatch(config)
        self._battery = BatteryWatch(config)
        self._link = LinkWatch(config)
        self._position = PositionWatch(config)
        self._lost_since_s: float | None = None
        self._land: str | None = None
        self._return: str | None = None

    @property
    def gap_s(self) -> float:
        """The longest recent silence of the link or of ourselves; see `LinkWatch.gap_s`."""
        return self._link.gap_s

    @property
    def battery_is_enough(self) -> bool:
        """It is above both limits, or the autopilot does not say."""
        return self._battery.level is BatteryLevel.ENOUGH

    def resume(self) -> None:
        """The pilot asked for us again: to be called on the pilot's own word only.

        The flight mode alone is not that word: PX4 goes back to Offboard by itself when setpoints
        return.
        """
        self._pilot.resume()

    def step(self, navigation: Navigation, vehicle: VehicleState, t_s: float) -> Decision:
        """The decision for this moment; to be called at every tick, in order of time."""
        landing = self._land is not None
        self._pilot.step(vehicle.mode, landing, t_s, vehicle.intended_mode)
        self._battery.step(vehicle.battery_ratio, t_s)
        self._link.step(vehicle, t_s)
        self._position.step(navigation.estimate, t_s)
        if self._pilot.released is not None:
            return Decision(Action.RELEASE, self._pilot.released)
        if self._pilot.failsafe is not None:
            mode = self._pilot.failsafe.value
            return Decision(Action.YIELD, f"the autopilot flies its failsafe: {mode}")
        hold = self._consider(navigation, vehicle, t_s)
        if self._land is not None:
            return Decision(Action.LAND, self._land)
        if hold is not None:
            return Decision(Action.HOLD, hold)
        if self._return is not None:
            return Decision(Action.RETURN, self._return)
        return Decision(Action.NAVIGATE, "")

    def _consider(self, navigation: Navigation, vehicle: VehicleState, t_s: float) -> str | None:
        """Decide on landing and return, which stay; the reason to hold, which does not."""
        if self._battery.level is BatteryLevel.CRITICAL:
            self._land = self._land or "battery critical"
        if self._link.silence_s > self._config.link_land_s:
            self._land = self._land or "the autopilot has gone silent"
        if self._link.silence_s > self._config.link_hold_s or not vehicle.connected:
            return "the autopilot is not heard"
        if self._battery.level is BatteryLevel.LOW:
            self._go_home("battery low")
        blind = self._consider_sight(navigation, t_s)
        return self._consider_position() if blind is None else blind

    def _consider_sight(self, navigation: Navigation, t_s: float) -> str | None:
        """Without an estimate, or without pictures: stop, then down while it is still known where.

        Coming down on an estimate that has just lost its pictures keeps the place to some metres;
        a hold of 15 s on it first was found 100 m away (measured on PX4 and ArduCopter).
        """
        if navigation.estimate is None:
            self._lost_since_s = t_s if self._lost_since_s is None else self._lost_since_s
            reason = f"the estimate is lost: {navigation.lost}"
            if t_s - self._lost_since_s >= self._config.lost_land_s:
                self._land = self._land or reason
            return reason
        self._lost_since_s = None
        blind_s = math.inf if navigation.seen_s is None else t_s - navigation.seen_s
        if blind_s < self._config.blind_hold_s:
            return None
        if blind_s >= self._config.blind_land_s:
            self._land = self._land or "the camera shows nothing that can be followed"
        return "the camera shows nothing that can be followed"

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
