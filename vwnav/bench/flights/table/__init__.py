"""The table: what breaks, when, what must follow within how many seconds, and the bounds.

Most rows begin in the air, where their fault is. Those named in `QUICK` are flown by `make test`,
one of each kind; all of them by `make test-long` and `vwnav flighttest faults`.
"""

from collections.abc import Iterable

from vwnav.bench.flights.scenario import Scenario
from vwnav.bench.flights.table.aircraft import AUTOPILOT, BATTERY, PILOT
from vwnav.bench.flights.table.computer import DISK_AND_CLOCK, NAVIGATOR, PROCESSOR
from vwnav.bench.flights.table.drawn import DRAWN, drawn, number_of
from vwnav.bench.flights.table.ground import MAP, MODEL, RELIEF
from vwnav.bench.flights.table.images import IMAGES
from vwnav.bench.flights.table.link import LINK
from vwnav.bench.flights.table.telemetry import TELEMETRY
from vwnav.bench.flights.table.together import TOGETHER
from vwnav.bench.flights.table.whole import WHOLE, WIND

FAMILIES: dict[str, list[Scenario]] = {
    "pictures": IMAGES,
    "telemetry": TELEMETRY,
    "relief": RELIEF,
    "map": MAP,
    "model": MODEL,
    "link": LINK,
    "battery": BATTERY,
    "pilot": PILOT,
    "autopilot": AUTOPILOT,
    "wind": WIND,
    "processor": PROCESSOR,
    "navigator": NAVIGATOR,
    "disk and clock": DISK_AND_CLOCK,
    "several at once": TOGETHER,
    "whole flights": WHOLE,
}
TABLE = [row for rows in FAMILIES.values() for row in rows]
QUICK = {
    "one attitude level and facing north",
    "attitude 0.3 s late",
    "pictures black for good at 50 m",
    "no fix for 12 s, pictures whose exposure hunts",
    "link cut for 5 s on the route",
    "pilot hands back, and takes over again while the link is cut",
    "navigator stopped for 20 s",
    "pictures dated 0.1 s late and nobody knows, and the navigator killed on the route",
    "processor starved for 1 s",
    "model raises in flight",
    "pilot takes over while on the route",
    "pilot stops the motors while climbing",
    "take-off refused",
    "simulator stands still for 0.6 s",
}


def family_of(row: Scenario) -> str:
    """The name of a row's family."""
    if number_of(row.name) is not None:
        return DRAWN
    names = {family: [each.name for each in rows] for family, rows in FAMILIES.items()}
    return next(family for family in names if row.name in names[family])


def row_of(name: str) -> Scenario:
    """The row of that name, of the table or drawn."""
    number = number_of(name)
    if number is not None:
        return drawn(number, FAMILIES)
    return next(each for each in TABLE if each.name == name)


def drawn_rows(count: int, first: int) -> list[Scenario]:
    """Flights `first` and so on of those that are drawn."""
    return [drawn(number, FAMILIES) for number in range(first, first + count)]


def rows_named(parts: Iterable[str]) -> list[Scenario]:
    """Rows with one of the parts in their name, all of them where there are no parts."""
    wanted = [part.casefold() for part in parts]
    return [row for row in TABLE if not wanted or any(p in row.name.casefold() for p in wanted)]


_HEAD = ("| family | fault | where, when | expected |", "|---|---|---|---|")


def manual() -> str:
    """A row for each fault, in Markdown."""
    rows = (f"| {family_of(r)} | {r.name} | {r.where}, {r.when} | {r.expected} |" for r in TABLE)
    return "\n".join([*_HEAD, *rows])
