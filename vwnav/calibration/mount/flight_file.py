"""What a recorded flight told: images, attitudes, ranges, and where it was now and then."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from vwnav.cameras.sources import open_source
from vwnav.errors import CalibrationError, SourceError
from vwnav.estimation.events import NedFix
from vwnav.geometry.geodesy import LocalFrame
from vwnav.recording.input_log import read_about, read_input_log
from vwnav.recording.telemetry_files import load_telemetry
from vwnav.types import Attitude, Frame, Range

_TOLD_S = 3.0  # a place that was told is of use for so long


@dataclass(frozen=True, slots=True)
class ToldPlace:
    """Where the aircraft was at a time, and how high above the ground, as the flight had it."""

    t_s: float
    lat_deg: float
    lon_deg: float
    agl_m: float | None


@dataclass(slots=True)
class FlightFile:
    """One flight, images left aside; times are those of the images' stamps."""

    attitudes: list[Attitude] = field(default_factory=list)
    ranges: list[Range] = field(default_factory=list)
    places: list[ToldPlace] = field(default_factory=list)

    def place_near(self, t_s: float) -> ToldPlace | None:
        """The place told nearest to a time; None where none was."""
        nearest = min(self.places, key=lambda each: abs(each.t_s - t_s), default=None)
        return nearest if nearest is not None and abs(nearest.t_s - t_s) <= _TOLD_S else None


def read_flight(source: str, telemetry: Path | None) -> FlightFile:
    """The flight's measurements: of a telemetry file, or of vwnav's own recording.

    Raises:
        VwnavError: a file that cannot be read, or that tells no attitude.
    """
    flight = _of_telemetry(source, telemetry) if telemetry else _of_recording(source)
    if len(flight.attitudes) < 2:
        raise CalibrationError(
            f"{telemetry or source} tells no attitude: without the autopilot's there is nothing "
            "that the camera could be mounted against"
        )
    return flight


def images_of(source: str) -> Iterator[Frame]:
    """All images, one after the other.

    Raises:
        SourceError: they cannot be read.
    """
    images = open_source(source)
    try:
        while (frame := images.next_frame()) is not None:
            yield frame
    finally:
        images.close()


def _of_telemetry(source: str, telemetry: Path) -> FlightFile:
    first = next(images_of(source), None)
    if first is None:
        raise SourceError(f"{source} holds no picture")
    flight = FlightFile()
    for seen in load_telemetry(telemetry).measurements(first.t_s):
        if isinstance(seen, Attitude):
            flight.attitudes.append(seen)
        elif isinstance(seen, Range):
            flight.ranges.append(seen)
    return flight


def _of_recording(source: str) -> FlightFile:
    path = Path(source)
    if path.suffix != ".mcap":
        raise CalibrationError(
            f"{source} is no recording of vwnav (flight.mcap): give the flight's attitudes with "
            "--telemetry FILE"
        )
    flight = FlightFile()
    frame = read_about(path)[0].local_frame
    for seen in read_input_log(path):
        if isinstance(seen, Attitude):
            flight.attitudes.append(seen)
        elif isinstance(seen, Range):
            flight.ranges.append(seen)
        elif isinstance(seen, NedFix):
            flight.places.append(_told(seen, frame))
    return flight


def _told(fix: NedFix, frame: LocalFrame) -> ToldPlace:
    lat_deg, lon_deg, _ = frame.to_geodetic(np.array([*fix.position_ne_m, 0.0]))
    return ToldPlace(fix.t_s, float(lat_deg), float(lon_deg), fix.agl_m)
