"""The input log of a recording: all that the filter was told, in order, and what images brought.

With the settings and the ground of the flight it gives every estimate again, to the last bit.
"""

import math
from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np

from vwnav import __version__
from vwnav.errors import SourceError
from vwnav.estimation.inputs import Input, decode, encode, exact, time_of
from vwnav.geometry.geodesy import LocalFrame
from vwnav.recording.reader import read_metadata, read_recording
from vwnav.recording.recorder import Recorder, plain
from vwnav.seams import StepResult
from vwnav.types import MapFix, MatchStats, PointKind, Rejected, RejectReason

INPUT_TOPIC, IMAGE_TOPIC = "/filter", "/picture"
_ABOUT = "run"
_PLACE = ("t_s", "lat_deg", "lon_deg")
_HEADING_AND_HEIGHT = ("yaw_rad", "sigma_yaw_rad", "agl_m", "sigma_agl_m")


@dataclass(frozen=True, slots=True, eq=False)
class About:
    """What holds for a whole run.

    Attributes:
        point: what the positions are of.
        local_frame: the filter's own.
        ground_id: `HeightGrid.identity` of the terrain heights that the filter uses; None: none.
        version: of the program that flew.
    """

    features: str
    feature_set_id: str
    point: PointKind
    local_frame: LocalFrame
    ground_id: str | None
    version: str = __version__

    def as_json(self) -> dict[str, Any]:
        """For `run.json` and for the recording."""
        frame = self.local_frame
        return {
            "features": self.features,
            "feature_set_id": self.feature_set_id,
            "point": self.point,
            "origin": {
                "lat_deg": frame.lat_deg,
                "lon_deg": frame.lon_deg,
                "alt_amsl_m": frame.alt_amsl_m,
            },
            "ground_id": self.ground_id,
        }


@dataclass(frozen=True, slots=True, eq=False)
class ImageSeen:
    """An image went through the pipeline: what the filter does not know of it."""

    t_s: float
    outcome: MapFix | Rejected
    commanded_yaw_rad: float | None


class InputLog:
    """Writes the input log into a recording; every call costs microseconds and none ever fails."""

    def __init__(self, recorder: Recorder, about: About) -> None:
        self.about = about
        self._recorder = recorder
        recorder.describe(_ABOUT, about.as_json() | {"version": about.version})

    def input(self, seen: Input) -> None:
        """Keep an input of the filter; hand this to `Ekf.record`."""
        self._recorder.sequence(INPUT_TOPIC, time_of(seen), lambda: encode(seen))

    def image(self, step: StepResult, commanded_yaw_rad: float | None) -> None:
        """Keep what an image brought, right after the pipeline's step."""
        self._recorder.sequence(
            IMAGE_TOPIC,
            step.t_s,
            lambda: {
                "t_s": step.t_s,
                "outcome": {"fix": isinstance(step.outcome, MapFix)} | plain(step.outcome),
                "commanded_yaw_rad": exact(commanded_yaw_rad),
            },
        )


def read_about(path: Path) -> tuple[About, Any]:
    """What holds for a recorded run, and its resolved settings as JSON has them.

    Raises:
        SourceError: no MCAP file, or one without an input log.
    """
    found = read_metadata(path)
    if _ABOUT not in found or "config" not in found:
        raise SourceError(
            f"{path} holds no filter inputs (recorded by an earlier version?); with --camera or "
            "--hfov-deg its pictures are replayed instead"
        )
    try:
        about = dict(found[_ABOUT])
        if about["point"] not in get_args(PointKind):
            raise ValueError(about["point"])
        about["local_frame"] = LocalFrame(**about.pop("origin"))
        return About(**about), found["config"]
    except (TypeError, ValueError, KeyError) as error:
        raise SourceError(f"{path} does not say what it is of: {error}") from error


def read_input_log(path: Path) -> Generator[Input | ImageSeen]:
    """The input log, in its order.

    Raises:
        SourceError: no MCAP file, or what it holds is none.
    """
    for record in read_recording(path, frozenset({INPUT_TOPIC, IMAGE_TOPIC})):
        if record.topic == INPUT_TOPIC:
            yield decode(record.content)
        else:
            yield _image(record.content)


def _image(content: Any) -> ImageSeen:
    try:
        yaw_rad = content["commanded_yaw_rad"]
        t_s, outcome = float(content["t_s"]), _outcome(dict(content["outcome"]))
        if not math.isfinite(t_s) or not math.isfinite(outcome.t_s):
            raise ValueError("a time that is none")
        return ImageSeen(t_s, outcome, None if yaw_rad is None else float(yaw_rad))
    except (TypeError, ValueError, KeyError) as error:
        raise SourceError(f"not what a picture brought: {str(content)[:80]}") from error


def _outcome(values: dict[str, Any]) -> MapFix | Rejected:
    values["stats"] = MatchStats(**values["stats"])
    if not values.pop("fix"):
        return Rejected(**values | {"reason": RejectReason[values["reason"].upper()]})
    numbers = {name: float(values[name]) for name in _PLACE}
    # A place found by correlation has no heading and no height.
    told = [name for name in _HEADING_AND_HEIGHT if values[name] is not None]
    numbers |= {name: float(values[name]) for name in told}
    covariance = np.array(values["covariance_ne_m2"], np.float64)
    return MapFix(**values | numbers | {"covariance_ne_m2": covariance})
