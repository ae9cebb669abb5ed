"""The table of what is known about images, as CSV: `image` and any of the columns below."""

import math
from pathlib import Path

from vwnav.errors import SourceError
from vwnav.files.tables import named_rows

COLUMNS = ("lat_deg", "lon_deg", "sigma_m", "agl_m", "yaw_deg", "roll_deg", "pitch_deg")
_ABOVE_ZERO = ("sigma_m", "agl_m")
MAX_BYTES = 100_000_000


def read_metadata_table(path: Path) -> dict[str, dict[str, float]]:
    """What a CSV says of each image: by file name, the values of `COLUMNS` that are given.

    Raises:
        SourceError: the file cannot be read, has no column `image` or an unknown one, or a value
            is no finite number, cannot be or is of no image.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise SourceError(f"{path}: larger than 100 MB, no table of pictures")
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise SourceError(f"{path}: cannot be read as CSV ({error})") from error
    names, rows = named_rows(text.splitlines(), path, SourceError)
    unknown = [name for name in names if name != "image" and name not in COLUMNS]
    if "image" not in names or unknown:
        raise SourceError(
            f"{path}: expected the columns image and any of {', '.join(COLUMNS)}; "
            f"got {', '.join(names) or 'none'}"
        )
    return {row["image"]: _values(path, line, row) for line, row in rows if any(row.values())}


def _values(path: Path, line: int, row: dict[str, str]) -> dict[str, float]:
    if not row["image"]:
        raise SourceError(f"{path}: line {line}: names no image")
    values: dict[str, float] = {}
    for name in COLUMNS:
        text = row.get(name, "")
        if not text:
            continue
        try:
            values[name] = float(text)
        except ValueError:
            values[name] = math.nan
        if not math.isfinite(values[name]):
            raise SourceError(f"{path}: line {line}: {name} is {text!r}, not a number")
        if name in _ABOVE_ZERO and values[name] <= 0.0:
            raise SourceError(
                f"{path}: line {line}: {name} is {text!r}; expected metres above 0, or an empty "
                "cell where it is not known"
            )
    if ("lat_deg" in values) != ("lon_deg" in values):
        raise SourceError(f"{path}: line {line}: lat_deg and lon_deg belong together")
    return values
