"""Loads matplotlib when something is drawn, and says what to install where it is missing."""

from typing import Any

from vwnav.errors import VwnavError


def pyplot() -> Any:
    """`matplotlib.pyplot`, drawing to files.

    Raises:
        VwnavError: it is not installed.
    """
    try:
        import matplotlib
    except ImportError as error:
        raise VwnavError("plots need matplotlib: pip install 'vwnav[eval]'") from error
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt
