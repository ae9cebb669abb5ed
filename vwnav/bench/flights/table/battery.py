"""The battery: low, critical, unknown."""

from vwnav.bench.flights.faults.aircraft import BatteryAt
from vwnav.bench.flights.faults.telemetry import battery_unknown
from vwnav.bench.flights.scenario import (
    BREAKS_AT_S,
    HOME,
    Break,
    Ending,
    Scenario,
    down,
    flies_on,
    mode,
    phase,
    setup,
)

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
