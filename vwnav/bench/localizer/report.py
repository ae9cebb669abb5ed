"""The report as one JSON object, and as tables for a person."""

from collections.abc import Iterator
from dataclasses import asdict

from rich.box import SIMPLE_HEAD
from rich.table import Table

from vwnav.bench.cells import number, percent, rounded
from vwnav.bench.localizer.looks import LookKind
from vwnav.bench.localizer.scoring import (
    LocalizerReport,
    LookScore,
    ShortFlightOutcome,
    sequence_scores,
)

_TITLES: dict[LookKind, str] = {
    "prior": "the right place, a rough prior",
    "search": "the right place, no position and no heading",
    "wrong": "places that the map does not show, with a prior",
    "wrong_search": "places that the map does not show, without",
}


def as_json(report: LocalizerReport) -> dict[str, object]:
    """Plain values; `docs/benchmarks.md` says what each means."""
    return {
        "scores": [
            {
                "group": group,
                "kind": kind,
                "features": {n: rounded(asdict(s)) for n, s in by.items()},
            }
            for group, kind, by in report.scores()
        ],
        "false": {
            name: [rounded(asdict(each)) for each in outcomes if each.false]
            for name, outcomes in report.outcomes.items()
        },
    }


def tables(report: LocalizerReport) -> Iterator[Table]:
    """One for each group and kind of look."""
    for group, kind, by_features in report.scores():
        columns = [
            "features",
            "looks",
            "located %",
            "held",
            "false",
            "< %",
            "error",
            "95 %",
            "NEES",
        ]
        columns += ["inside %", "worst", "looks/s", "rejected"]
        table = Table(
            title=f"{group}: {_TITLES[kind]}",
            title_justify="left",
            box=SIMPLE_HEAD,
            padding=(0, 1, 0, 0),
        )
        for column in columns:
            left = column in ("features", "rejected")
            table.add_column(column, justify="left" if left else "right", no_wrap=not left)
        for name, each in by_features.items():
            table.add_row(name, *_cells(each))
        yield table


def sequences_as_json(outcomes: dict[str, list[ShortFlightOutcome]]) -> dict[str, object]:
    """Plain values; the flights with a fix that misleads by name."""
    return {
        "scores": {
            name: [rounded(asdict(each)) for each in sequence_scores(flights)]
            for name, flights in outcomes.items()
        },
        "false": {
            name: [asdict(each) for each in flights if each.alone_false or each.joined_false]
            for name, flights in outcomes.items()
        },
    }


def sequence_table(outcomes: dict[str, list[ShortFlightOutcome]]) -> Table:
    """A line for each feature set, kind of look and group."""
    columns = ["features", "group", "kind", "flights", "found", "joined", "first", "joined"]
    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for place, column in enumerate([*columns, "false", "joined"]):
        table.add_column(column, justify="left" if place < 3 else "right", no_wrap=True)
    for name, flights in outcomes.items():
        for each in sequence_scores(flights):
            found, first = (each.alone, each.joined), (each.alone_first, each.joined_first)
            counts = (str(value) for value in (each.flights, *found))
            false = (str(value) for value in (each.alone_false, each.joined_false))
            table.add_row(name, each.group, each.kind, *counts, *map(number, first), *false)
    return table


def _cells(each: LookScore) -> list[str]:
    return [
        f"{each.looks}",
        percent(each.located),
        f"{each.held}",
        f"{each.false}",
        f"{100.0 * each.false_bound:.2f}",
        number(each.error_median),
        number(each.error_95),
        number(each.nees),
        percent(each.inside),
        number(each.worst_sigmas),
        f"{each.per_s:.1f}",
        ", ".join(f"{reason} {count}" for reason, count in each.rejected.items()),
    ]
