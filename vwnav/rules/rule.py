"""A rule, and what a flight log says of it."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Literal

from vwnav.rules.flight_log import FlightLog
from vwnav.rules.temporal import Breach

Outcome = Literal["held", "broken", "not to be told"]

NAVIGATOR, WATCHDOG = 191, 192  # MAV_COMP_ID_ONBOARD_COMPUTER and the second
PILOT_S = 0.3  # from the pilot's mode to the last that is asked for


@dataclass(frozen=True, slots=True)
class Rule:
    """One property of every flight.

    Attributes:
        says: the rule in a sentence.
        needs: streams of the log without which it cannot be told.
        breach: the first breach in a log that has those; None when it is kept.
        whole: it looks at gaps, so a log that is sampled cannot tell.
    """

    name: str
    says: str
    needs: tuple[str, ...]
    breach: Callable[[FlightLog], Breach | None]
    whole: bool = False


@dataclass(frozen=True, slots=True)
class RuleVerdict:
    """What a log says of a rule; `breach` where it is broken, `missing` where it cannot tell."""

    rule: Rule
    breach: Breach | None = None
    missing: str = ""

    @property
    def outcome(self) -> Outcome:
        """In a word."""
        if self.missing:
            return "not to be told"
        return "held" if self.breach is None else "broken"


def check(rules: Iterable[Rule], log: FlightLog) -> list[RuleVerdict]:
    """The verdict of each rule."""
    return [_verdict(rule, log) for rule in rules]


def _verdict(rule: Rule, log: FlightLog) -> RuleVerdict:
    missing = [name for name in rule.needs if name in log.unknown]
    if missing:
        return RuleVerdict(rule, missing=f"no {', '.join(missing).replace('_', ' ')}")
    if rule.whole and log.sampled:
        return RuleVerdict(rule, missing="only samples")
    return RuleVerdict(rule, rule.breach(log))
