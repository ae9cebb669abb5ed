"""Puts the pipeline together: the one place that chooses implementations."""

import math
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np

from vwnav.config import Config
from vwnav.errors import ModelError
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.context import Ground
from vwnav.estimation.ekf import Ekf
from vwnav.geometry.camera import Camera
from vwnav.geometry.geodesy import LocalFrame
from vwnav.geometry.rotations import euler_from_rotation
from vwnav.maps.pack import MapPack
from vwnav.maps.schema import GeoreferenceBasis
from vwnav.pipeline import Pipeline
from vwnav.recording.input_log import About
from vwnav.seams import FeatureChoice
from vwnav.types import Array, FeatureExtractor, PointKind
from vwnav.vehicle import FoundCamera
from vwnav.vision.config import FeaturesConfig, LocalizerConfig
from vwnav.vision.features.load import largest_view, load_chosen, load_features
from vwnav.vision.localizer import Localizer
from vwnav.vision.odometry.odometry import Odometry

_WIDE = "sees {:.2f} times as wide as its calibration says"
_TURNED = "hangs turned by {:.0f} degrees {}clockwise, seen from above, from its mount_rpy_deg"
_MIRRORED = "mirrors its pictures left to right (a flip in its driver, of one axis alone?)"
_TILTED = "looks {:.0f} degrees further {} than its mount_rpy_deg says"
_MISDATED = "dates its pictures {:.0f} ms {} than its time_offset_s says"
_RECALIBRATED = "the camera {}: it is taken for that from now on; calibrate it"
_TOLD_MS = 10.0  # by which dates are off that is told of
_TOLD_RAD = math.radians(2.0)  # by which a mount is off that is told of
_HALF_TURN_RAD = math.pi - 1e-6
_MINOR = 0.4  # share of a tilt that is not told besides the rest
# Of its variance, from place to place, by how it is known
_OF_PLACES: dict[GeoreferenceBasis | None, float] = {"estimated": 1.0, "given": 0.5}
_MOST_STATED_M = 3.0  # with more nobody could fly on the first fix: what is more, flight learns
_AFTER_ALL = "the camera sees and hangs as its calibration says, after all"


@dataclass(frozen=True, slots=True)
class Assembled:
    """A pipeline, and what its parts are."""

    pipeline: Pipeline
    ekf: Ekf
    pack: MapPack
    primary: FeatureExtractor

    @property
    def feature_set_id(self) -> str:
        """Of the features that are flown on while they work."""
        return self.primary.feature_set_id


def choose_features(
    config: FeaturesConfig, say: Callable[[str], None]
) -> tuple[FeatureExtractor, FeatureExtractor | None]:
    """The wanted extractor, and the one that stands in for it when it fails in flight.

    Learned features that cannot be loaded are replaced by SIFT, and it is said.
    """
    if config.name != "learned":
        return load_chosen(config), None
    sift = load_features("sift")
    try:
        return load_chosen(config), sift
    except ModelError as error:
        say(f"learned features are not available, flying on SIFT: {error}")
        return sift, None


def with_map(config: Config, pack: MapPack) -> Config:
    """The settings with how far off from place to place the map is, by what its pack says.

    Sources that overlap disagree by just that. Of what an operator gives half the variance is
    taken for a shift of the whole, which flight cannot see. What is assumed says nothing: there
    the settings count.
    """
    if pack.georeference_basis not in _OF_PLACES:
        return config
    stated_m = math.sqrt(_OF_PLACES[pack.georeference_basis]) * pack.georeference_sigma_m
    ekf = replace(config.ekf, map_stated_sigma_m=min(stated_m, _MOST_STATED_M))
    return config.model_copy(update={"ekf": ekf})


def warm(extractor: FeatureExtractor, config: LocalizerConfig) -> None:
    """The first extraction of a size takes longer than the next: not in flight."""
    extractor.extract(largest_view(config), config.max_keypoints)


def assemble(
    primary: FeatureExtractor,
    fallback: FeatureExtractor | None,
    pack: MapPack,
    camera: Camera,
    local_frame: LocalFrame,
    config: Config,
    executor: Executor,
    say: Callable[[str], None],
    make_ekf: Callable[[EkfConfig, Ground | None], Ekf] = Ekf,
) -> Assembled:
    """Build the pipeline of extractors as `choose_features` gives them.

    `make_ekf` lets the benchmark listen to the filter.

    Raises:
        ModelError: the pack's features were made by another model.
    """
    pack.check_features(primary)
    alone = config.ekf.odometry_turns_attitude

    def of_camera(camera: Camera) -> tuple[FeatureChoice, Odometry]:
        first, *others = (
            Localizer(pack, extractor, camera, config.localizer)
            for extractor in (primary, fallback)
            if extractor is not None
        )
        choice = FeatureChoice(first, others[0] if others else None, config.pipeline, say)
        return choice, Odometry(camera, config.odometry, alone)

    def recalibrated(other: FoundCamera) -> tuple[FeatureChoice, Odometry]:
        R_mount = np.reshape(other.R_mount, (3, 3))
        found = [_MIRRORED] if other.mirrored else []
        found += [*_lens_in_words(other.focal_ratio), *_mount_in_words(R_mount)]
        found += _dates_in_words(other.time_offset_s)
        say(_RECALIBRATED.format(" and ".join(found)) if found else _AFTER_ALL)
        K = camera.K.copy()
        K[:2, :2] *= other.focal_ratio
        return of_camera(replace(camera, K=K, R_body_camera=R_mount @ camera.R_body_camera))

    ekf = make_ekf(config.ekf, ground_of(pack, local_frame))
    ekf.on_event(say)
    pipeline = Pipeline(
        *of_camera(camera), ekf, local_frame, config.localizer.sigma_tilt_rad, config.pipeline,
        executor, None if alone else recalibrated,
    )  # fmt: skip
    return Assembled(pipeline, ekf, pack, primary)


def _lens_in_words(focal_ratio: float) -> list[str]:
    return [] if focal_ratio == 1.0 else [_WIDE.format(1.0 / focal_ratio)]


def _dates_in_words(time_offset_s: float) -> list[str]:
    when = "later" if time_offset_s < 0.0 else "earlier"
    off_ms = 1e3 * abs(time_offset_s)
    return [_MISDATED.format(off_ms, when)] if off_ms > _TOLD_MS else []


def _mount_in_words(R_mount: Array) -> list[str]:
    """How far (3, 3) turns about down, and where it makes who looks down look, in body axes."""
    ahead, right, down = R_mount[:, 2].tolist()
    tilt_rad, turn_rad = math.acos(min(down, 1.0)), euler_from_rotation(R_mount)[2]
    found = []
    if abs(turn_rad) > _TOLD_RAD:
        way = "counter" if -_HALF_TURN_RAD < turn_rad < 0.0 else ""
        found.append(_TURNED.format(abs(math.degrees(turn_rad)), way))
    if tilt_rad > _TOLD_RAD:
        ways = [
            ("ahead" if ahead > 0.0 else "back", ahead),
            ("right" if right > 0.0 else "left", right),
        ]
        where = " and ".join(way for way, far in ways if abs(far) > _MINOR * math.sin(tilt_rad))
        found.append(_TILTED.format(math.degrees(tilt_rad), where))
    return found


def about_run(assembled: Assembled, features: str, point: PointKind) -> About:
    """What a run of this pipeline leaves in writing."""
    heights = assembled.pack.heights
    return About(
        features=features,
        feature_set_id=assembled.feature_set_id,
        point=point,
        local_frame=assembled.pipeline.local_frame,
        ground_id=None if heights is None else heights.identity,
    )


def ground_of(pack: MapPack, local_frame: LocalFrame) -> Ground | None:
    """The map's terrain heights in the filter's frame; None where the map has none."""
    if pack.heights is None:
        return None

    def height_m(north_m: float, east_m: float) -> float | None:
        place = np.array([north_m, east_m, 0.0])
        lat_deg, lon_deg, _ = local_frame.to_geodetic(place)
        return pack.elevation_m(float(lat_deg), float(lon_deg))

    return height_m
