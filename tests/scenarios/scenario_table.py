"""The table: what breaks, when, what must follow within how many seconds, and the bounds.

Most rows begin in the air, where their fault is. Those named in `QUICK` are flown by `make test`,
one of each kind; all of them by `make test-long`.
"""

import math
from dataclasses import replace

from scenario_seen import down, mode, phase, said

from vwnav.bench.flights import faults as broken
from vwnav.bench.flights.scenario import Break, Ending, Scenario
from vwnav.bench.flights.setup import AirStart, Setup
from vwnav.config import Config
from vwnav.mission import Phase
from vwnav.pipeline import PipelineConfig
from vwnav.sim.config import Manners
from vwnav.types import FlightMode

HOME = (0.0, 0.0)
# Every other picture that could be matched: what is left out costs the most and tells the least.
CONFIG = Config(pipeline=PipelineConfig(fix_interval_s=0.4))
ROUTE = AirStart(phase=Phase.ROUTE, place_ned_m=(15.0, -15.0, -50.0))
CLIMB = AirStart(phase=Phase.CLIMB, place_ned_m=(0.5, 0.5, -15.0))
RETURN = AirStart(phase=Phase.RETURN, place_ned_m=(60.0, 40.0, -50.0))
DESCEND = AirStart(phase=Phase.DESCEND, place_ned_m=(0.5, -0.5, -25.0))


def setup(start: AirStart | None = ROUTE, **changes: object) -> Setup:
    return Setup(start=start, config=CONFIG, **changes)  # type: ignore[arg-type]


def attitude(name: str, fault: broken.Fault, for_s: float) -> Scenario:
    return Scenario(
        name=name,
        setup=setup(),
        breaks=(Break(fault=fault, at_s=9.0, for_s=for_s),),
        limit_s=9.0 + for_s + 12.0,
        ending=Ending.FLIES_ON,
    )


ATTITUDE = [
    *(
        attitude(f"attitude missing for {seconds:g} s", broken.Missing(), seconds)
        for seconds in (0.05, 0.2, 1.0)
    ),
    Scenario(
        name="attitude missing for 5 s",
        setup=setup(),
        breaks=(Break(fault=broken.Missing(), at_s=9.0, for_s=5.0),),
        limit_s=80.0,
        follows=(mode(5.0, "LAND"),),
        lands_within_m=30.0,
    ),
    attitude("one attitude level and facing north", broken.WrongAttitude(level=True), 0.02),
    attitude("attitudes level and facing north for 1 s", broken.WrongAttitude(level=True), 1.0),
    attitude("one attitude not a number", broken.WrongAttitude(nan=True), 0.02),
    attitude("one heading 30 degrees off", broken.WrongAttitude(turned_rad=math.radians(30)), 0.02),
    attitude("telemetry 0.1 s late", broken.TelemetryLate(0.1), 10.0),
    attitude("telemetry 0.3 s late", broken.TelemetryLate(0.3), 10.0),
    attitude("barometer 6 m off for 0.7 s", broken.BarometerWrong(6.0), 0.7),
]

CAMERA = [
    Scenario(
        name=f"pictures {name} for good at 50 m",
        setup=setup(wind_m_s=5.0),
        breaks=(Break(fault=broken.CameraTrouble(make), at_s=9.0),),
        limit_s=75.0,
        follows=(phase(8.0, "landing"), down(60.0)),
        lands_within_m=50.0,
    )
    for name, make in (
        ("gone", broken.no_pictures),
        ("black", broken.black),
        ("frozen", broken.frozen),
        ("failing", broken.raising),
    )
] + [
    Scenario(
        name="pictures gone for 3 s",
        setup=setup(),
        breaks=(Break(fault=broken.CameraTrouble(broken.no_pictures), at_s=9.0, for_s=3.0),),
        limit_s=25.0,
        ending=Ending.FLIES_ON,
    ),
]

CUTS_S = (0.3, 1.0, 3.0, 5.0, 10.0, 30.0)


def link_cut(where: str, start: AirStart, seconds: float, phase: Phase | None = None) -> Scenario:
    """A cut of 1 s and less is flown on after; a longer one ends in a landing.

    Near by, where the map shows enough after the cut to say anew where it is. Else it comes down as
    the wind has it, and only its speed is bounded: after 30 s it is too low for the map, and so it
    is from the first second on where it was coming down already.
    """
    short = seconds <= 1.0
    blind = seconds > 10.0 or (start is DESCEND and phase is None)
    at_s = {Phase.ROUTE: 9.0, Phase.CLIMB: 4.0, Phase.RETURN: 6.0, Phase.DESCEND: 4.0}
    return Scenario(
        name=f"link cut for {seconds:g} s {where}",
        setup=setup(start),
        breaks=(
            Break(
                fault=broken.LinkCut(),
                at_s=at_s[start.phase or Phase.ROUTE] if phase is None else 1.5,
                phase=phase,
                for_s=seconds,
            ),
        ),
        limit_s=24.0 + seconds if short else 90.0,
        ending=Ending.FLIES_ON if short else Ending.LANDED,
        lands_within_m=None if short or blind else 30.0,
    )


LINK = [
    *(link_cut("on the route", ROUTE, seconds) for seconds in CUTS_S),
    *(link_cut("while climbing", CLIMB, seconds) for seconds in CUTS_S),
    *(link_cut("while returning", RETURN, seconds) for seconds in CUTS_S),
    *(link_cut("while descending", DESCEND, seconds) for seconds in CUTS_S),
    *(link_cut("while landing", DESCEND, seconds, Phase.LAND) for seconds in CUTS_S),
    Scenario(
        name="round trip of 0.25 s at take-off",
        setup=setup(None),
        breaks=(Break(fault=broken.RoundTrip(0.25), at_s=0.0),),
        limit_s=60.0,
        ending=Ending.FLIES_ON,
        follows=(phase(45.0, "climbing"), phase(60.0, "on route")),
    ),
]

NAVIGATOR = [
    Scenario(
        name="navigator stopped for 20 s",
        setup=setup(),
        breaks=(Break(fault=broken.NavigatorStopped(20.0), at_s=9.0),),
        limit_s=80.0,
        follows=(
            mode(2.5, "HOLD"),
            mode(5.0, "LAND", "DESCEND"),
            down(60.0),
        ),
        # Nobody tells it where it is: blind for 30 s, no further than wind and gusts carry it.
        lands_within_m=150.0,
    ),
    Scenario(
        name="navigator killed",
        setup=setup(),
        breaks=(Break(fault=broken.NavigatorKilled(), at_s=9.0),),
        limit_s=80.0,
        follows=(mode(2.5, "HOLD"), mode(5.0, "LAND", "DESCEND"), down(60.0)),
        lands_within_m=70.0,
    ),
    Scenario(
        name="navigator ends in the air",
        setup=setup(),
        breaks=(Break(fault=broken.NavigatorLeaves(), at_s=9.0),),
        limit_s=80.0,
        follows=(mode(2.5, "HOLD"), mode(5.0, "LAND", "DESCEND"), down(60.0)),
        lands_within_m=70.0,
    ),
    *(
        Scenario(
            name=f"processor starved for {seconds:g} s",
            setup=setup(),
            breaks=(Break(fault=broken.Starved(0.0, seconds), at_s=9.0),),
            limit_s=24.0 if seconds <= 1.0 else 70.0,
            ending=Ending.FLIES_ON if seconds <= 1.0 else Ending.LANDED,
        )
        for seconds in (0.2, 1.0, 3.0)
    ),
    Scenario(
        name="disk full",
        setup=setup(),
        breaks=(Break(fault=broken.DiskFull(), at_s=6.0),),
        limit_s=20.0,
        ending=Ending.FLIES_ON,
    ),
    Scenario(
        name="model raises in flight",
        setup=setup(),
        breaks=(Break(fault=broken.ModelRaises(), at_s=6.0),),
        limit_s=30.0,
        ending=Ending.FLIES_ON,
        follows=(said(10.0, "SIFT stands in"),),
    ),
]

PILOT = [
    Scenario(
        name=f"pilot takes over while {where}",
        setup=setup(start, rc_on=True),
        breaks=(Break(fault=broken.PilotSwitches(), at_s=at_s, phase=begun),),
        limit_s=limit_s,
        ending=Ending.PILOT,
        follows=(phase(3.0, "pilot flies"),),
    )
    for where, start, begun, at_s, limit_s in (
        ("climbing", CLIMB, None, 4.0, 12.0),
        ("on the route", ROUTE, None, 9.0, 15.0),
        ("returning", RETURN, None, 5.0, 12.0),
        ("descending", DESCEND, None, 3.0, 12.0),
        ("landing", DESCEND, Phase.LAND, 1.5, 30.0),
        ("taking off", None, Phase.TAKEOFF, 6.0, 40.0),
        ("Offboard is being asked for", None, Phase.CLIMB, 0.0, 35.0),
    )
] + [
    Scenario(
        name="fly is started while a pilot flies",
        setup=setup(
            AirStart(phase=None, place_ned_m=(15.0, -15.0, -50.0), mode=FlightMode.MANUAL),
            rc_on=True,
        ),
        breaks=(),
        limit_s=20.0,
        ending=Ending.PILOT,
    ),
]

AIRCRAFT = [
    Scenario(
        name="battery critical",
        setup=setup(),
        breaks=(Break(fault=broken.BatteryAt(0.08), at_s=9.0),),
        limit_s=80.0,
        follows=(mode(10.0, "LAND", "HOLD", "RETURN"), down(70.0)),
    ),
    Scenario(
        name="take-off refused",
        setup=setup(None),
        breaks=(Break(fault=broken.CommandRefused(22), at_s=0.0),),
        limit_s=60.0,
        ending=Ending.STAYED,
    ),
    *(
        Scenario(
            name=f"autopilot's clock {100 * (1.0 - rate):.0f} % slow",
            setup=setup(vehicle_rate=rate),
            breaks=(),
            limit_s=30.0,
            ending=Ending.FLIES_ON,
        )
        for rate in (0.99, 0.98)
    ),
]

WHOLE = [
    Scenario(
        name="nothing breaks",
        setup=setup(None),
        breaks=(),
        limit_s=220.0,
        lands_within_m=3.0,
        lands_at_ne_m=HOME,
    ),
    Scenario(
        name="home is not known",
        setup=setup(None, home_known=False, stands_ne_m=(60.0, -45.0)),
        breaks=(),
        limit_s=240.0,
        lands_within_m=3.0,
        lands_at_ne_m=(60.0, -45.0),
    ),
    Scenario(
        name="a search takes 2.5 s",
        setup=setup(None, home_known=False),
        breaks=(Break(fault=broken.SlowSearch(2.5), at_s=0.0),),
        limit_s=240.0,
        lands_within_m=3.0,
        lands_at_ne_m=HOME,
    ),
    Scenario(
        name="a third of the processor is left",
        setup=setup(None),
        breaks=(Break(fault=broken.Starved(0.33, 1000.0), at_s=0.0),),
        limit_s=240.0,
        lands_within_m=3.0,
        lands_at_ne_m=HOME,
    ),
]


# ArduCopter does otherwise by design: without setpoints it flies on for 3 s, and once its EKF
# failsafe has acted (8 s) it comes down level, 45 s in the wind, whatever is known again.
COPTER_LANDS_WITHIN_M = {
    "link cut for 3 s": 45.0,
    "link cut for 5 s": 45.0,
    "link cut for 10 s": 220.0,
    "link cut for 30 s": 220.0,
    "navigator stopped": 220.0,
}


def in_manners(row: Scenario, manners: Manners) -> Scenario:
    """The row as this autopilot flies it, with the bounds that are its own."""
    setup = replace(row.setup, manners=manners)
    if manners == "px4" or row.lands_within_m is None:
        return replace(row, setup=setup)
    own = (bound_m for part, bound_m in COPTER_LANDS_WITHIN_M.items() if part in row.name)
    return replace(row, setup=setup, lands_within_m=next(own, row.lands_within_m))


TABLE = [*ATTITUDE, *CAMERA, *LINK, *NAVIGATOR, *PILOT, *AIRCRAFT, *WHOLE]
# Those that have been flown in ArduCopter's manners too: by `make test-long`.
FLOWN_IN_COPTER_MANNERS = {
    "attitude missing for 5 s",
    "battery critical",
    "link cut for 1 s on the route",
    "link cut for 10 s on the route",
    "link cut for 5 s on the route",
    "navigator killed",
    "navigator stopped for 20 s",
    "nothing breaks",
    "pictures gone for good at 50 m",
    "pilot takes over while on the route",
}
QUICK = {
    "attitude missing for 1 s",
    "one attitude level and facing north",
    "pictures black for good at 50 m",
    "link cut for 5 s on the route",
    "navigator stopped for 20 s",
    "processor starved for 1 s",
    "model raises in flight",
    "pilot takes over while on the route",
    "take-off refused",
}
