"""Days on which nothing goes right, flown by the whole program but for its eyes (`told`)."""

import pytest
from days import against_stations, day, restless
from told import fly_told

from tests.quick import first_quick
from vwnav.bench.flights.judge import judge
from vwnav.bench.flights.lockstep_place import lockstep_place


@pytest.mark.parametrize(
    "number",
    first_quick(range(120), 3),
)
def test_a_day_on_which_several_things_break_ends_well(number: int) -> None:
    flown = fly_told(day(number), lockstep_place())
    assert not [*judge(flown).wrong, *against_stations(flown), *restless(flown)]
