"""Whole flights in which nothing breaks."""

from vwnav.bench.flights.scenario import HOME, Scenario, setup

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
]
