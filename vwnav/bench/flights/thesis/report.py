"""A flight test judged and drawn."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from vwnav.bench.flights.thesis.plots import save_plots
from vwnav.bench.flights.thesis.samples import Sample, write_csv
from vwnav.bench.flights.thesis.tests import FlightTest
from vwnav.bench.flights.thesis.verdict import Statistic, Step, statistics, steps


@dataclass(frozen=True, slots=True)
class TestReport:
    """What became of a test.

    Attributes:
        statistics: none where it never got so far.
        files: that were written to its folder.
        timeline: what the program said, a line each.
    """

    name: str
    steps: tuple[Step, ...]
    statistics: tuple[Statistic, ...]
    files: tuple[str, ...]
    timeline: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """Every step did."""
        return all(step.passed for step in self.steps)


def report_on(
    test: FlightTest, samples: Sequence[Sample], said: Sequence[str], folder: Path
) -> TestReport:
    """Judge what was noted, write the plots and the table.

    Raises:
        VwnavError: matplotlib is missing.
    """
    table = f"{test.name}.csv"
    write_csv(samples, folder / table)
    files = (table, *save_plots(test, samples, folder))
    judged, numbers = tuple(steps(test, samples)), tuple(statistics(test, samples))
    return TestReport(test.name, judged, numbers, files, tuple(said))
