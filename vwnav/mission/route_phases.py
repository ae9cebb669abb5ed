"""The phases that the mission itself flies: from the autopilot's take-off to above the landing."""

from collections.abc import Callable

import numpy as np

from vwnav.guidance.controller import RouteFollower, stops_at_ned_m
from vwnav.guidance.limits import LimitsConfig
from vwnav.mission.config import FlightConfig
from vwnav.mission.home import FlownWay, Home
from vwnav.mission.mission import Mission, Next, Phase
from vwnav.mission.steering import Steering
from vwnav.types import Array, Estimate
from vwnav.vehicle import Autopilot, FlightMode, Navigation, Request, VehicleState

_MODE_SHOWS_S = 1.0  # from an accepted take-off to the heartbeat that tells its mode
_REACHED = 0.85  # of the height asked for: the autopilot's take-off is over
_RISES_M = 0.3  # within 3 s, else it has ended whatever height we believe: slower than any
_RISES_S = 3.0  # take-off, more than a hover in gusts
_FAR_BELOW_M = 5.0  # its leg, more than any climb along one lags
_AT_HEIGHT_M = 1.0
_LOOKS = 3  # answered from above home: enough to know that there is no fix
_SLOW_SEARCH = 3.0  # times as long it waits for them


class RoutePhases:
    """Flies take-off, climb, first fix, route, return and descent.

    Args:
        fly_within: told the route (n, 3), home (2,) once both are known, and how to tell the way
            home (n, 3) from an estimate.
        say: receives one line per event.
    """

    def __init__(
        self,
        autopilot: Autopilot,
        mission: Mission,
        steering: Steering,
        config: FlightConfig,
        limits: LimitsConfig,
        fly_within: Callable[[Array, Array, Callable[[Estimate], Array]], None],
        say: Callable[[str], None],
    ) -> None:
        self._autopilot = autopilot
        self._mission = mission
        self._steering = steering
        self._config = config
        self._limits = limits
        self._fly_within = fly_within
        self._say = say
        self._home = Home(mission.home_ne_m, mission.home_sigma_m)
        self._follower: RouteFollower | None = None
        self._way = FlownWay()
        self._fixes = self._looks = 0
        self._before: Estimate | None = None
        self.begin_phase()

    def begin_phase(self) -> None:
        """What belongs to a phase begins with it, also where it is gone on with.

        Somebody else may have flown the aircraft meanwhile, and to another place.
        """
        self._offboard: Request | None = None
        self._rises = False  # to its leg, before it travels on
        self._looks_before, self._fixes_before = self._looks, self._fixes
        self._rose_to_m = 0.0
        self._rose_s = 0.0

    @property
    def home_ne_m(self) -> Array | None:
        """(2,) where the aircraft stood, as far as it is known."""
        return self._home.place_ne_m

    def note(self, navigation: Navigation, on_ground: bool) -> None:
        """Count looks and fixes, and the way until home is known.

        Before anybody knows where home is, the held place jumps along: it is here. After that it is
        home, and a position that jumps shows how far from it the aircraft is.
        """
        self._looks, estimate = navigation.looks, navigation.estimate
        if estimate is None:
            return
        before, self._before = self._before, estimate
        if before is None:
            return
        if estimate.t_last_fix_s is not None and estimate.t_last_fix_s != before.t_last_fix_s:
            self._fixes += 1
        dt_s = estimate.t_s - before.t_s
        flown_m = 0.5 * dt_s * (estimate.velocity_ned_m_s + before.velocity_ned_m_s)[:2]
        if estimate.reset_counter != before.reset_counter and self._home.place_ne_m is None:
            jump_m = (estimate.position_ned_m - before.position_ned_m)[:2] - flown_m
            self._steering.held_ne_m = self._steering.held_ne_m + jump_m
        if not on_ground:
            variances_m2 = np.diag(estimate.covariance)[:2], np.diag(before.covariance)[:2]
            self._home.flown(flown_m, float(np.max(variances_m2[0]) - np.max(variances_m2[1])))

    def take_up(self, phase: Phase, estimate: Estimate) -> None:
        """Begin in the air with home given, as if it had flown there: `Flight.take_up`."""
        assert self._mission.home_ne_m is not None
        self._home.take(self._mission.home_ne_m)
        self._steering.held_ne_m = estimate.position_ned_m[:2].copy()
        if phase is Phase.RETURN:
            self.turn_home(estimate)
        elif phase is Phase.ROUTE:
            self._follow_from_here(self._route_ned_m())

    def turn_home(self, estimate: Estimate, as_flown: bool = False) -> None:
        """Straight home, or `as_flown`: over ground where the map has matched.

        As flown too where the ground on the straight way is too high.
        """
        self._settle_home(estimate)
        straight_ned_m = None if as_flown else self._straight_home_ned_m(estimate)
        if straight_ned_m is None:
            if not as_flown:
                self._say("the ground on the straight way home is too high: back the flown way")
            self._follower = RouteFollower(self._flown_back_ned_m(estimate), self._limits)
        else:
            self._follower = RouteFollower(straight_ned_m, self._limits)

    def way_home_ned_m(self, estimate: Estimate) -> Array:
        """(n, 3) of a return that begins now, on a good position."""
        straight_ned_m = self._straight_home_ned_m(estimate)
        return self._flown_back_ned_m(estimate) if straight_ned_m is None else straight_ned_m

    def _straight_home_ned_m(self, estimate: Estimate) -> Array | None:
        assert self._home.place_ne_m is not None
        here_ned_m = stops_at_ned_m(estimate, self._limits)
        return self._mission.way_home.straight_ned_m(here_ned_m, self._home.place_ne_m)

    def _flown_back_ned_m(self, estimate: Estimate) -> Array:
        assert self._home.place_ne_m is not None
        return self._way.back_ned_m(estimate, self._home.place_ne_m)

    def step(
        self, phase: Phase, since_s: float, estimate: Estimate, vehicle: VehicleState, pace: float
    ) -> Next | None:
        """Steer through a tick of a phase; what follows when it has ended.

        Args:
            phase: one of those above.
            since_s: how long it has lasted.
            estimate: what there is to fly on.
            vehicle: what the autopilot tells.
            pace: share of the route's speed.
        """
        match phase:
            case Phase.TAKEOFF:
                return self._take_off(since_s, estimate, vehicle)
            case Phase.CLIMB:
                return self._climb(estimate)
            case Phase.FIRST_FIX:
                return self._wait_for_fix(since_s, estimate)
            case Phase.ROUTE | Phase.RETURN:
                return self._follow(phase, estimate, pace)
            case Phase.DESCEND:
                return self._descend(estimate)
        return None

    def _take_off(self, since_s: float, estimate: Estimate, vehicle: VehicleState) -> Next | None:
        """The autopilot climbs by itself; then it is asked for Offboard."""
        height_m = -float(estimate.position_ned_m[2])
        wanted_m = self._config.takeoff_height_m
        if vehicle.mode is FlightMode.MANUAL and since_s > _MODE_SHOWS_S:
            return Next(Phase.RELEASED, "the pilot took over")
        if self._offboard is not None:
            return self._ask_for_offboard(self._offboard)
        if height_m > self._rose_to_m + _RISES_M:
            self._rose_to_m, self._rose_s = height_m, since_s
        rests = vehicle.in_air and since_s - self._rose_s > _RISES_S
        hovers = (vehicle.mode is FlightMode.HOLD or rests) and height_m > 0.3 * wanted_m
        if height_m >= _REACHED * wanted_m or hovers:
            self._steering.held_ne_m = estimate.position_ned_m[:2].copy()
            self._offboard = self._autopilot.start_offboard()
        elif since_s > self._config.takeoff_timeout_s:
            return Next(Phase.LAND, "the take-off did not reach its height")
        return None

    def _ask_for_offboard(self, request: Request) -> Next | None:
        if not request.done:
            return None
        if request.refused is None:
            return Next(Phase.CLIMB)
        return Next(Phase.LAND, f"the autopilot refused Offboard: {request.refused}")

    def _climb(self, estimate: Estimate) -> Next | None:
        """Straight up over the start, wherever that is."""
        self._steering.climb(estimate)
        return Next(Phase.FIRST_FIX) if self._steering.missing_m(estimate) < 1.0 else None

    def _wait_for_fix(self, since_s: float, estimate: Estimate) -> Next | None:
        if self._fixes >= self._config.fixes_to_start:
            return self._begin_route(estimate)
        if reason := self._hopeless(since_s):
            return Next(Phase.LAND, f"no fix above home: {reason}")
        self._steering.hold_at_height(estimate)
        return None

    def _hopeless(self, since_s: float) -> str | None:
        """Why there will be no fix: looks from here have found nothing, or hardly any answers."""
        looks = self._looks - self._looks_before
        most_s = self._config.first_fix_timeout_s
        if looks < _LOOKS or self._fixes > self._fixes_before:
            most_s *= _SLOW_SEARCH
        if since_s <= most_s:
            return None
        if looks >= _LOOKS:
            told = " --home is wrong," if self._mission.home_ne_m is not None else ""
            return f"the map shows another place,{told} or the camera does not work"
        return (
            f"{looks} looks at the map answered in {since_s:.0f} s: this computer is too slow, "
            "or the map too large to be searched without --home"
        )

    def _begin_route(self, estimate: Estimate) -> Next:
        """Now it is known where the aircraft stood, and with that where the route lies."""
        self._settle_home(estimate)
        route_ned_m = self._route_ned_m()
        refused = self._mission.refuse(route_ned_m)
        if refused:
            return Next(Phase.LAND, refused)
        self._follow_from_here(route_ned_m)
        self._steering.hold_at_height(estimate)
        return Next(Phase.ROUTE)

    def _settle_home(self, estimate: Estimate) -> None:
        told = self._home.settle(estimate)
        if told:
            self._say(told)

    def _route_ned_m(self) -> Array:
        """(n + 1 or 2, 3) the waypoints and the way back to above home."""
        home_ne_m, route_ned_m = self._home.place_ne_m, self._mission.route_ned_m
        assert home_ne_m is not None
        if self._mission.about_home:
            route_ned_m = np.add(route_ned_m, [*home_ne_m, 0.0])
        back_ned_m = self._mission.way_home.after_route_ned_m(route_ned_m[-1], home_ne_m)
        return np.vstack([route_ned_m, back_ned_m])

    def _follow_from_here(self, route_ned_m: Array) -> None:
        self._follower = RouteFollower(route_ned_m, self._limits)
        self._fly_within(route_ned_m, route_ned_m[-1, :2], self.way_home_ned_m)

    def _follow(self, phase: Phase, estimate: Estimate, pace: float) -> Next | None:
        assert self._follower is not None
        assert self._home.place_ne_m is not None
        if phase is Phase.ROUTE:
            self._way.note(estimate)
        if self._must_rise(estimate):
            self._steering.rise(estimate, self._follower.below_m(estimate))
            return None
        step = self._follower.step(estimate, pace)
        self._steering.steer(step.setpoint)
        if not step.done:
            return None
        self._steering.held_ne_m = self._home.place_ne_m
        return Next(Phase.DESCEND)

    def _must_rise(self, estimate: Estimate) -> bool:
        """Whether it first climbs where it is: the leg clears what stands on the ground.

        A pilot may have given the aircraft back far below it.
        """
        assert self._follower is not None
        below_m = self._follower.below_m(estimate)
        if below_m > _FAR_BELOW_M and not self._rises:
            self._steering.held_ne_m = stops_at_ned_m(estimate, self._limits)[:2]
            self._rises = True
        self._rises = self._rises and below_m > _AT_HEIGHT_M
        return self._rises

    def _descend(self, estimate: Estimate) -> Next | None:
        if -float(estimate.position_ned_m[2]) < self._config.land_from_m:
            return Next(Phase.LAND)
        self._steering.descend(estimate)
        return None
