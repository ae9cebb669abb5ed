"""One line of a list of what is looked at before a flight."""

from dataclasses import dataclass
from typing import Literal

CheckVerdict = Literal["PASS", "WARN", "FAIL"]


@dataclass(frozen=True, slots=True)
class Check:
    """What was looked at, how it is, and what is to be done about it."""

    name: str
    verdict: CheckVerdict
    detail: str
