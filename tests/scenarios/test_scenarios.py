"""The whole program with one thing broken, row by row, in lockstep."""

from dataclasses import replace

import pytest

from vwnav.bench.flights.judge import judge
from vwnav.bench.flights.scenario import Scenario, fly
from vwnav.bench.flights.table import QUICK, TABLE
from vwnav.bench.flights.table.manners import FLOWN_IN_COPTER_MANNERS, in_manners
from vwnav.cli.lockstep_place import lockstep_place


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


def test_the_named_rows_are_in_the_table() -> None:
    names = [row.name for row in TABLE]
    assert len(set(names)) == len(names)
    assert set(names) >= QUICK | FLOWN_IN_COPTER_MANNERS


@pytest.mark.long
def test_with_the_lens_covered_it_comes_down_near_in_18_of_20_seeds() -> None:
    covered = next(row for row in TABLE if "pictures black" in row.name)
    far = []
    for seed in range(1, 21):
        row = replace(covered, setup=replace(covered.setup, seed=seed))
        verdict = judge(fly(row, lockstep_place()))
        if verdict.wrong:
            far.append((seed, verdict.wrong))
    assert len(far) <= 2, far
