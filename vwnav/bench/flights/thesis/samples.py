"""What is noted of a flight test ten times a second, wherever it is flown."""

import csv
import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path
from typing import Literal

import numpy as np

from vwnav.types import Array

SAMPLE_S = 0.1
Reference = Literal["true", "fused"]  # the prefix of those places that a flight is scored against


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """A moment; places in metres north, east and up of where the aircraft stood, headings true.

    Values that nobody knows are NaN.

    Attributes:
        t_s: since the program began.
        true: of the simulator; `estimated` by vwnav; `fused` by the autopilot, whose position is
            made of our estimates and its barometer.
        barometer_up_m: the pressure's height.
        commanded_yaw_deg: of the setpoint.
    """

    t_s: float
    mode: str
    phase: str
    true_north_m: float
    true_east_m: float
    true_up_m: float
    true_yaw_deg: float
    estimated_north_m: float
    estimated_east_m: float
    estimated_up_m: float
    estimated_yaw_deg: float
    fused_north_m: float
    fused_east_m: float
    fused_up_m: float
    fused_yaw_deg: float
    barometer_up_m: float
    commanded_yaw_deg: float


def write_csv(samples: Sequence[Sample], path: Path) -> None:
    """One row a sample; what nobody knows is empty."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(field.name for field in fields(Sample))
        writer.writerows(map(_cells, samples))


def columns(samples: Sequence[Sample], *names: str) -> Array:
    """(n, k) of the named values, of no samples too."""
    values = [[getattr(each, name) for name in names] for each in samples]
    return np.array(values, np.float64).reshape(-1, len(names))


def _cells(sample: Sample) -> list[str]:
    return [
        value if isinstance(value, str) else "" if math.isnan(value) else f"{value:.3f}"
        for value in astuple(sample)
    ]
