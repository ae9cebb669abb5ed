"""Figures of the benchmarks; matplotlib, of the eval extra, is loaded when one is drawn."""

from pathlib import Path
from typing import Any

from vwnav.errors import VwnavError
from vwnav.machine.extras import how_to_install


def pyplot() -> Any:
    """Matplotlib's, drawing to files.

    Raises:
        VwnavError: it is not installed.
    """
    try:
        import matplotlib
    except ImportError as error:
        raise VwnavError(f"plots need matplotlib: {how_to_install('eval')}") from error
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt


def save(figure: Any, path: Path) -> None:
    """Write a figure and forget it."""
    if figure.get_layout_engine() is None:
        figure.tight_layout()
    figure.savefig(path, dpi=120)
    pyplot().close(figure)
