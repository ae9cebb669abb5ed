"""Whole flights in which nothing breaks, and wind."""

from vwnav.bench.flights.scenario import HOME, NOBODY_KNOWS, Ending, Scenario, setup, unsaid

WHOLE = [
    Scenario(
        name="nothing breaks",
        setup=setup(None),
        breaks=(),
        limit_s=220.0,
        follows=(unsaid(220.0, "contradicts"),),
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
    # As two clicks at one place make them: what a position errs by is more than the way between.
    Scenario(
        name="waypoints half a metre beside each other, 35 m above and below",
        setup=setup(
            None,
            route_ned_m=(
                (30.0, -30.0, -45.0),
                (30.3, -30.4, -80.0),
                (60.0, 0.0, -80.0),
                (60.4, 0.3, -45.0),
            ),
        ),
        breaks=(),
        limit_s=220.0,
        lands_within_m=3.0,
        lands_at_ne_m=HOME,
    ),
]


WIND = [
    Scenario(
        name="wind of 12 m/s with gusts of 3 m/s on the route",
        setup=setup(wind_m_s=12.0, gust_m_s=3.0),
        breaks=(),
        limit_s=45.0,
        ending=Ending.FLIES_ON,
    ),
    *(
        Scenario(
            name=", ".join(filter(None, (how, "wind of 12 m/s with gusts, the whole flight"))),
            setup=setup(None, wind_m_s=12.0, gust_m_s=1.5, **changes),
            breaks=(),
            limit_s=260.0,
            lands_within_m=5.0,
            lands_at_ne_m=HOME,
        )
        for how, changes in (("", {}), *NOBODY_KNOWS)
    ),
]
