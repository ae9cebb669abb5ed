"""The link to the autopilot: cut, slow, dirty, and used by others."""

from dataclasses import replace

from vwnav.bench.flights.faults import link
from vwnav.bench.flights.faults.aircraft import StationOrders
from vwnav.bench.flights.scenario import (
    BREAKS_AT_S,
    CLIMB,
    DESCEND,
    HOME,
    RETURN,
    ROUTE,
    Break,
    Ending,
    Scenario,
    flies_on,
    phase,
    said,
    setup,
)
from vwnav.bench.flights.setup import AirStart
from vwnav.mission.mission import Phase
from vwnav.sim.config import Manners
from vwnav.vehicle import FlightMode, Order

CUTS_S = (0.3, 1.0, 3.0, 5.0, 10.0, 30.0)


def link_cut(where: str, start: AirStart, seconds: float, phase: Phase | None = None) -> Scenario:
    """A cut of 1 s and less is flown on after; a longer one ends in a landing.

    Short ones while it descends end on the ground at home, whether the autopilot's failsafe began
    the landing or we did. Longer ones end near by. After 30 s it has come down as the wind had it,
    and only its speed is bounded.
    """
    short = seconds <= 1.0
    descends = start is DESCEND and phase is None
    blind = seconds > 10.0
    flown_on = short and not descends
    at_s = {Phase.ROUTE: BREAKS_AT_S, Phase.CLIMB: 4.0, Phase.RETURN: 6.0, Phase.DESCEND: 4.0}
    return Scenario(
        name=f"link cut for {seconds:g} s {where}",
        setup=setup(start),
        breaks=(
            Break(
                fault=link.LinkCut(),
                at_s=at_s[start.phase or Phase.ROUTE] if phase is None else 1.5,
                phase=phase,
                for_s=seconds,
            ),
        ),
        limit_s=24.0 + seconds if flown_on else 90.0,
        ending=Ending.FLIES_ON if flown_on else Ending.LANDED,
        lands_within_m=None if flown_on or blind else 3.0 if short else 30.0,
    )


CUTS = [
    *(link_cut("on the route", ROUTE, seconds) for seconds in CUTS_S),
    *(link_cut("while climbing", CLIMB, seconds) for seconds in CUTS_S),
    *(link_cut("while returning", RETURN, seconds) for seconds in CUTS_S),
    *(link_cut("while descending", DESCEND, seconds) for seconds in CUTS_S),
    *(link_cut("while landing", DESCEND, seconds, Phase.LAND) for seconds in CUTS_S),
]
AT_THE_START = [
    *(
        Scenario(
            name=f"link cut for {seconds:g} s while arming",
            setup=setup(None),
            breaks=(Break(fault=link.LinkCut(), at_s=0.0, armed=True, for_s=seconds),),
            limit_s=45.0,
            ending=Ending.STAYED,
        )
        for seconds in (1.0, 3.0, 10.0)
    ),
    *(
        Scenario(
            name=f"link cut for {seconds:g} s while taking off",
            setup=setup(None),
            breaks=(Break(fault=link.LinkCut(), at_s=1.5, phase=Phase.TAKEOFF, for_s=seconds),),
            limit_s=70.0,
            ending=Ending.FLIES_ON if seconds <= 1.0 else Ending.LANDED,
            lands_within_m=None if seconds <= 1.0 else 10.0,
            lands_at_ne_m=HOME,
        )
        for seconds in (1.0, 3.0, 10.0)
    ),
]
# One that only holds, as is recommended too, and what the 1.16 era does by itself: Position.
STAY_UP: tuple[tuple[Manners, int], ...] = (("px4", 5), ("px4-1.16", 0))


def with_action(row: Scenario, ways: Manners, action: int) -> Scenario:
    """The same row with PX4 of one era, which does this where Offboard is lost."""
    return replace(
        row,
        name=f"{row.name}, {ways} with COM_OBL_RC_ACT {action}",
        setup=replace(row.setup, manners=ways, parameters=(("COM_OBL_RC_ACT", action),)),
    )


NOT_DOWN = [
    with_action(row, *stays_up)
    for row in (link_cut("on the route", ROUTE, 3.0), link_cut("on the route", ROUTE, 5.0))
    for stays_up in STAY_UP
]
SLOW = [
    Scenario(
        name="round trip of 0.25 s at take-off",
        setup=setup(None),
        breaks=(Break(fault=link.RoundTrip(0.25), at_s=0.0),),
        limit_s=60.0,
        ending=Ending.FLIES_ON,
        follows=(phase(45.0, "climbing"), phase(60.0, "on route")),
    ),
    flies_on("round trip of 0.3 s on the route", link.RoundTrip(0.3)),
    Scenario(
        name="line of 57600 baud at take-off",
        setup=setup(None),
        breaks=(Break(fault=link.SlowLine(57600), at_s=0.0),),
        limit_s=110.0,
        ending=Ending.STAYED,
    ),
]
DIRTY = [
    flies_on("garbage between the packets for 10 s", link.Garbage(), 10.0),
    flies_on("packets replayed after 0.5 s for 10 s", link.Replayed(0.5), 10.0),
    flies_on("half of the packets lost for 15 s", link.PacketsLost(0.5), 15.0),
]
OTHERS = [
    Scenario(
        name=f"a second station asks for {mode.name.title()}",
        setup=setup(),
        breaks=(Break(fault=link.StationCommands(mode), at_s=BREAKS_AT_S),),
        limit_s=22.0,
        ending=Ending.OTHERS,
        follows=(phase(1.0, "pilot flies"),),
    )
    for mode in (FlightMode.HOLD, FlightMode.RETURN)
]
ORDERS = [
    Scenario(
        name="the ground station pauses the flight for 8 s",
        setup=setup(),
        breaks=(
            Break(fault=StationOrders(Order.PAUSE), at_s=BREAKS_AT_S),
            Break(fault=StationOrders(Order.GO_ON), at_s=BREAKS_AT_S + 8.0),
        ),
        limit_s=30.0,
        ending=Ending.FLIES_ON,
        follows=(said(1.0, "holding"), said(9.0, "going on")),
    ),
    Scenario(
        name="the ground station asks for the way home",
        setup=setup(),
        breaks=(Break(fault=StationOrders(Order.RETURN), at_s=BREAKS_AT_S),),
        limit_s=120.0,
        follows=(phase(1.0, "returning"),),
        lands_within_m=3.0,
        lands_at_ne_m=HOME,
    ),
    Scenario(
        name="the ground station asks for a landing",
        setup=setup(),
        breaks=(Break(fault=StationOrders(Order.LAND), at_s=BREAKS_AT_S),),
        limit_s=80.0,
        follows=(phase(1.0, "landing"),),
        lands_within_m=15.0,  # PX4's Land stops first, from 7.6 m/s by 3 m/s^2: 13.5 m
    ),
]
LINK = [*CUTS, *AT_THE_START, *NOT_DOWN, *SLOW, *DIRTY, *OTHERS, *ORDERS]
