"""The three tests: what is flown, who does what, and what must be seen in which order.

hover: arm, climb, hold for 30 s, land. waypoints: a route and home. failsafe: a route on which the
pilot takes over, gives back, and then loses the radio: loiter, return, land.
"""

from dataclasses import dataclass, replace

from vwnav.bench.flights.faults.aircraft import PilotHandsBack, PilotPushes, PilotSwitches, RadioOff
from vwnav.bench.flights.scenario import Break, Scenario
from vwnav.bench.flights.setup import Setup
from vwnav.config import Config
from vwnav.mission.config import FlightConfig
from vwnav.mission.mission import Phase
from vwnav.sim.config import Manners

HOLD_S = 30.0
HEIGHT_M = 30.0
# It waits above home until so many fixes are in, at most five a second.
_HOVER = Config(flight=FlightConfig(fixes_to_start=160, first_fix_timeout_s=120.0))
_ROUTE_NED_M = ((40.0, 0.0, -HEIGHT_M), (40.0, -40.0, -HEIGHT_M), (0.0, -40.0, -HEIGHT_M))
_LONG_NED_M = ((120.0, 0.0, -HEIGHT_M), (120.0, -60.0, -HEIGHT_M), (0.0, -60.0, -HEIGHT_M))
TAKES_S, GIVES_BACK_S, RADIO_OFF_S = 5.0, 13.0, 20.0  # on the route


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightTest:
    """One of them.

    Attributes:
        scenario: as it is flown in lockstep.
        modes: that must be flown one after the other, others may lie between.
        figures: of the thesis that its plots repeat: altitude, position, heading.
    """

    name: str
    scenario: Scenario
    modes: tuple[str, ...]
    figures: tuple[str, str, str]


HOVER = FlightTest(
    name="hover",
    scenario=Scenario(
        name="hover",
        setup=Setup(route_ned_m=((0.0, 0.0, -HEIGHT_M),), config=_HOVER),
        breaks=(),
        limit_s=240.0,
    ),
    modes=("TAKEOFF", "OFFBOARD", "LAND"),
    figures=("6.3", "6.4", "6.5"),
)
WAYPOINTS = FlightTest(
    name="waypoints",
    scenario=Scenario(
        name="waypoints", setup=Setup(route_ned_m=_ROUTE_NED_M), breaks=(), limit_s=240.0
    ),
    modes=("TAKEOFF", "OFFBOARD", "LAND"),
    figures=("6.6", "6.7", "6.8"),
)
FAILSAFE = FlightTest(
    name="failsafe",
    scenario=Scenario(
        name="failsafe",
        setup=Setup(route_ned_m=_LONG_NED_M, rc_on=True),
        breaks=(
            Break(fault=PilotPushes(), phase=Phase.ROUTE, at_s=TAKES_S),
            Break(fault=PilotHandsBack(), phase=Phase.ROUTE, at_s=GIVES_BACK_S),
            Break(fault=RadioOff(), phase=Phase.ROUTE, at_s=RADIO_OFF_S),
        ),
        limit_s=240.0,
    ),
    modes=("TAKEOFF", "OFFBOARD", "MANUAL", "OFFBOARD", "HOLD", "RETURN"),  # which lands
    figures=("6.9", "6.10", "6.11"),
)
TESTS = {each.name: each for each in (HOVER, WAYPOINTS, FAILSAFE)}
_PX4_ALONE = ("TAKEOFF", "HOLD")


def in_manners(test: FlightTest, manners: Manners) -> FlightTest:
    """The test as this autopilot flies it.

    ArduCopter takes off in GUIDED, which the mode switch ends and a stick does not; a lost radio is
    RTL at once, and the loiter is a part of it, above home.
    """
    setup = replace(test.scenario.setup, manners=manners)
    if manners != "copter":
        return replace(test, scenario=replace(test.scenario, setup=setup))
    breaks = tuple(
        replace(each, fault=PilotSwitches()) if isinstance(each.fault, PilotPushes) else each
        for each in test.scenario.breaks
    )
    return replace(
        test,
        scenario=replace(test.scenario, setup=setup, breaks=breaks),
        modes=tuple(mode for mode in test.modes if mode not in _PX4_ALONE),
    )
