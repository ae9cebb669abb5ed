"""What the numbers of all commands have in common."""

import math

import typer


def finite(value: float | None) -> float | None:
    """An option's number as it is; bounds let `nan` pass, which lies on neither side of them.

    Raises:
        typer.BadParameter: it is not a number, or infinite.
    """
    if value is not None and not math.isfinite(value):
        raise typer.BadParameter(f"{value} is no number to go by")
    return value


def all_finite(values: list[float] | None) -> list[float] | None:
    """The same of an option that may be repeated.

    Raises:
        typer.BadParameter: one is not a number, or infinite.
    """
    for value in values or []:
        finite(value)
    return values
