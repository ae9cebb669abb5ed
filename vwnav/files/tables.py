"""Tables as CSV: rows with their lines, and one line of complaint where they cannot be read."""

import csv
from collections import Counter
from collections.abc import Iterable, Iterator
from itertools import zip_longest
from pathlib import Path

from vwnav.errors import VwnavError


def numbered_rows(
    lines: Iterable[str], path: Path, error: type[VwnavError], delimiter: str = ","
) -> Iterator[tuple[int, list[str]]]:
    """Each row's last line, counted from 1, and its cells without the spaces around them.

    Args:
        lines: of the text, or an open file; empty ones are passed over.
        path: named in what is raised.
        error: what is raised.
        delimiter: between two cells.

    Raises:
        VwnavError: an `error`; a row is none of CSV, as the megabytes of another kind of file.
    """
    rows = csv.reader(lines, delimiter=delimiter, skipinitialspace=True)
    try:
        for cells in rows:
            if cells:
                yield rows.line_num, [cell.strip() for cell in cells]
    except csv.Error as wrong:
        raise error(f"{path}, line {rows.line_num}: no row of a CSV table ({wrong})") from wrong


def named_rows(
    lines: Iterable[str], path: Path, error: type[VwnavError]
) -> tuple[list[str], Iterator[tuple[int, dict[str, str]]]]:
    """The columns that a table's first row names, and the others: line, and cells by column.

    A cell that a short row lacks is empty; those beyond the last column are left out. Arguments and
    errors are those of `numbered_rows`, and two columns of one name: nobody knows which one counts.
    """
    rows = numbered_rows(lines, path, error)
    _, columns = next(rows, (0, []))
    twice = next((name for name, count in Counter(columns).items() if name and count > 1), None)
    if twice is not None:
        raise error(f"{path}: has two columns {twice}; leave out the wrong one")
    named = (
        (line, dict(zip_longest(columns, cells[: len(columns)], fillvalue="")))
        for line, cells in rows
    )
    return columns, named
