"""What `vwnav localize` does, once its options are read."""

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2

from vwnav.cameras.image_folder import read_image
from vwnav.cameras.image_metadata import ImageMetadata, read_image_metadata
from vwnav.cameras.metadata_table import read_metadata_table
from vwnav.errors import CalibrationError, ConfigError, SourceError, VwnavError
from vwnav.files.folder import PICTURES, files_in
from vwnav.geometry.calibration import load_camera
from vwnav.geometry.camera import R_BODY_CAMERA_DOWN, Camera, check_fits
from vwnav.geometry.rotations import euler_from_rotation, rotation_from_euler
from vwnav.maps.pack import MapPack
from vwnav.types import FeatureExtractor, Frame, MapFix, Prior, Rejected
from vwnav.vision.features.load import load_features
from vwnav.vision.localizer import Localizer

EXIF_SIGMA_M = 15.0  # GPS, and the map's own offset
SEED = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalizeOptions:
    """The command line of `vwnav localize`."""

    images: list[Path]
    map_path: Path
    camera: Path | None
    hfov_deg: float | None
    use_exif: bool
    metadata: Path | None
    lat_deg: float | None
    lon_deg: float | None
    sigma_m: float | None
    yaw_deg: float | None
    agl_m: float | None
    features: str
    model: Path | None
    json_lines: bool


def localize_images(options: LocalizeOptions) -> None:
    """Locate each image and print a line for it.

    Raises:
        VwnavError: of the map, the model, the camera's file, or for images that cannot be read, say
            no lens or are of another size than the camera's: at the end, after the others are done.
    """
    cv2.setNumThreads(1)
    paths = list(_images(options.images))
    table = {} if options.metadata is None else read_metadata_table(options.metadata)
    camera = None if options.camera is None else load_camera(options.camera)
    extractor = load_features(options.features, options.model)
    left_out: list[VwnavError] = []
    with MapPack.open(options.map_path) as pack:
        pack.check_features(extractor)
        session = _Session(options, table, camera, pack, extractor)
        for path in paths:
            try:
                outcome = session.localize(path)
            except (SourceError, ConfigError, CalibrationError) as error:
                left_out.append(error)
                continue
            print(_json(path, outcome) if options.json_lines else _line(path, outcome), flush=True)
    if left_out:
        first_of_kind = {type(error): str(error) for error in reversed(left_out)}
        told = "; ".join(first_of_kind.values())
        raise SourceError(f"{len(left_out)} of {len(paths)} pictures were left out: {told}")


def _images(images: list[Path]) -> Iterator[Path]:
    for path in images:
        if path.is_dir():
            found = files_in(path, PICTURES)
            if not found:
                raise SourceError(f"{path} holds no picture ({', '.join(PICTURES)})")
            yield from found
        elif path.is_file():
            yield path
        else:
            raise SourceError(f"no picture at {path}")


class _Session:
    """What all images share."""

    def __init__(
        self,
        options: LocalizeOptions,
        table: dict[str, dict[str, float]],
        camera: Camera | None,
        pack: MapPack,
        extractor: FeatureExtractor,
    ) -> None:
        self._options, self._table, self._camera = options, table, camera
        self._pack, self._extractor = pack, extractor
        self._localizers: dict[tuple[int, int, float | None, bool], Localizer] = {}

    def localize(self, path: Path) -> MapFix | Rejected:
        image = read_image(path)
        height_px, width_px = image.shape[:2]
        metadata = read_image_metadata(path, width_px, height_px)
        prior = _prior(self._options, metadata, self._table, path, self._pack)
        # A gimbal's attitude is the camera's own: the mount is then that of a down-looking one.
        own_attitude = self._options.use_exif and metadata.roll_rad is not None
        localizer = self._localizer(path, metadata, (width_px, height_px), own_attitude)
        outcome = localizer.localize(Frame(0.0, image, 0), prior, SEED)
        if isinstance(outcome, MapFix) or not self._options.use_exif:
            return outcome
        for turned in _turned(prior):
            again = localizer.localize(Frame(0.0, image, 0), turned, SEED)
            if isinstance(again, MapFix):
                return again
        return outcome

    def _localizer(
        self, path: Path, metadata: ImageMetadata, size_wh: tuple[int, int], own_attitude: bool
    ) -> Localizer:
        if self._camera is not None:
            _check_fits(self._camera, size_wh, path)
        hfov_deg = self._options.hfov_deg or metadata.hfov_deg
        key = (*size_wh, None if self._camera else hfov_deg, own_attitude)
        if key not in self._localizers:
            if self._camera is None and hfov_deg is None:
                raise ConfigError(
                    f"{path} does not say its lens: give --camera FILE or --hfov-deg X"
                )
            camera = self._camera or Camera.from_hfov(*size_wh, hfov_deg or 0.0)
            camera = camera.without_arm()  # what is asked is where the camera was
            if own_attitude:
                camera = replace(camera, R_body_camera=R_BODY_CAMERA_DOWN)
            self._localizers[key] = Localizer(self._pack, self._extractor, camera)
        return self._localizers[key]


def _check_fits(camera: Camera, size_wh: tuple[int, int], path: Path) -> None:
    try:
        check_fits(camera, *size_wh)
    except CalibrationError as error:
        raise CalibrationError(f"{path}: {error}") from error


def _prior(
    options: LocalizeOptions,
    metadata: ImageMetadata,
    table: dict[str, dict[str, float]],
    path: Path,
    pack: MapPack,
) -> Prior:
    """What is known of an image: the command line before the table before EXIF."""
    prior = _exif_prior(metadata, pack) if options.use_exif else Prior()
    row = table.get(path.name, table.get(str(path), {}))
    given = {
        "lat_deg": options.lat_deg,
        "lon_deg": options.lon_deg,
        "sigma_m": options.sigma_m,
        "agl_m": options.agl_m,
        "yaw_deg": options.yaw_deg,
    }
    known = row | {name: value for name, value in given.items() if value is not None}
    for name, value in known.items():
        is_angle = name in ("yaw_deg", "roll_deg", "pitch_deg")
        field = name.replace("_deg", "_rad") if is_angle else name
        told: dict[str, Any] = {field: math.radians(value) if is_angle else value}
        prior = replace(prior, **told)
    return prior


def _turned(prior: Prior) -> Iterator[Prior]:
    """The prior by half a turn, and by a quarter either way.

    Cameras and programs turn images upright and leave the attitude in them as it was.
    """
    if prior.yaw_rad is None:
        return
    R_ned_body = rotation_from_euler(prior.roll_rad or 0.0, prior.pitch_rad or 0.0, prior.yaw_rad)
    for turn_rad in (math.pi, math.pi / 2.0, -math.pi / 2.0):
        R_ned_turned = R_ned_body @ rotation_from_euler(0.0, 0.0, turn_rad)
        roll_rad, pitch_rad, yaw_rad = euler_from_rotation(R_ned_turned)
        if prior.roll_rad is None or prior.pitch_rad is None:
            yield replace(prior, yaw_rad=yaw_rad)
        else:
            yield replace(prior, roll_rad=roll_rad, pitch_rad=pitch_rad, yaw_rad=yaw_rad)


def _exif_prior(metadata: ImageMetadata, pack: MapPack) -> Prior:
    agl_m = metadata.height_above_home_m
    if agl_m is None and metadata.lat_deg is not None and metadata.lon_deg is not None:
        ground_m = pack.elevation_m(metadata.lat_deg, metadata.lon_deg)
        if ground_m is not None and metadata.alt_amsl_m is not None:
            agl_m = metadata.alt_amsl_m - ground_m
    return Prior(
        lat_deg=metadata.lat_deg,
        lon_deg=metadata.lon_deg,
        sigma_m=EXIF_SIGMA_M,
        yaw_rad=metadata.yaw_rad,
        agl_m=agl_m if agl_m is not None and agl_m > 0.0 else None,
        roll_rad=metadata.roll_rad,
        pitch_rad=metadata.pitch_rad,
    )


def _json(path: Path, outcome: MapFix | Rejected) -> str:
    stats = outcome.stats
    stages = {
        "rectify": stats.rectify_ms,
        "extract": stats.extract_ms,
        "match": stats.match_ms,
        "verify": stats.verify_ms,
    }
    fix = outcome if isinstance(outcome, MapFix) else None
    values = {
        "image": str(path),
        "status": "rejected" if isinstance(outcome, Rejected) else "fix",
        "reason": outcome.reason.value if isinstance(outcome, Rejected) else None,
        "detail": outcome.detail if isinstance(outcome, Rejected) else None,
        "point": fix.point if fix else None,
        "lat_deg": round(fix.lat_deg, 8) if fix else None,
        "lon_deg": round(fix.lon_deg, 8) if fix else None,
        "sigma_m": round(fix.sigma_m, 3) if fix else None,
        "yaw_deg": (
            round(math.degrees(fix.yaw_rad) % 360.0, 3) if fix and fix.yaw_rad is not None else None
        ),
        "agl_m": round(fix.agl_m, 2) if fix and fix.agl_m is not None else None,
        "keypoints": stats.keypoints,
        "matches": stats.matches,
        "inliers": stats.inliers,
        "features": outcome.features,
        "time_ms": {
            name: round(ms, 2) for name, ms in (stages | {"total": sum(stages.values())}).items()
        },
    }
    return json.dumps(values)


def _line(path: Path, outcome: MapFix | Rejected) -> str:
    if isinstance(outcome, Rejected):
        return f"{path.name}: no fix, {outcome.reason.value} ({outcome.detail})"
    place = (
        f"{path.name}: {outcome.point} at {outcome.lat_deg:.7f}, {outcome.lon_deg:.7f} "
        f"+-{outcome.sigma_m:.1f} m"
    )
    if outcome.yaw_rad is None:
        return f"{place}, by correlation"
    agl = "" if outcome.agl_m is None else f", {outcome.agl_m:.1f} m above ground"
    return (
        f"{place}, heading {math.degrees(outcome.yaw_rad) % 360.0:.1f} deg{agl}; "
        f"{outcome.stats.inliers} of {outcome.stats.matches} matches agree"
    )
