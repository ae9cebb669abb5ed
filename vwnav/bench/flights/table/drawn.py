"""Bad days that nobody thought of: the faults of two or three rows in one flight, at drawn times.

The aircraft is off by what its filter is told that it may be. Nothing is expected of such a flight
but that it breaks none of the rules of every flight, and blames no part that is as it should be.
"""

import re
from dataclasses import fields, replace

import numpy as np

from vwnav.bench.flights.campaign import off_as_told
from vwnav.bench.flights.scenario import (
    CLIMB,
    DESCEND,
    RETURN,
    ROUTE,
    Break,
    Ending,
    Scenario,
    setup,
)
from vwnav.bench.flights.setup import Setup
from vwnav.sim.map_warp import MapWarp

DRAWN = "drawn"
_SEED = 20261126
_THREE_SHARE = 1.0 / 3.0  # of the flights have the faults of three rows, the others of two
_STARTS = (ROUTE, ROUTE, ROUTE, RETURN, CLIMB, DESCEND)
_WINDS_M_S = (2.0, 4.0, 8.0, 10.0)
_SHIFTED_S = (-4.0, 8.0)
_LASTS = (0.5, 1.5)  # times as long as in its row
_BRIEF_S = 0.5  # what is no longer keeps its length: one sample of something
_LIMIT_S = 110.0


def drawn(number: int, families: dict[str, list[Scenario]]) -> Scenario:
    """Flight `number`, the same each time as long as the table is."""
    rng = np.random.default_rng([_SEED, number])
    pool = {name: found for name, rows in families.items() if (found := _mixable(rows))}
    count = 3 if rng.random() < _THREE_SHARE else 2
    names = rng.choice(sorted(pool), count, replace=False).tolist()
    rows = [pool[name][int(rng.integers(len(pool[name])))] for name in names]
    changes = {
        **off_as_told(rng),
        "map_warp": MapWarp(),  # to the rules its error would be the estimate's
        "seed": int(rng.integers(1, 2**31)),
        "wind_m_s": float(rng.choice(_WINDS_M_S)),
        "wind_from_deg": float(rng.uniform(0.0, 360.0)),
    }
    for row in rows:
        changes |= _changed(row)
    start = _STARTS[int(rng.integers(len(_STARTS)))]
    breaks = [each for row in rows for each in _shifted(row, rng)]
    phase = start.phase.value if start.phase is not None else ""
    return Scenario(
        name=f"{DRAWN} {number}: {' + '.join(row.name for row in rows)}, {phase}",
        setup=replace(setup(start), **changes),
        breaks=tuple(sorted(breaks, key=lambda each: each.at_s)),
        limit_s=_LIMIT_S,
        ending=Ending.ANYHOW,
        faster_m_s=max(row.faster_m_s for row in rows),
        map_off_m=max(row.map_off_m for row in rows),
    )


def number_of(name: str) -> int | None:
    """Of a drawn flight, by its name; None of a row of the table."""
    found = re.match(rf"{DRAWN} (\d+):", name)
    return None if found is None else int(found[1])


def _mixable(rows: list[Scenario]) -> list[Scenario]:
    """Those in which something breaks at a time of the flight on the route."""
    return [
        row
        for row in rows
        if row.breaks
        and row.setup.start == ROUTE
        and not any(each.phase is not None or each.armed for each in row.breaks)
    ]


def _changed(row: Scenario) -> dict[str, object]:
    """What is otherwise with a row's setup than as it always is."""
    usual = setup()
    values = ((each.name, getattr(row.setup, each.name)) for each in fields(Setup))
    return {name: value for name, value in values if value != getattr(usual, name)}


def _shifted(row: Scenario, rng: np.random.Generator) -> list[Break]:
    shift_s = float(rng.uniform(*_SHIFTED_S))
    found = []
    for each in row.breaks:
        is_brief = each.for_s is None or each.for_s <= _BRIEF_S
        for_s = each.for_s if is_brief else float(rng.uniform(*_LASTS)) * (each.for_s or 0.0)
        found.append(replace(each, at_s=max(each.at_s + shift_s, 0.0), for_s=for_s))
    return found
