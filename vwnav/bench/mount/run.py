"""Rendered flights whose camera is drawn anew, and how far off their calibrations are."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from vwnav.bench.mount.recorded import Mounted, record
from vwnav.calibration.from_flight import FoundMount, MountOptions, find_mount
from vwnav.errors import CalibrationError
from vwnav.geometry.calibration import save_camera
from vwnav.geometry.rotations import vector_from_rotation
from vwnav.sim.renderer import default_camera
from vwnav.sim.site import Site
from vwnav.types import Array
from vwnav.vision.config import FeaturesConfig

MOST_MOUNT_DEG, OFFSETS_S, READOUTS_S = 4.0, (0.02, 0.1), (0.01, 0.03)
FOCALS = (0.98, 1.0, 1.015)  # of the true focal length over the calibrated one
SIGMAS = 3.0
_CAMERA = "camera.toml"


@dataclass(frozen=True, slots=True)
class Sought:
    """One number that is calibrated: its unit, and the error that is asked for."""

    name: str
    unit: str
    asked: float | None


SOUGHT = (
    Sought("mount: roll", "deg", 0.2),
    Sought("mount: pitch", "deg", 0.2),
    Sought("mount: yaw", "deg", None),
    Sought("time offset", "ms", 2.0),
    Sought("read-out", "ms", 2.0),
    Sought("focal length", "%", 0.3),
)


@dataclass(frozen=True, slots=True, eq=False)
class MountTrial:
    """One flight: errors and sigmas (6,) in the order and the units of `SOUGHT`.

    Attributes:
        refused: why nothing was found; errors are NaN then, and where one number was refused.
    """

    number: int
    errors: Array
    sigmas: Array
    images: int = 0
    refused: str = ""


@dataclass(frozen=True, slots=True)
class MountRow:
    """Of one number, over the flights that told it.

    Attributes:
        rms, largest: of its errors. told: flights. as_asked: of them; None where nothing is asked.
        within: `SIGMAS` of the sigma that each was given.
    """

    name: str
    unit: str
    asked: float | None
    rms: float
    largest: float
    told: int
    as_asked: int | None
    within: int


def bench_mount(
    site: Site, pack: Path, features: FeaturesConfig, runs: int, seed: int
) -> Iterator[MountTrial]:
    """Fly and calibrate, flight after flight; number k of a seed is always the same.

    Args:
        site: what is flown over.
        pack: its map, with those features.
        features: what finds the images on the map.
        runs: flights.
        seed: of cameras, ways and sensors.
    """
    with TemporaryDirectory(prefix="vwnav-mount-") as folder:
        save_camera(default_camera(), Path(folder) / _CAMERA)
        for number in range(runs):
            yield _trial(Path(folder), site, pack, features, number, seed)


def rows_of(trials: list[MountTrial]) -> list[MountRow]:
    """A row for each of `SOUGHT`."""
    errors = np.array([each.errors for each in trials]).reshape(-1, len(SOUGHT))
    sigmas = np.array([each.sigmas for each in trials]).reshape(-1, len(SOUGHT))
    return [
        _row(sought, *columns) for sought, *columns in zip(SOUGHT, errors.T, sigmas.T, strict=True)
    ]


def _row(sought: Sought, errors: Array, sigmas: Array) -> MountRow:
    told = np.isfinite(errors)
    off, sigmas = np.abs(errors[told]), sigmas[told]
    asked = sought.asked
    return MountRow(
        name=sought.name,
        unit=sought.unit,
        asked=asked,
        rms=float(np.sqrt(np.mean(off**2))) if len(off) else math.nan,
        largest=float(off.max()) if len(off) else math.nan,
        told=len(off),
        as_asked=None if asked is None else int(np.sum(off <= asked)),
        within=int(np.sum(off <= SIGMAS * sigmas)),
    )


def drawn(number: int, seed: int) -> Mounted:
    """The camera of a flight."""
    rng = np.random.default_rng([seed, number, 71])
    roll, pitch, yaw = rng.uniform(-MOST_MOUNT_DEG, MOST_MOUNT_DEG, 3).tolist()
    return Mounted(
        rpy_deg=(roll, pitch, yaw),
        offset_s=float(rng.uniform(*OFFSETS_S)),
        readout_s=float(rng.uniform(*READOUTS_S)),
        focal=FOCALS[number % len(FOCALS)],
    )


def _trial(
    folder: Path, site: Site, pack: Path, features: FeaturesConfig, number: int, seed: int
) -> MountTrial:
    recording, camera = folder / f"{number}.mcap", folder / _CAMERA
    mounted = drawn(number, seed)
    R_body_camera = record(recording, mounted, site, (seed, number))
    options = MountOptions(
        source=str(recording), map_path=pack, camera=camera, telemetry=None, focal=True,
        features=features, output=folder / "mounted.toml",
    )  # fmt: skip
    try:
        found = find_mount(options)
    except CalibrationError as error:
        nothing = np.full(len(SOUGHT), math.nan)
        return MountTrial(number, nothing, nothing, refused=str(error))
    finally:
        recording.unlink()
    return _against(mounted, R_body_camera, found, number)


def _against(mounted: Mounted, R_body_camera: Array, found: FoundMount, number: int) -> MountTrial:
    """What was found, less the truth; what was refused is NaN."""
    fit, told = found.fit, {each.name for each in found.verdict.told if not each.refused}
    turned_rad = vector_from_rotation(fit.R_body_camera @ R_body_camera.T)
    errors = [
        *np.degrees(turned_rad),
        1e3 * (fit.offset_s - mounted.offset_s),
        1e3 * (fit.readout_s - mounted.readout_s),
        1e2 * (fit.focal_ratio / mounted.focal - 1.0),
    ]
    sigmas = [
        *np.degrees(fit.sigmas_rad),
        1e3 * fit.sigma_offset_s,
        1e3 * fit.sigma_readout_s,
        1e2 * fit.sigma_focal_ratio,
    ]
    names = ("mount: yaw", "time offset, this flight's", "read-out", "focal length")
    taken = [True, True, *(name in told for name in names)]
    return MountTrial(number, np.where(taken, errors, math.nan), np.array(sigmas), fit.images)
