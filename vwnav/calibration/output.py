"""Where a calibration is written: looked at before the work whose result it shall hold."""

import os
from pathlib import Path

from vwnav.errors import CalibrationError

_SUFFIXES = (".toml", ".json")


def check_writable(path: Path) -> None:
    """See that a calibration can be written there, and writes over nothing.

    Raises:
        CalibrationError: it is of another suffix, there already, or in no folder that may be
            written.
    """
    if path.suffix.lower() not in _SUFFIXES:
        raise CalibrationError(f"{path}: a calibration is written as .toml or .json")
    if path.exists():
        raise CalibrationError(f"{path} is there already; give another file with -o")
    if not path.parent.is_dir():
        raise CalibrationError(f"no folder {path.parent} to write {path} to")
    if not os.access(path.parent, os.W_OK):
        raise CalibrationError(f"{path}: its folder may not be written; give another with -o")
