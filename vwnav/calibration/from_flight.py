"""What `vwnav calibrate mount` does, once its options are read."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from vwnav.calibration.mount.flight_file import FlightFile, images_of, read_flight
from vwnav.calibration.mount.history import FlownAttitudes
from vwnav.calibration.mount.problem import Sighting
from vwnav.calibration.mount.sightings import Spotter, spot_all
from vwnav.calibration.mount.solve import MountFit, fit_mount
from vwnav.calibration.mount.verdict import MountVerdict, judge
from vwnav.calibration.output import check_writable
from vwnav.errors import CalibrationError, SourceError
from vwnav.geometry.calibration import load_camera, load_findings, save_camera
from vwnav.geometry.camera import Camera
from vwnav.geometry.rotations import rotation_from_euler
from vwnav.maps.pack import MapPack
from vwnav.screen import print_table, progress_bar, say
from vwnav.types import FeatureExtractor, Frame
from vwnav.vision.config import FeaturesConfig
from vwnav.vision.features.load import load_chosen

LEAST_IMAGES = 25  # that are found on the map
MOST_IMAGES, FIRST_IMAGES, TURN_IMAGES = 150, 30, 6
QUARTERS_DEG = (0.0, 90.0, 180.0, -90.0)


@dataclass(frozen=True, slots=True)
class MountOptions:
    """The command line of `vwnav calibrate mount`."""

    source: str
    map_path: Path
    camera: Path
    telemetry: Path | None
    focal: bool
    features: FeaturesConfig
    output: Path


@dataclass(frozen=True, slots=True, eq=False)
class FoundMount:
    """What a flight tells of its camera.

    Attributes:
        verdict: what is taken of it. fit: what the least squares found.
        images: that have an attitude.
    """

    verdict: MountVerdict
    fit: MountFit
    images: int


def calibrate_mount(options: MountOptions) -> None:
    """Find the images on the map, solve, write the calibration and print what was told.

    Raises:
        VwnavError: of a file, or the flight tells nothing.
    """
    check_writable(options.output)
    found = find_mount(options)
    findings = load_findings(options.camera) | found.verdict.findings
    save_camera(found.verdict.camera, options.output, findings)
    _report(found, options.output)


def find_mount(options: MountOptions) -> FoundMount:
    """Find the images on the map and solve.

    Raises:
        VwnavError: of a file, or the flight tells nothing.
    """
    cv2.setNumThreads(1)
    flown = load_camera(options.camera)
    flight = read_flight(options.source, options.telemetry)
    extractor = load_chosen(options.features)
    with MapPack.open(options.map_path) as pack:
        pack.check_features(extractor)
        session = _MountSession(options, flight, pack, extractor)
        fit, sightings = session.solve(flown)
    stamps = np.array([each.t_s for each in sightings]) + fit.offset_s
    upright = session.history.at(stamps).R_ned_body[:, 2, 2]
    bank_rad = float(np.arccos(np.clip(upright.min(), -1.0, 1.0)))
    heights = bool(np.isfinite([each.height_m for each in sightings]).mean() > 0.5)
    verdict = judge(flown, fit, options.focal, heights, bank_rad)
    return FoundMount(verdict, fit, len(session.stamps))


class _MountSession:
    """One flight over one map."""

    def __init__(
        self, options: MountOptions, flight: FlightFile, pack: MapPack, extractor: FeatureExtractor
    ) -> None:
        self._source, self._focal = options.source, options.focal
        self._flight, self._pack, self._extractor = flight, pack, extractor
        self.history = FlownAttitudes(flight.attitudes)
        stamps = np.array([frame.t_s for frame in images_of(options.source)])
        if len(stamps) == 0:
            raise SourceError(f"{options.source} holds no picture")
        self.stamps = stamps[self.history.at(stamps).known]
        if len(self.stamps) < LEAST_IMAGES:
            raise CalibrationError(
                f"{len(self.stamps)} of {len(stamps)} pictures have an attitude; "
                f"{LEAST_IMAGES} are needed, over the map and in turns"
            )

    def solve(self, flown: Camera) -> tuple[MountFit, list[Sighting]]:
        """Twice: what some images tell lets the others be found where they are.

        Raises:
            CalibrationError: too few images are found on the map.
        """
        first, believed = self._first(flown)
        rough = fit_mount(believed, self.history, first, False)
        closer = replace(believed, R_body_camera=rough.R_body_camera)
        sightings = self._spotted(closer, MOST_IMAGES, rough.offset_s)
        if len(sightings) < LEAST_IMAGES:
            raise CalibrationError(
                f"{len(sightings)} of {min(MOST_IMAGES, len(self.stamps))} pictures are found on "
                f"the map; {LEAST_IMAGES} are needed"
            )
        return fit_mount(closer, self.history, sightings, self._focal), sightings

    def _first(self, flown: Camera) -> tuple[list[Sighting], Camera]:
        """Some images, with the camera turned by quarters until they are found."""
        for turn_deg in QUARTERS_DEG:
            turn = rotation_from_euler(0.0, 0.0, np.radians(turn_deg))
            believed = replace(flown, R_body_camera=turn @ flown.R_body_camera)
            if len(self._spotted(believed, TURN_IMAGES)) < TURN_IMAGES / 2:
                continue
            first = self._spotted(believed, FIRST_IMAGES)
            if len(first) >= FIRST_IMAGES / 3:
                return first, believed
        raise CalibrationError(
            "hardly any picture is found on the map, however the camera is turned: is it the "
            "flight's map, and the calibration its camera's?"
        )

    def _spotted(self, camera: Camera, count: int, offset_s: float = 0.0) -> list[Sighting]:
        which = np.linspace(0, len(self.stamps) - 1, min(count, len(self.stamps)))
        wanted = set(self.stamps[np.unique(np.round(which).astype(int))].tolist())
        spotter = Spotter(self._pack, self._extractor, camera, self._flight, self.history, offset_s)
        with progress_bar() as progress:
            return spot_all(spotter, self._images(wanted), len(wanted), progress)

    def _images(self, wanted_s: set[float]) -> Iterator[Frame]:
        return (frame for frame in images_of(self._source) if frame.t_s in wanted_s)


def _report(found: FoundMount, output: Path) -> None:
    rows = []
    for each in found.verdict.told:
        rows.append((each.name, "refused" if each.refused else each.value))
        if each.refused:
            say(f"{each.name}: not told by this flight, left as it was: {each.refused}")
    rows += [
        ("pictures on the map", f"{found.fit.images} of {found.images} with an attitude"),
        ("a point's error", f"{found.fit.sigma_px:.2f} px"),
        ("written to", str(output)),
    ]
    print_table("mount calibration", rows)
