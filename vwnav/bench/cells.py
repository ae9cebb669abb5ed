"""Values of the benchmarks as the cells of a table, and rounded for JSON."""

_DIGITS = 4


def percent(ratio: float | None) -> str:
    """A share as a percentage."""
    return "-" if ratio is None else f"{100.0 * ratio:.1f}"


def number(value: float | None) -> str:
    """With two decimals."""
    return "-" if value is None else f"{value:.2f}"


def rounded(value: object) -> object:
    """Every float in it rounded, dictionaries too."""
    if isinstance(value, dict):
        return {key: rounded(each) for key, each in value.items()}
    return round(value, _DIGITS) if isinstance(value, float) else value
