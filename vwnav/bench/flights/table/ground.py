"""The map is not of this place, not of this year, or not whole; the model does not work."""

import math
from dataclasses import replace

from vwnav.bench.flights.faults import computer, fixes, ground
from vwnav.bench.flights.scenario import (
    Break,
    Ending,
    Scenario,
    down,
    flies_on,
    flies_route,
    phase,
    said,
    setup,
)
from vwnav.bench.flights.stage import Fault
from vwnav.sim.map_warp import MapWarp
from vwnav.sim.relief import Relief

RELIEF = [
    flies_route(ground_name, relief=relief, range_most_m=most_m)
    for ground_name, relief, most_m in (
        ("level ground", Relief(), 0.0),
        ("level ground", Relief(), 12.0),
        ("ground that rises by 5 %", Relief(slope_ne=(0.05, 0.0)), 0.0),
        ("ground that rises by 11 %", Relief(slope_ne=(0.1, 0.05)), 100.0),
        ("ground that rises by 11 %", Relief(slope_ne=(0.1, 0.05)), 0.0),
        ("ground that falls by 11 %", Relief(slope_ne=(-0.05, -0.1)), 0.0),
        ("ground that rises by 22 %", Relief(slope_ne=(0.2, 0.1)), 0.0),
        ("hills of 4 m, one sigma", Relief(hills_m=4.0), 0.0),
        ("woods of 12 m", Relief(woods_m=12.0), 100.0),
        ("wooded hills", Relief(hills_m=4.0, woods_m=12.0), 0.0),
    )
]


def _first_fix(how: str, fault: Fault) -> Scenario:
    return Scenario(
        name=f"first fix {how}",
        setup=setup(None),
        breaks=(Break(fault=fault, at_s=0.0),),
        limit_s=75.0,
        ending=Ending.FLIES_ON,
        follows=(phase(65.0, "on route"),),
    )


MAP = [
    Scenario(
        name="map of another place",
        setup=setup(None),
        breaks=(Break(fault=ground.MapOfElsewhere(), at_s=0.0),),
        limit_s=140.0,
        follows=(phase(90.0, "waiting for a fix"), phase(110.0, "landing"), down(140.0)),
        lands_within_m=15.0,
        lands_at_ne_m=(0.0, 0.0),
    ),
    Scenario(
        name="map shifted by 10 m",
        setup=setup(None),
        breaks=(Break(fault=ground.MapShifted((8.0, -6.0)), at_s=0.0),),
        limit_s=240.0,
        follows=(said(100.0, "home"),),
        lands_within_m=3.0,
        lands_at_ne_m=(0.0, 0.0),
        map_off_m=10.0,
    ),
    flies_route("map off by 1.5 m from place to place", map_warp=MapWarp(sigma_m=2.0, seed=2)),
    _first_fix("turned by 14 degrees", fixes.OneFixWrong(turned_deg=-14.0)),
    _first_fix("turned by 30 degrees", fixes.OneFixWrong(turned_deg=30.0)),
    _first_fix("8 m off", fixes.OneFixWrong(ne_m=(6.4, -4.8))),
    flies_on("one fix turned by 14 degrees", fixes.OneFixWrong(turned_deg=14.0)),
    flies_on("one fix 8 m off", fixes.OneFixWrong(ne_m=(6.4, 4.8))),
    *(
        replace(
            flies_on(f"map steps by {math.hypot(*ne_m):g} m", fixes.MapSteps(ne_m), after_s=25.0),
            follows=(said(8.0, "the map steps"),),
        )
        for ne_m in ((2.4, 1.8), (-3.0, 4.0))
    ),
    flies_on("map of another season", ground.OtherSeason("winter"), after_s=25.0),
    flies_on("map's tiles damaged on disk", computer.MapTilesDamaged(), copies_map=True),
    flies_on("map deleted in flight", computer.MapDeleted(), copies_map=True),
]
MODEL = [
    Scenario(
        name="model raises from the start",
        setup=setup(None),
        breaks=(Break(fault=computer.ModelRaises(), at_s=0.0),),
        limit_s=80.0,
        ending=Ending.FLIES_ON,
        follows=(said(60.0, "SIFT stands in"), phase(75.0, "on route")),
    ),
    Scenario(
        name="model raises in flight",
        setup=setup(),
        breaks=(Break(fault=computer.ModelRaises(), at_s=6.0),),
        limit_s=30.0,
        ending=Ending.FLIES_ON,
        follows=(said(10.0, "SIFT stands in"),),
    ),
]
