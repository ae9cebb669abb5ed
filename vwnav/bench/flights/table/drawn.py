"""Bad days that nobody thought of: the faults of two to four rows in one flight, at drawn times.

The aircraft is off by what its filter is told that it may be, but where a row says otherwise.
Nothing is expected of such a flight but that it breaks none of the rules of every flight, blames no
part that is as it should be, and is not left hanging in the air (`vwnav.bench.flights.judge`).
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
from vwnav.bench.flights.setup import AirStart, Setup
from vwnav.sim.map_warp import MapWarp

DRAWN = "drawn"
_SEED = 20261127
_GROUND_SHARE = 0.25  # of the flights begin on the ground; in the others no row that does has part
_THREE_SHARE = 1.0 / 3.0  # have the faults of three rows, the others of two
_PERSON_SHARE = 1.0 / 3.0  # have a person in them besides, who acts as in a row of these names
_PERSONS = ("pilot ", "the ground station ", "a second station ")
_STARTS = (ROUTE, ROUTE, ROUTE, RETURN, CLIMB, DESCEND)
_WINDS_M_S = (2.0, 4.0, 8.0, 10.0)
_SHIFTED_S = (-4.0, 8.0)
_ANYWHEN_S = (0.0, 90.0)  # of a flight from the ground, what belongs to one in the air
_LASTS = (0.5, 1.5)  # times as long as in its row
_BRIEF_S = 0.5  # what is no longer keeps its length: one sample of something
_LIMIT_S, _FROM_GROUND_S = 110.0, 170.0


def drawn(number: int, families: dict[str, list[Scenario]]) -> Scenario:
    """Flight `number`, the same each time as long as the table is."""
    rng = np.random.default_rng([_SEED, number])
    from_ground = bool(rng.random() < _GROUND_SHARE)
    pool = {
        name: found for name, rows in families.items() if (found := _mixable(rows, from_ground))
    }
    count = 3 if rng.random() < _THREE_SHARE else 2
    sizes = np.array([len(rows) for rows in pool.values()])
    names = rng.choice(list(pool), count, replace=False, p=sizes / sizes.sum()).tolist()
    rows = [pool[name][int(rng.integers(len(pool[name])))] for name in names]
    if rng.random() < _PERSON_SHARE and not any(map(_has_person, rows)):
        persons = [row for each in pool.values() for row in each if _has_person(row)]
        rows.append(persons[int(rng.integers(len(persons)))])
    changes = {
        **off_as_told(rng),
        "map_warp": MapWarp(),  # to the rules its error would be the estimate's
        "seed": int(rng.integers(1, 2**31)),
        "wind_m_s": float(rng.choice(_WINDS_M_S)),
        "wind_from_deg": float(rng.uniform(0.0, 360.0)),
    }
    for row in rows:
        changes |= _changed(row)
    start = None if from_ground else _start_of(rows, rng)
    breaks = [each for row in rows for each in _shifted(row, start, rng)]
    phase = "from the ground" if start is None or start.phase is None else start.phase.value
    return Scenario(
        name=f"{DRAWN} {number}: {' + '.join(row.name for row in rows)}, {phase}",
        setup=replace(setup(start), **changes),
        breaks=tuple(sorted(breaks, key=lambda each: (_waits(each), each.at_s))),
        limit_s=_FROM_GROUND_S if start is None else _LIMIT_S,
        ending=Ending.ANYHOW,
        faster_m_s=max(row.faster_m_s for row in rows),
        map_off_m=max(row.map_off_m for row in rows),
    )


def number_of(name: str) -> int | None:
    """Of a drawn flight, by its name; None of a row of the table."""
    found = re.match(rf"{DRAWN} (\d+):", name)
    return None if found is None else int(found[1])


def _mixable(rows: list[Scenario], from_ground: bool) -> list[Scenario]:
    """Those in which something is otherwise than as it always is; none that somebody else flies."""
    return [
        row
        for row in rows
        if (row.breaks or _changed(row))
        and (from_ground if row.setup.start is None else row.setup.start.phase is not None)
    ]


def _has_person(row: Scenario) -> bool:
    return row.name.startswith(_PERSONS)


def _start_of(rows: list[Scenario], rng: np.random.Generator) -> AirStart | None:
    """Where one of the rows begins that does not begin on the route."""
    starts = [row.setup.start for row in rows if row.setup.start != ROUTE] or _STARTS
    return starts[int(rng.integers(len(starts)))]


def _changed(row: Scenario) -> dict[str, object]:
    """What is otherwise with a row's setup than as it always is, but for where it begins."""
    usual = setup(row.setup.start)
    values = ((each.name, getattr(row.setup, each.name)) for each in fields(Setup))
    return {name: value for name, value in values if value != getattr(usual, name)}


def _waits(each: Break) -> bool:
    """For something of the flight, which may never come."""
    return each.phase is not None or each.armed


def _shifted(row: Scenario, start: AirStart | None, rng: np.random.Generator) -> list[Break]:
    """What is there from the first moment on stays so."""
    is_elsewhere = start is None is not row.setup.start
    shift_s = float(rng.uniform(*(_ANYWHEN_S if is_elsewhere else _SHIFTED_S)))
    found = []
    for each in row.breaks:
        is_brief = each.for_s is None or each.for_s <= _BRIEF_S
        for_s = each.for_s if is_brief else float(rng.uniform(*_LASTS)) * (each.for_s or 0.0)
        from_start = each.at_s == 0.0 and not _waits(each)
        more_s = min(shift_s, _SHIFTED_S[1]) if _waits(each) else shift_s
        at_s = 0.0 if from_start else max(each.at_s + more_s, 0.0)
        found.append(replace(each, at_s=at_s, for_s=for_s))
    return found
