"""What `vwnav replay --check` does: a recording against the rules of every flight."""

import sys
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from vwnav.recording.recorded_flight_log import recorded_flight_log
from vwnav.rules.rule import RuleVerdict, check
from vwnav.rules.table import RULES
from vwnav.screen import say

_COLOURS = {"held": "green", "broken": "red", "not to be told": "dim"}
_WIDTH = 140  # of a file, which has none of its own


def check_recording(path: Path, truth: Path | None) -> int:
    """Print the verdict of each rule; 1 when one is broken, else 0.

    Raises:
        SourceError: the recording, or the truth, cannot be read.
    """
    log = recorded_flight_log(path, truth)
    begun_s = log.vehicle[0].t_s
    verdicts = check(RULES, log)
    width = None if sys.stdout.isatty() else _WIDTH
    Console(file=sys.stdout, highlight=False, width=width).print(_table(verdicts, begun_s))
    broken = [each.rule.name for each in verdicts if each.breach is not None]
    told = sum(not each.missing for each in verdicts)
    if broken:
        say(f"replay: {len(broken)} of {told} rules broken: {', '.join(broken)}")
        return 1
    say(f"replay: all {told} rules held that this recording can tell, of {len(verdicts)}")
    return 0


def _table(verdicts: list[RuleVerdict], begun_s: float) -> Table:
    """Times are seconds since the recording's first telemetry."""
    table = Table(title="rules", title_justify="left")
    for name in ("rule", "verdict", "at s", "what"):
        table.add_column(name, justify="right" if name == "at s" else "left")
    for each in verdicts:
        at = "" if each.breach is None else f"{each.breach.t_s - begun_s:.1f}"
        what = each.missing if each.breach is None else each.breach.what
        verdict = Text(each.outcome, style=_COLOURS[each.outcome])
        table.add_row(Text(each.rule.says), verdict, at, Text(what))
    return table
