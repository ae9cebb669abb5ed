"""The whole program with one thing broken, row by row, in lockstep."""

import pytest
from scenario_place import default_place
from scenario_table import QUICK, TABLE

from vwnav.bench.flights.judge import judge
from vwnav.bench.flights.scenario import Scenario, fly


@pytest.mark.parametrize(
    "scenario",
    [
        pytest.param(row, id=row.name, marks=() if row.name in QUICK else pytest.mark.long)
        for row in TABLE
    ],
)
def test_whatever_breaks_the_aircraft_is_not_lost(scenario: Scenario) -> None:
    verdict = judge(fly(scenario, default_place()))
    assert not verdict.wrong, "; ".join(verdict.wrong)


def test_the_quick_rows_are_in_the_table() -> None:
    names = [row.name for row in TABLE]
    assert len(set(names)) == len(names)
    assert set(names) >= QUICK
