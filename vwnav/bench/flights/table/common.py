"""What the rows share: where they begin, and on which settings they fly."""

from vwnav.bench.flights.scenario import Break, Ending, Scenario
from vwnav.bench.flights.setup import AirStart, Setup
from vwnav.bench.flights.stage import Fault
from vwnav.config import Config
from vwnav.mission.mission import Phase
from vwnav.seams import PipelineConfig

HOME = (0.0, 0.0)
# Every other picture that could be matched: what is left out costs the most and tells the least.
CONFIG = Config(pipeline=PipelineConfig(fix_interval_s=0.4))
ROUTE = AirStart(phase=Phase.ROUTE, place_ned_m=(15.0, -15.0, -50.0))
CLIMB = AirStart(phase=Phase.CLIMB, place_ned_m=(0.5, 0.5, -15.0))
RETURN = AirStart(phase=Phase.RETURN, place_ned_m=(60.0, 40.0, -50.0))
DESCEND = AirStart(phase=Phase.DESCEND, place_ned_m=(0.5, -0.5, -25.0))
BREAKS_AT_S = 9.0  # on the route: at speed, and after a few fixes


def setup(start: AirStart | None = ROUTE, **changes: object) -> Setup:
    """A flight that begins there; None: on the ground."""
    return Setup(start=start, config=CONFIG, **changes)  # type: ignore[arg-type]


def flies_on(
    name: str, fault: Fault, for_s: float | None = None, after_s: float = 12.0, **changes: object
) -> Scenario:
    """On the route, what breaks for so long is flown through, and `after_s` more."""
    lasts_s = 10.0 if for_s is None else for_s
    return Scenario(
        name=name,
        setup=setup(**changes),  # type: ignore[arg-type]
        breaks=(Break(fault=fault, at_s=BREAKS_AT_S, for_s=for_s),),
        limit_s=BREAKS_AT_S + lasts_s + after_s,
        ending=Ending.FLIES_ON,
    )
