"""The whole program with one thing broken, row by row, in lockstep."""

import re
from dataclasses import replace

import pytest

from vwnav.bench.flights.fly import fly
from vwnav.bench.flights.judge import judge
from vwnav.bench.flights.lockstep_place import lockstep_place
from vwnav.bench.flights.scenario import Scenario
from vwnav.bench.flights.table import QUICK, TABLE, drawn_rows
from vwnav.bench.flights.table.manners import FLOWN_IN_COPTER_MANNERS, in_manners
from vwnav.sim.config import Manners


@pytest.mark.parametrize(
    "scenario",
    [
        pytest.param(row, id=row.name, marks=() if row.name in QUICK else pytest.mark.long)
        for row in TABLE
    ],
)
def test_whatever_breaks_the_aircraft_is_not_lost(scenario: Scenario) -> None:
    verdict = judge(fly(scenario, lockstep_place()))
    assert not verdict.wrong, "; ".join(verdict.wrong)


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(FLOWN_IN_COPTER_MANNERS))
def test_neither_is_it_in_arducopters_manners(name: str) -> None:
    row = next(row for row in TABLE if row.name == name)
    verdict = judge(fly(in_manners(row, "copter"), lockstep_place()))
    assert not verdict.wrong, "; ".join(verdict.wrong)


@pytest.mark.long
@pytest.mark.parametrize("seed", [2, 4, 5, 6])
def test_after_a_cut_in_a_climb_it_lands_on_its_velocity_where_the_map_shows_nothing(
    seed: int,
) -> None:
    row = next(row for row in TABLE if row.name == "link cut for 10 s while climbing")
    verdict = judge(fly(replace(row, setup=replace(row.setup, seed=seed)), lockstep_place()))
    assert not verdict.wrong, "; ".join(verdict.wrong)


@pytest.mark.long
@pytest.mark.parametrize("manners", ["px4", "copter"])
def test_a_home_that_is_told_22_m_off_is_found_out_and_not_returned_to(manners: Manners) -> None:
    """Not in the table: until the first fix no estimate can tell that it was told wrongly.

    It was landed again, "the map shows another place", and the camera blamed.
    """
    row = in_manners(next(row for row in TABLE if row.name == "nothing breaks"), manners)
    off = replace(row, setup=replace(row.setup, home_off_ne_m=(16.0, -16.0)))
    flown = fly(off, lockstep_place())
    said = "\n".join(line.text for line in flown.track.events)
    assert judge(flown).landed_off_m < 1.5
    assert re.search(r"the aircraft stood 2[23] m from the home that was given", said)
    assert "descending" in said
    assert "hangs otherwise" not in said


# A pilot landed against, a rule that forgot the line's own time, an aircraft that hovers at 0.2 m,
# one that swings without a gyro, a spare watchdog that let a setpoint through to a pilot. A table
# that changes makes others of them, which hold as well.
@pytest.mark.long
@pytest.mark.parametrize(
    ("number", "manners"),
    [(6009, "px4"), (6354, "px4"), (7117, "px4"), (7013, "copter"), (7139, "px4-1.16")],
)
def test_drawn_flights_that_once_broke_a_rule_break_none(number: int, manners: Manners) -> None:
    row = in_manners(drawn_rows(1, number)[0], manners)
    verdict = judge(fly(row, lockstep_place()))
    assert not verdict.wrong, "; ".join(verdict.wrong)


def test_the_named_rows_are_in_the_table() -> None:
    names = [row.name for row in TABLE]
    assert len(set(names)) == len(names)
    assert set(names) >= QUICK | FLOWN_IN_COPTER_MANNERS
