"""The pilot takes the aircraft and gives it back; battery; the autopilot refuses or restarts."""

from vwnav.bench.flights.faults.aircraft import (
    BatteryAt,
    CommandRefused,
    PilotHandsBack,
    PilotStopsMotors,
    PilotSwitches,
    Reboots,
    SimulatorStands,
)
from vwnav.bench.flights.faults.link import LinkCut
from vwnav.bench.flights.faults.telemetry import BootClockJumps, battery_unknown
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
    again_and_again,
    down,
    flies_on,
    mode,
    phase,
    setup,
)
from vwnav.bench.flights.setup import AirStart
from vwnav.mission.mission import Phase
from vwnav.vehicle import FlightMode

TAKES = [
    Scenario(
        name=f"pilot takes over while {where}",
        setup=setup(start, rc_on=True),
        breaks=(Break(fault=PilotSwitches(), at_s=at_s, phase=begun),),
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
]
ON_THE_GROUND = [
    Scenario(
        name="pilot takes over before arming",
        setup=setup(None, rc_on=True),
        breaks=(Break(fault=PilotSwitches(), at_s=3.0),),
        limit_s=60.0,
        ending=Ending.STAYED,
    ),
    Scenario(
        name="pilot takes over while arming",
        setup=setup(None, rc_on=True),
        breaks=(Break(fault=PilotSwitches(), at_s=0.0, armed=True),),
        limit_s=40.0,
        ending=Ending.PILOT,
        follows=(phase(3.0, "pilot flies"),),
    ),
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
STOPS_MOTORS = [
    Scenario(
        name=f"pilot stops the motors while {where}",
        setup=setup(start),
        breaks=(Break(fault=PilotStopsMotors(), at_s=at_s),),
        limit_s=15.0,
        ending=Ending.ANYHOW,
        follows=(phase(1.5, "done"),),
    )
    for where, start, at_s in (("climbing", CLIMB, 4.0), ("on the route", ROUTE, BREAKS_AT_S))
]
GIVES_BACK = [
    Scenario(
        name="pilot takes over and hands back",
        setup=setup(rc_on=True),
        breaks=(
            Break(fault=PilotSwitches(), at_s=9.0),
            Break(fault=PilotHandsBack(), at_s=15.0),
        ),
        limit_s=30.0,
        ending=Ending.FLIES_ON,
        follows=(phase(3.0, "pilot flies"),),
    ),
    Scenario(
        name="pilot hands back, and takes over again while the link is cut",
        setup=setup(rc_on=True),
        breaks=(
            Break(fault=PilotSwitches(), at_s=9.0),
            Break(fault=PilotHandsBack(), at_s=15.0),
            Break(fault=LinkCut(), at_s=15.05, for_s=2.0),
            Break(fault=PilotSwitches(), at_s=16.0),
        ),
        limit_s=30.0,
        ending=Ending.PILOT,
        follows=(phase(3.0, "pilot flies"),),
    ),
]
PILOT = [*TAKES, *ON_THE_GROUND, *STOPS_MOTORS, *GIVES_BACK]


BATTERY = [
    Scenario(
        name="battery low",
        setup=setup(),
        breaks=(Break(fault=BatteryAt(0.22), at_s=BREAKS_AT_S),),
        limit_s=120.0,
        follows=(phase(5.0, "returning"), down(110.0)),
        lands_within_m=3.0,
        lands_at_ne_m=HOME,
    ),
    Scenario(
        name="battery critical",
        setup=setup(),
        breaks=(Break(fault=BatteryAt(0.08), at_s=BREAKS_AT_S),),
        limit_s=80.0,
        follows=(mode(10.0, "LAND", "HOLD", "RETURN"), down(70.0)),
    ),
    Scenario(
        name="battery unknown before take-off",
        setup=setup(None),
        breaks=(Break(fault=battery_unknown(), at_s=0.0),),
        limit_s=40.0,
        ending=Ending.STAYED,
    ),
    flies_on("battery unknown in flight", battery_unknown()),
]


NAV_TAKEOFF = 22

AUTOPILOT = [
    Scenario(
        name="take-off refused",
        setup=setup(None),
        breaks=(Break(fault=CommandRefused(NAV_TAKEOFF), at_s=0.0),),
        limit_s=60.0,
        ending=Ending.STAYED,
    ),
    Scenario(
        name="autopilot restarts on the ground",
        setup=setup(None),
        breaks=(Break(fault=Reboots(), at_s=8.0),),
        limit_s=80.0,
        ending=Ending.FLIES_ON,
        follows=(phase(60.0, "climbing"),),
    ),
    flies_on("autopilot's clock jumps to zero in the air", BootClockJumps(), after_s=15.0),
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
    *(
        Scenario(
            name=f"autopilot's clock {100 * (1.0 - rate):.0f} % slow by turns of 5 s",
            setup=setup(vehicle_rate=rate, vehicle_fit_s=5.0),
            breaks=(),
            limit_s=45.0,
            ending=Ending.FLIES_ON,
        )
        for rate in (0.9, 0.7)
    ),
    flies_on("simulator stands still for 0.6 s", SimulatorStands(0.6), 0.6, after_s=15.0),
    Scenario(
        name="simulator stands still for 0.6 s every 5 s",
        setup=setup(),
        breaks=again_and_again(SimulatorStands(0.6), 5.0, 0.6, 5),
        limit_s=45.0,
        ending=Ending.FLIES_ON,
    ),
]
