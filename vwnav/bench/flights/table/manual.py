"""The table of faults for the manual."""

from vwnav.bench.flights.table import TABLE, family_of

_HEAD = ("| family | fault | where, when | expected |", "|---|---|---|---|")


def manual() -> str:
    """A row for each fault, in Markdown."""
    rows = (f"| {family_of(r)} | {r.name} | {r.where}, {r.when} | {r.expected} |" for r in TABLE)
    return "\n".join([*_HEAD, *rows])
