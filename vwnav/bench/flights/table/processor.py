"""The computer has other things to do."""

from vwnav.bench.flights.faults.computer import SlowSearch, Starved
from vwnav.bench.flights.scenario import BREAKS_AT_S, HOME, Break, Ending, Scenario, setup

PROCESSOR = [
    *(
        Scenario(
            name=f"processor starved for {seconds:g} s",
            setup=setup(),
            breaks=(Break(fault=Starved(0.0, seconds), at_s=BREAKS_AT_S),),
            limit_s=24.0 if seconds <= 1.0 else 70.0,
            ending=Ending.FLIES_ON if seconds <= 1.0 else Ending.LANDED,
        )
        for seconds in (0.2, 1.0, 3.0)
    ),
    Scenario(
        name="a search takes 2.5 s",
        setup=setup(None, home_known=False),
        breaks=(Break(fault=SlowSearch(2.5), at_s=0.0),),
        limit_s=240.0,
        lands_within_m=3.0,
        lands_at_ne_m=HOME,
    ),
    Scenario(
        name="a third of the processor is left",
        setup=setup(None),
        breaks=(Break(fault=Starved(0.33, 1000.0), at_s=0.0),),
        limit_s=240.0,
        lands_within_m=3.0,
        lands_at_ne_m=HOME,
    ),
]
