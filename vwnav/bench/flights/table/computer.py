"""The navigator's process ends, sleeps or raises, the watchdog's ends; processor, disk and date."""

from vwnav.bench.flights.faults import computer
from vwnav.bench.flights.faults.computer import SlowSearch, Starved
from vwnav.bench.flights.scenario import (
    BREAKS_AT_S,
    HOME,
    RETURN,
    Break,
    Ending,
    Follows,
    Scenario,
    down,
    flies_on,
    mode,
    phase,
    said,
    setup,
)
from vwnav.bench.flights.stage import Fault

TAKEN_OVER = (mode(2.5, "HOLD"), mode(5.0, "LAND", "DESCEND"), down(60.0))


def _for_good(name: str, fault: Fault, follows: tuple[Follows, ...], within_m: float) -> Scenario:
    """A fault that begins on the route and never ends."""
    return Scenario(
        name=name,
        setup=setup(),
        breaks=(Break(fault=fault, at_s=BREAKS_AT_S),),
        limit_s=75.0,
        follows=follows,
        lands_within_m=within_m,
    )


ENDS = [
    _for_good(name, fault, TAKEN_OVER, within_m)
    for name, fault, within_m in (
        # Ended while it is held: until the other one has found the place nobody tells where it is.
        ("navigator stopped for 20 s", computer.NavigatorStopped(20.0), 40.0),
        ("navigator killed", computer.NavigatorKilled(), 70.0),
        ("navigator ends in the air", computer.NavigatorLeaves(), 70.0),
    )
]
RAISES = [
    # No telemetry is taken in and no estimate goes out: the process ends, another one tells where.
    _for_good(
        "every step of the link raises for good",
        computer.StepRaises("link"),
        (mode(8.0, "LAND", "DESCEND"), down(60.0)),
        70.0,
    ),
    _for_good("a step of the mission raises", computer.StepRaises("mission"), TAKEN_OVER, 20.0),
    _for_good(
        "every picture raises for good",
        computer.StepRaises("picture"),
        (phase(8.0, "landing"), down(60.0)),
        50.0,
    ),
    # It knows its motion, not its place: stays, looks from higher up, returns by its motion alone.
    Scenario(
        name="every match raises for good",
        setup=setup(),
        breaks=(Break(fault=computer.MatchingRaises(), at_s=BREAKS_AT_S),),
        limit_s=150.0,
        follows=(phase(40.0, "returning"), down(140.0)),
        lands_within_m=10.0,
        lands_at_ne_m=HOME,
    ),
    flies_on("every step of the link raises for 0.5 s", computer.StepRaises("link"), 0.5),
    flies_on("every picture raises for 2 s", computer.StepRaises("picture"), 2.0),
]
HANGS = [
    # It does not raise, and everything else goes on: the mission sees it, and falls silent.
    _for_good(
        "the link's loop hangs",
        computer.LoopHangs("link"),
        (mode(8.0, "LAND", "DESCEND"), down(60.0)),
        70.0,
    ),
    _for_good("the mission's loop hangs", computer.LoopHangs("mission"), TAKEN_OVER, 25.0),
    _for_good(
        "the loop of the pictures hangs",
        computer.LoopHangs("picture"),
        (phase(8.0, "landing"), down(60.0)),
        50.0,
    ),
]
WATCHDOG = [
    Scenario(
        name="watchdog killed",
        setup=setup(),
        breaks=(Break(fault=computer.WatchdogKilled(), at_s=BREAKS_AT_S),),
        limit_s=30.0,
        ending=Ending.FLIES_ON,
        follows=(said(1.0, "watchdog"),),
    ),
    Scenario(
        name="watchdog hangs",
        setup=setup(),
        breaks=(Break(fault=computer.WatchdogHangs(), at_s=BREAKS_AT_S),),
        limit_s=90.0,
        lands_within_m=40.0,  # ArduCopter coasts while nobody speaks
    ),
]
NAVIGATOR = [*ENDS, *RAISES, *HANGS, *WATCHDOG]


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
    *(
        Scenario(
            name=f"a search takes {seconds:g} s",
            setup=setup(None, home_known=False),
            breaks=(Break(fault=SlowSearch(seconds), at_s=0.0),),
            limit_s=280.0,
            lands_within_m=3.0,
            lands_at_ne_m=HOME,
        )
        for seconds in (2.5, 22.0)
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


DISK_AND_CLOCK = [
    flies_on("disk full", computer.DiskFull()),
    Scenario(
        name="disk full on the way home",
        setup=setup(RETURN),
        breaks=(Break(fault=computer.DiskFull(), at_s=2.0),),
        limit_s=120.0,
        lands_within_m=3.0,
        lands_at_ne_m=HOME,
    ),
    Scenario(
        name="disk full, and the model raises",
        setup=setup(),
        breaks=(
            Break(fault=computer.DiskFull(), at_s=BREAKS_AT_S),
            Break(fault=computer.ModelRaises(), at_s=BREAKS_AT_S + 2.0),
        ),
        limit_s=40.0,
        ending=Ending.FLIES_ON,
    ),
    flies_on("disk stalled", computer.DiskStalled()),
    flies_on("computer's date jumps by an hour", computer.WallClockJumps(3600.0), 10.0),
    flies_on("computer's date jumps back by a day", computer.WallClockJumps(-86400.0), 10.0),
]
