"""All that the filter is ever told, as values, and as JSON that keeps every bit.

The same inputs in the same order give the same estimates to the last bit (`Ekf.record` writes them
down, `Ekf.take` plays them): recordings of flights and of the benchmark's streams hold these.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any, get_type_hints

import numpy as np

from vwnav.errors import SourceError
from vwnav.estimation.beginning.starts import Start
from vwnav.estimation.events import CameraReturned, Exposed, NedFix, Recalibrated, Untracked
from vwnav.types import (
    Array,
    Attitude,
    Height,
    ImuSample,
    OdometryMotion,
    Range,
    Stationary,
    Telemetry,
)
from vwnav.vehicle import FoundCamera, Learned


@dataclass(frozen=True, slots=True)
class Asked:
    """The estimate of a time was asked for: that tells the filter what time it is."""

    t_s: float


Measurement = (
    Telemetry | NedFix | OdometryMotion | Exposed | Untracked | Recalibrated | CameraReturned
)
Input = Start | Measurement | Asked

_KINDS: dict[str, type[Input]] = {
    "start": Start, "attitude": Attitude, "imu": ImuSample, "height": Height, "range": Range,
    "stationary": Stationary, "fix": NedFix, "odometry": OdometryMotion, "asked": Asked,
    "exposed": Exposed, "untracked": Untracked, "recalibrated": Recalibrated,
    "camera_returned": CameraReturned,
}  # fmt: skip
_NAMES = {kind: name for name, kind in _KINDS.items()}


def time_of(seen: Input) -> float:
    """When it was measured, or what time was asked for."""
    return seen.t1_s if isinstance(seen, OdometryMotion) else seen.t_s


def encode(seen: Input) -> dict[str, Any]:
    """As JSON has it, with its `kind`; NaN and infinities, which the filter refuses, as text."""
    values = {field.name: exact(getattr(seen, field.name)) for field in fields(seen)}
    return {"kind": _NAMES[type(seen)]} | values


def exact(value: Any) -> Any:
    """A number, an array or None as JSON that gives the same number back."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [exact(entry) for entry in value]
    return value if not isinstance(value, float) or math.isfinite(value) else repr(float(value))


def decode(content: Any) -> Input:
    """The inverse of `encode`.

    Raises:
        SourceError: it is no input of the filter.
    """
    try:
        values = dict(content)
        kind = values.pop("kind")
        read = _READERS[kind]
        return _KINDS[kind](**{name: read[name](value) for name, value in values.items()})
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise SourceError(f"no input of the filter: {str(content)[:80]}") from error


def _array(value: Any) -> Array:
    return np.array(value, dtype=np.float64)


def _or_none(read: Callable[[Any], Any]) -> Callable[[Any], Any]:
    return lambda value: None if value is None else read(value)


def learned_of(t_s: float, mean: Any, covariance: Any, camera: Any = None) -> Learned:
    """What was learned, of its JSON; one of before has no camera."""
    found = (
        None if camera is None else FoundCamera(camera[0], camera[1], tuple(camera[2]), *camera[3:])
    )
    return Learned(t_s, tuple(mean), tuple(covariance), found)


_BY_TYPE: dict[Any, Callable[[Any], Any]] = {
    int: int, bool: bool, float: float, Array: _array,
    float | None: _or_none(float), Array | None: _or_none(_array),
    Learned | None: _or_none(lambda parts: learned_of(*parts)),
}  # fmt: skip
_READERS = {
    name: {field: _BY_TYPE[hint] for field, hint in get_type_hints(kind).items()}
    for name, kind in _KINDS.items()
}
