"""How a camera's sensor is read, which images of one size do not show: one mode sees more of it."""

from dataclasses import dataclass, fields
from typing import Any

_VERBS = {
    "sensor": "sensor",
    "read_px": "reads",
    "bits": "bits",
    "seen_px": "shows",
    "pixels": "pixels",
}
_ALIKE = 0.002  # of its width: by so little drivers round the part that is seen


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorMode:
    """What a driver says of the mode; None is not told.

    Attributes:
        sensor: its name.
        read_px: width and height that the sensor reads out.
        bits: of each pixel that it reads.
        seen_px: left, top, width and height of the part of the sensor that an image shows, in the
            sensor's own pixels.
        pixels: four letters of the format of images as the driver hands them out.

    Raises:
        ValueError: from the constructor, when a field makes no mode.
    """

    sensor: str | None = None
    read_px: tuple[int, ...] | None = None
    bits: int | None = None
    seen_px: tuple[int, ...] | None = None
    pixels: str | None = None

    def __post_init__(self) -> None:
        for name in ("sensor", "pixels"):
            _check(name, getattr(self, name), isinstance(getattr(self, name), str), "text")
        _check("bits", self.bits, _is_count(self.bits), "a whole number")
        for name, count in (("read_px", 2), ("seen_px", 4)):
            found = getattr(self, name)
            is_good = isinstance(found, list | tuple) and len(found) == count
            is_good = is_good and all(map(_is_count, found)) and min(found[-2:]) > 0
            _check(name, found, is_good, f"{count} whole numbers of pixels")
            object.__setattr__(self, name, None if found is None else tuple(found))

    @classmethod
    def of(cls, values: Any) -> "SensorMode":
        """By the names of its fields.

        Raises:
            ValueError: a name or a value is none of them.
        """
        if not isinstance(values, dict):
            raise ValueError("sensor_mode is no table")
        if unknown := set(values) - {field.name for field in fields(cls)}:
            raise ValueError(f"unknown key {', '.join(sorted(unknown))} of sensor_mode")
        return cls(**values)

    def told(self) -> dict[str, Any]:
        """What is known, by name."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in values.items()
            if value is not None
        }

    def __str__(self) -> str:
        told = self.told().items()
        return ", ".join(f"{_VERBS[name]} {_in_words(name, value)}" for name, value in told)

    def trouble_with(self, given: "SensorMode | None") -> str:
        """Why images of the given mode are not those that were calibrated; "" where none is told.

        What either does not tell is not compared.
        """
        now = {} if given is None else given.told()
        unlike = [
            f"{_VERBS[name]} {_in_words(name, now[name])}, not {_in_words(name, value)}"
            for name, value in self.told().items()
            if name in now and not _is_alike(value, now[name])
        ]
        if not unlike:
            return ""
        return (
            f"the camera is in another mode than its calibration is for ({'; '.join(unlike)}), "
            "which may see more or less: set it to that one, or calibrate in this one"
        )


def _is_alike(calibrated: Any, given: Any) -> bool:
    if not isinstance(calibrated, list) or len(calibrated) != 4:
        return bool(calibrated == given)
    off_px = max(abs(a - b) for a, b in zip(calibrated, given, strict=True))
    return bool(off_px <= _ALIKE * calibrated[2])


def _in_words(name: str, value: Any) -> str:
    match name:
        case "read_px":
            return f"{value[0]}x{value[1]} px"
        case "seen_px":
            return f"{value[2]}x{value[3]} px from {value[0]}, {value[1]} on"
        case _:
            return str(value)


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= 1_000_000


def _check(name: str, value: Any, is_good: bool, wanted: str) -> None:
    if value is not None and not is_good:
        raise ValueError(f"{name} of sensor_mode is {value!r}, expected {wanted}")
