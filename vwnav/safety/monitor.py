"""Watches estimates and telemetry, and asks the control hierarchy what may be done.

Only a pilot takes control away for good, and only a pilot gives it back (`SafetyMonitor.resume`).
"""

import math
from collections.abc import Callable
from dataclasses import replace

from vwnav.safety.bounds import CarriedOff, RouteBounds
from vwnav.safety.conditions import BatteryWatch, LinkWatch, LossWatch, PilotWatch, PositionWatch
from vwnav.safety.energy import EnergyWatch
from vwnav.safety.hierarchy import Action, Decision, Hierarchy, Rank
from vwnav.safety.safety_config import SafetyConfig
from vwnav.safety.situation import BatteryLevel, Situation
from vwnav.types import Array, Estimate
from vwnav.vehicle import FlightMode, Navigation, Order, VehicleState

_DONE_BY = {
    Order.PAUSE: {Action.HOLD},
    Order.GO_ON: {Action.NAVIGATE, Action.SLOW},
    Order.RETURN: {Action.RETURN},
    Order.LAND: {Action.LAND},
}
_ASKS = "the ground station asks for"
_UNHEARD = "the autopilot was not heard while it was asked for Offboard"


class SafetyMonitor:
    """What has been seen so far, and the hierarchy's state.

    Args:
        cruise_m_s: how fast the way home is flown.
    """

    def __init__(self, config: SafetyConfig, cruise_m_s: float) -> None:
        self._config = config
        self._hierarchy = Hierarchy(config)
        self._pilot = PilotWatch(config)
        self._battery = BatteryWatch(config)
        self._energy = EnergyWatch(config, cruise_m_s)
        self._begin_watching()
        self._bounds: RouteBounds | None = None
        self._carried_off = CarriedOff(config.fence_m)
        self._order: Order | None = None
        self._is_new_order = self._ends_pause = False
        self._lands = self._is_asked_back = False

    def _begin_watching(self) -> None:
        self._link = LinkWatch(self._config)
        self._radio = LossWatch()
        self._ground = LossWatch()
        self._position = PositionWatch(self._config)
        self._lost_since_s: float | None = None

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
        return. What was silent or poor in the pilot's hands begins anew; a battery does not.
        """
        self._is_asked_back = True
        self._pilot.resume()
        self._begin_watching()

    def lands_for(self, navigation: Navigation, vehicle: VehicleState, t_s: float) -> str | None:
        """Why an aircraft that is given back now would only be landed; None where it is not."""
        return self._hierarchy.lands_for(self._situation(navigation, vehicle, t_s))

    def fly_within(
        self, route_ned_m: Array, home_ne_m: Array, way_home_ned_m: Callable[[Estimate], Array]
    ) -> None:
        """From now on the aircraft belongs near a route (n, 3) and the way home (2,) from it.

        `way_home_ned_m` tells the way (n, 3) of a return that begins with an estimate.
        """
        self._bounds = RouteBounds(route_ned_m, home_ne_m)
        self._energy.way_home_ned_m = way_home_ned_m

    def obey(self, order: Order) -> None:
        """What a ground station asks for; it has its place in the hierarchy."""
        self._ends_pause = order is Order.GO_ON and self.is_paused
        self._order, self._is_new_order = order, True

    @property
    def is_paused(self) -> bool:
        """A person wants it to stand still, whatever else there is to hold for."""
        return self._order is Order.PAUSE

    def step(
        self, navigation: Navigation, vehicle: VehicleState, t_s: float, steers: bool = False
    ) -> Decision:
        """The decision for this moment; to be called at every tick, in order of time.

        `steers`: the autopilot has accepted Offboard, or GUIDED, whatever it has told since. Until
        then an aircraft that is asked back is the pilot's, who may have taken it again.
        """
        has_sticks, intended = vehicle.has_sticks, vehicle.intended_mode
        given_back = steers or vehicle.mode is FlightMode.OFFBOARD
        self._is_asked_back = self._is_asked_back and not given_back
        self._pilot.step(vehicle.mode, self._lands, t_s, intended, has_sticks, steers)
        self.watch(navigation, vehicle, t_s)
        now = self._situation(navigation, vehicle, t_s)
        if self._is_asked_back and now.released is None:
            self._pilot.released = self._left_with_pilot(now)
            now = replace(now, released=self._pilot.released)
        decision = self._hierarchy.step(now)
        self._lands = self._lands or decision.action is Action.LAND
        return decision

    def _left_with_pilot(self, now: Situation) -> str | None:
        """Why an aircraft that is asked back, without an answer yet, is not waited for any more."""
        was_silent = self._link.gap_s > self._config.resume_gap_s
        reason = _UNHEARD if was_silent else self._hierarchy.lands_for(now)
        return None if reason is None else f"{reason}: the aircraft stays the pilot's"

    def watch(self, navigation: Navigation, vehicle: VehicleState, t_s: float) -> None:
        """Look on, at every tick in which somebody else has the aircraft; `step` does it too."""
        self._battery.step(vehicle.battery_ratio, t_s)
        self._link.step(vehicle, t_s)
        self._radio.step(vehicle.rc_available, t_s)
        self._ground.step(vehicle.ground_station, t_s)
        self._position.step(navigation.estimate, t_s)

    def unheeded(self, decision: Decision) -> str:
        """What a ground station has asked for lately, and why it is not done; "" where it is.

        `decision`: what is done.
        """
        is_new, self._is_new_order = self._is_new_order and not self._ends_pause, False
        return _unheeded(self._order, decision) if is_new else ""

    def _situation(self, navigation: Navigation, vehicle: VehicleState, t_s: float) -> Situation:
        position = self._position
        estimate, bounds = navigation.estimate, self._bounds
        home_only, off_route_m, carried_off_m = False, 0.0, 0.0
        if self._pilot.released is not None or self._pilot.failsafe is not None:
            self._carried_off.forget()
        if estimate is not None and bounds is not None:
            here_ned_m = estimate.position_ned_m
            off_route_m = bounds.off_route_m(here_ned_m)
            carried_off_m = self._carried_off.step(off_route_m, bounds.off_home_m(here_ned_m))
            home_only = self._energy.step(vehicle, estimate, t_s)
        return Situation(
            released=self._pilot.released,
            failsafe=self._pilot.failsafe,
            is_failsafe_told=self._pilot.is_told,
            battery=self._battery.level,
            is_battery_for_home_only=home_only,
            connected=vehicle.connected,
            silence_s=self._link.silence_s,
            lost_s=self._lost_for_s(navigation, t_s),
            lost=navigation.lost,
            blind_s=_blind_for_s(navigation, t_s),
            is_unseen=navigation.follows,
            contradicted=navigation.contradicted,
            radio_lost_s=self._radio.lost_s,
            ground_lost_s=self._ground.lost_s,
            had_fix=position.had_fix,
            is_usable=position.usable,
            bad_s=-math.inf if position.bad_s is None else position.bad_s,
            complaint=position.reason,
            warning=position.warning,
            off_route_m=off_route_m,
            carried_off_m=carried_off_m,
            order=self._order,
        )

    def _lost_for_s(self, navigation: Navigation, t_s: float) -> float:
        if navigation.estimate is not None:
            self._lost_since_s = None
            return -math.inf
        self._lost_since_s = t_s if self._lost_since_s is None else self._lost_since_s
        return t_s - self._lost_since_s


def _blind_for_s(navigation: Navigation, t_s: float) -> float:
    """Without an estimate that is another matter, and said so."""
    if navigation.estimate is None:
        return 0.0
    return math.inf if navigation.seen_s is None else t_s - navigation.seen_s


def _unheeded(order: Order | None, decision: Decision) -> str:
    """What stands against an order; "" where it is done."""
    if order is None or decision.action in _DONE_BY.get(order, ()):
        return ""
    if decision.rank is Rank.OPERATOR and order is not Order.GO_ON:
        return ""
    reason = decision.reason.replace(_ASKS, "it has asked for")
    return f"{_ASKS} {order.value}: not now, {reason}"
