"""The autopilot refuses, restarts, or keeps another time."""

from vwnav.bench.flights.faults.aircraft import CommandRefused, Reboots
from vwnav.bench.flights.faults.telemetry import BootClockJumps
from vwnav.bench.flights.scenario import Break, Ending, Scenario, flies_on, phase, setup

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
]
