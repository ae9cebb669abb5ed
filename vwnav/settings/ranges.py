"""Where each number of the settings makes sense, declared beside it, and asked in one place.

Written as `land_from_m: Annotated[float, Within(3.0, 50.0)] = 5.0` in a class of `Settings`.
"""

import math
from collections.abc import Mapping
from dataclasses import Field, dataclass, fields
from typing import Annotated, Any, ClassVar, get_args, get_origin


@dataclass(frozen=True, slots=True)
class Within:
    """From `lowest` to `highest`, both among them; with `above` the lowest is not."""

    lowest: float
    highest: float
    above: bool = False

    def __contains__(self, value: float) -> bool:
        low_enough = value > self.lowest if self.above else value >= self.lowest
        return math.isfinite(value) and low_enough and value <= self.highest

    def __str__(self) -> str:
        if self.above:
            return f"above {self.lowest:g}, at most {self.highest:g}"
        return f"{self.lowest:g} to {self.highest:g}"


NotNegative = Annotated[float, Within(0.0, 1e4)]
Positive = Annotated[float, Within(0.0, 1e4, above=True)]
Angle = Annotated[float, Within(0.0, math.pi)]
Share = Annotated[float, Within(0.0, 1.0)]
Count = Annotated[int, Within(1, 10_000)]


@dataclass(frozen=True, slots=True)
class Settings:
    """A table of settings; each is refused where it makes no sense.

    Attributes:
        AT_MOST: pairs of names; the first of a pair is at most the second.
    """

    AT_MOST: ClassVar[tuple[tuple[str, str], ...]] = ()

    def __post_init__(self) -> None:
        """Raise ValueError that names setting, value and range."""
        for each in fields(self):
            _check(each, getattr(self, each.name))
        for lower, upper in self.AT_MOST:
            low, high = getattr(self, lower), getattr(self, upper)
            if low > high:
                raise ValueError(f"{lower} = {low:g}: expected at most {upper}, which is {high:g}")


def check_written(table: type[Settings], written: Mapping[str, Any]) -> None:
    """Hold what stands in a file against the ranges, before `true` becomes 1 and "4" becomes 4.

    Raises:
        ValueError: naming setting, value and range.
    """
    for each in fields(table):
        if each.name in written:
            _check(each, written[each.name])


def _check(setting: "Field[Any]", value: Any) -> None:
    expected = _unlike(setting.type, value)
    if expected:
        raise ValueError(f"{setting.name} = {in_short(value)}: expected {expected}")


def _unlike(kind: Any, value: Any) -> str:
    """What was expected of a value of such a kind, "" where it is that."""
    if kind is bool:
        return "" if isinstance(value, bool) else "true or false"
    if get_origin(kind) is not Annotated:
        return ""
    plain, bounds = get_args(kind)
    if get_origin(plain) is tuple:
        return _unlike_numbers(get_args(plain), bounds, value)
    return _unlike_number(plain, bounds, value)


def _unlike_number(plain: type, bounds: Within, value: Any) -> str:
    numbers = (int,) if plain is int else (int, float)
    if isinstance(value, numbers) and not isinstance(value, bool) and value in bounds:
        return ""
    return f"a whole number, {bounds}" if plain is int else str(bounds)


def _unlike_numbers(kinds: tuple[Any, ...], bounds: Within, value: Any) -> str:
    """Of a pair, the lowest and the highest of something, or of any count."""
    is_pair = kinds[-1] is not Ellipsis
    expected = f"a list, each {bounds}"
    if is_pair:
        expected = f"two numbers that ascend, each {bounds}"
    if not isinstance(value, list | tuple) or (is_pair and len(value) != len(kinds)):
        return expected
    fits = not any(_unlike_number(kinds[0], bounds, each) for each in value)
    return "" if fits and not (is_pair and sorted(value) != list(value)) else expected


def in_short(value: Any) -> str:
    """As TOML has it, on one line."""
    text = str(value).lower() if isinstance(value, bool) else " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:57]}..."
