"""What a person sees while a command runs: a live line on stderr, a table on stdout at the end."""

import contextlib
import io
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TextIO, cast

from rich.console import Console
from rich.live import Live
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
)
from rich.table import Table
from rich.text import Text

from vwnav.safety.check import Check

_FILE_WIDTH = 160


class _Stderr:
    """sys.stderr, of which what cannot be written is lost, and ends nothing.

    A terminal that was closed, `tee` that was ended or a log on a full disk raise at the next line,
    and rich ends the thread that said it (`Console.on_broken_pipe`): in flight the link's, say.
    """

    def write(self, text: str) -> int:
        with contextlib.suppress(OSError, ValueError, AttributeError):  # closed, since or before
            sys.stderr.write(text)
        return len(text)

    def flush(self) -> None:
        with contextlib.suppress(OSError, ValueError, AttributeError):
            sys.stderr.flush()

    def __getattr__(self, name: str) -> object:
        return getattr(sys.stderr or _NOWHERE, name)


_NOWHERE = io.StringIO()
talk = Console(file=cast(TextIO, _Stderr()), highlight=False)


def say(line: str) -> None:
    """One event, on stderr, above the live line."""
    talk.print(line, markup=False, soft_wrap=True)


class LiveLine:
    """One line that is rewritten in place on a terminal, and printed now and then elsewhere."""

    def __init__(self, every_s: float = 10.0) -> None:
        self._live = Live(console=talk, refresh_per_second=4, transient=True)
        self._every_s = every_s
        self._last_s = -every_s

    def __enter__(self) -> "LiveLine":
        if talk.is_terminal:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._live.stop()

    def show(self, t_s: float, line: str) -> None:
        """Show `line`; `t_s` is the time it is about."""
        if talk.is_terminal:
            self._live.update(Text(line, no_wrap=True, overflow="ellipsis"))
        elif t_s - self._last_s >= self._every_s:
            self._last_s = t_s
            say(line)


def print_table(title: str, rows: list[tuple[str, str]]) -> None:
    """The table at the end of a run, on stdout."""
    table = Table(title=Text(title), show_header=False, title_justify="left")
    table.add_column(style="bold")
    table.add_column(justify="right", overflow="fold")  # a path that is cut leads nowhere
    for name, value in rows:
        table.add_row(Text(name), Text(value))
    Console(file=sys.stdout, highlight=False).print(table)


def verdict_cell(passed: bool) -> Text:
    """Of a table: what came out of a test."""
    return Text("pass", style="green") if passed else Text("FAIL", style="red")


def print_rows(title: str, header: Iterable[str], rows: Iterable[Iterable[str | Text]]) -> None:
    """A table with a header, on stdout."""
    table = Table(*header, title=Text(title), title_justify="left")
    for row in rows:
        table.add_row(*(Text(cell) if isinstance(cell, str) else cell for cell in row))
    # A file has no width of its own.
    width = None if sys.stdout.isatty() else _FILE_WIDTH
    Console(file=sys.stdout, highlight=False, width=width).print(table)


_COLOURS = {"PASS": "green", "WARN": "yellow", "FAIL": "red"}


def check_table(checks: Iterable[Check]) -> Table:
    """The readiness list as a table."""
    table = Table(show_header=False)
    for _ in range(3):  # what is cut at a narrow terminal's edge may be a parameter's name
        table.add_column(overflow="fold")
    for check in checks:
        verdict = Text(check.verdict, style=_COLOURS[check.verdict])
        table.add_row(verdict, Text(check.name), Text(check.detail))
    return table


class ReadinessTable:
    """The readiness list on stderr: all of it at first, then what is not as it was."""

    def __init__(self) -> None:
        self._shown: tuple[Check, ...] = ()

    def show(self, checks: tuple[Check, ...]) -> None:
        """Show what has changed since the last time, and what is in the way no more."""
        changed = [check for check in checks if check not in self._shown]
        names = {check.name for check in checks}
        gone = [
            Check(check.name, "PASS", f"no more: {check.detail}")
            for check in self._shown
            if check.verdict != "PASS" and check.name not in names
        ]
        self._shown = checks
        if changed or gone:
            talk.print(check_table([*changed, *gone]))


@contextmanager
def progress_bar() -> Iterator[Callable[[str, int, int], None]]:
    """Bars on stderr, one for each kind of work: call with what, done, total."""
    columns = (
        TextColumn("{task.description:16}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=talk) as bars:
        tasks: dict[str, TaskID] = {}

        def report(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = bars.add_task(what, total=total)
            bars.update(tasks[what], completed=done)

        yield report
