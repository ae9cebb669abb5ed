"""Where a simulated vehicle is: as its simulator tells, or else as its autopilot believes."""

import contextlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from vwnav.bench.flights.live.relay import Relay
from vwnav.bench.flights.thesis.samples import Reference
from vwnav.errors import VwnavError
from vwnav.geometry.geodesy import LocalFrame, horizontal_distance_m, parse_lat_lon
from vwnav.geometry.rotations import euler_from_rotation, rotation_from_quat
from vwnav.sim.named_sites import DEFAULT_SEED
from vwnav.sim.site import Site
from vwnav.sim.truth import TruthReader
from vwnav.types import Array

_TRUTH_S = 30.0
_AT_HOME_M = 200.0  # of the default site: that one is used


@dataclass(frozen=True, slots=True)
class Eyes:
    """What `vwnav fly` is given where no camera is drawn from a truth."""

    map_source: str
    camera: Path
    video: str
    home: str


class Whereabouts(Protocol):
    """Who tells where the vehicle is.

    Attributes:
        reference: what a flight is scored against.
        site: what camera and map are drawn from; empty where the video is the simulator's own.
    """

    reference: Reference
    site: str

    def frame_here(self) -> LocalFrame:
        """With its origin on the ground where it stands."""
        ...

    def look(self, home: LocalFrame) -> tuple[Array, Array]:
        """(3,) place, NED about `home`, and (3,) velocity; NaN while nobody tells."""
        ...

    def yaw_deg(self) -> float:
        """The true heading, NaN where nobody tells it."""
        ...

    def fly_words(self) -> list[str]:
        """Options of `vwnav fly`: map, camera, home."""
        ...


class ByTruth:
    """A simulator's ground truth, from which the camera is drawn, too.

    Raises:
        VwnavError: none comes.
    """

    reference: Reference = "true"

    def __init__(self, url: str, stack: contextlib.ExitStack) -> None:
        self._relay = Relay(url)
        stack.callback(self._relay.close)
        self._truth = TruthReader(self._relay.url)
        stack.callback(self._truth.close)
        first = self._truth.wait(_TRUTH_S)
        if first is None:
            raise VwnavError(f"no truth from {url} within {_TRUTH_S:.0f} s")
        self._ground_m = first.alt_amsl_m
        self.site = _site_near(first.lat_deg, first.lon_deg)

    def frame_here(self) -> LocalFrame:
        """Of the newest state, on the first one's height."""
        state = self._truth.latest()
        assert state is not None
        return LocalFrame(state.lat_deg, state.lon_deg, self._ground_m)

    def look(self, home: LocalFrame) -> tuple[Array, Array]:
        """Of the newest state."""
        state = self._truth.latest()
        assert state is not None
        place_ned_m = home.to_ned(state.lat_deg, state.lon_deg, state.alt_amsl_m)
        return place_ned_m, np.array(state.velocity_ned_m_s)

    def yaw_deg(self) -> float:
        """Of the newest state."""
        state = self._truth.latest()
        assert state is not None
        rotation = rotation_from_quat(np.array(state.quat_wxyz))
        return math.degrees(euler_from_rotation(rotation)[2])

    def fly_words(self) -> list[str]:
        """Everything is drawn."""
        home = self.frame_here()
        return [
            "--video", self.site, "--map", self.site, "--truth", self._relay.url,
            "--home", f"{home.lat_deg},{home.lon_deg}",
        ]  # fmt: skip


class ByItself:
    """The autopilot's own position, which is made of vwnav's estimates: no truth."""

    reference: Reference = "fused"
    site = ""

    def __init__(
        self, eyes: Eyes, heard: Mapping[str, Any], place_ned_m: Callable[[LocalFrame], Array]
    ) -> None:
        self._eyes, self._heard, self._place_ned_m = eyes, heard, place_ned_m
        self._home = LocalFrame(*parse_lat_lon(eyes.home), 0.0)

    def frame_here(self) -> LocalFrame:
        """The home that was given: it has no position before vwnav gives it one."""
        return self._home

    def look(self, home: LocalFrame) -> tuple[Array, Array]:
        """As it tells."""
        told = self._heard.get("LOCAL_POSITION_NED")
        speed = (math.nan,) * 3 if told is None else (told.vx, told.vy, told.vz)
        return self._place_ned_m(home), np.array(speed)

    def yaw_deg(self) -> float:
        """Its heading is a compass's."""
        return math.nan

    def fly_words(self) -> list[str]:
        """As they were given."""
        eyes = self._eyes
        return [
            "--map", eyes.map_source, "--camera", str(eyes.camera), "--video", eyes.video,
            "--home", eyes.home,
        ]  # fmt: skip


def place_ned_m(message: Any, heard: Mapping[str, Any], home: LocalFrame) -> Array:
    """(3,) NED about `home` of a place that is told about the autopilot's origin; NaN of None."""
    if message is None:
        return np.full(3, math.nan)
    place = np.array([message.x, message.y, message.z])
    origin = heard.get("GPS_GLOBAL_ORIGIN")
    if origin is None:
        return place
    frame = LocalFrame(origin.latitude * 1e-7, origin.longitude * 1e-7, home.alt_amsl_m)
    lat_deg, lon_deg, alt_m = frame.to_geodetic(place)
    return home.to_ned(float(lat_deg), float(lon_deg), float(alt_m))


def _site_near(lat_deg: float, lon_deg: float) -> str:
    """The generated site that has its home there."""
    default = Site(DEFAULT_SEED)
    away_m = horizontal_distance_m(lat_deg, lon_deg, default.home_lat_deg, default.home_lon_deg)
    return "sim:default" if away_m < _AT_HOME_M else f"sim:default@{lat_deg:.5f},{lon_deg:.5f}"
