"""What the whole localizer is asked: a frame, what is known of it, and where it was truly taken."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from vwnav.bench.features.scenes import Mask, look_at
from vwnav.geometry.camera import Camera
from vwnav.geometry.geodesy import (
    ground_resolution_m_per_px,
    lat_lon_from_mercator_px,
    mercator_px,
    mercator_px_per_m,
)
from vwnav.geometry.rotations import rotation_from_euler, wrap_pi
from vwnav.maps.build.raster import RasterSource
from vwnav.types import Array, Frame, Gray, Prior

# Kinds of looks: at the right place with a rough prior, or with the whole map to search; and at a
# map that does not show the place at all, likewise.
LookKind = Literal["prior", "search", "wrong", "wrong_search"]
LOOK_KINDS: tuple[LookKind, ...] = ("prior", "search", "wrong", "wrong_search")

CAMERA = Camera.from_hfov(640, 480, 70.0)
# Images without a place of their own are put here, pixel on pixel of this level: 0.2 m each.
ZOOM = 19
ORIGIN_LAT_DEG, ORIGIN_LON_DEG = 47.0, 8.0

# One sigma of what a rough prior is off by, and says so.
PRIOR_PX = 60.0
PRIOR_YAW_RAD = math.radians(5.0)
PRIOR_AGL_RATIO = 0.07
TILT_RAD = math.radians(3.0)  # one sigma of roll and of pitch; they are told as they are
_FOOTPRINT = (0.5, 0.75)  # width of the ground that a frame shows, over the image's shorter side
_FOOTPRINT_PX = (150.0, 640.0)
_SEEN, _SHARED = 0.99, 0.8  # of a frame that must show ground, and ground of the map
_ATTEMPTS = 60


@dataclass(frozen=True, slots=True)
class TruePose:
    """Where a frame was taken: the ground below the camera, heading and height."""

    lat_deg: float
    lon_deg: float
    yaw_rad: float
    agl_m: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LookCase:
    """One question to the localizer.

    Attributes:
        group: looks of one group are counted together.
        name: for people, and to find it again.
        kind: what is known, and whether the map shows the place.
        image: (h, w) gray frame of `camera`.
        prior: what is known.
        seed: handed to the localizer.
        truth: where the point that is asked for lies; None where the map does not show it.
        unit_m: what a unit of errors is worth: a map pixel, or 1 for metres.
        label_m: one sigma of the truth's own error, per axis.
    """

    group: str
    name: str
    kind: LookKind
    image: Gray
    camera: Camera
    prior: Prior
    seed: int
    truth: TruePose | None
    unit_m: float
    label_m: float

    def frame(self) -> Frame:
        """The image as the camera hands it on."""
        return Frame(0.0, self.image, 0)


@dataclass(frozen=True, slots=True, eq=False)
class Board:
    """A map, and the looks that are made at it.

    Attributes:
        sources: of the map.
        levels: zoom levels of its pack; None for those that fit the sources.
        looks: to make.
    """

    sources: Sequence[RasterSource]
    levels: tuple[int, ...] | None
    looks: list[LookCase]


@dataclass(frozen=True, slots=True, eq=False)
class Cut:
    """A frame cut from an image.

    Attributes:
        image: (h, w) gray, of `CAMERA`.
        nadir_uv: (2,) map pixel below the camera.
        rpy_rad: attitude, exact.
        agl_px: height above ground in map pixels.
    """

    image: Gray
    nadir_uv: Array
    rpy_rad: tuple[float, float, float]
    agl_px: float


@dataclass(frozen=True, slots=True, eq=False)
class SeenGround:
    """An image that frames are cut from, and where its pixels lie on that of the map.

    Attributes:
        gray: (h, w) what the camera sees.
        mask: (h, w) where it has data.
        H_gray_map: (3, 3) from pixels of the map's image.
        map_mask: (h, w) of the map's image, where it has data.
    """

    gray: Gray
    mask: Mask
    H_gray_map: Array
    map_mask: Mask


def cut_frame(ground: SeenGround, rng: np.random.Generator) -> Cut | None:
    """Hang a camera somewhere over a ground; None where its images share too little."""
    h, w = ground.map_mask.shape
    for _ in range(_ATTEMPTS):
        width_px = float(np.clip(rng.uniform(*_FOOTPRINT) * min(w, h), *_FOOTPRINT_PX))
        agl_px = width_px * CAMERA.K[0, 0] / CAMERA.width_px
        nadir_uv = rng.uniform((0.0, 0.0), (w, h))
        rpy_rad = (*rng.normal(0.0, TILT_RAD, 2), float(rng.uniform(-math.pi, math.pi)))
        cut = cut_at(ground, nadir_uv, rpy_rad, agl_px)
        if cut is not None:
            return cut
    return None


def cut_at(
    ground: SeenGround, nadir_uv: Array, rpy_rad: tuple[float, float, float], agl_px: float
) -> Cut | None:
    """The frame of a camera over a ground; None where it shows too little that both share."""
    H_map_frame = _map_from_frame(nadir_uv, rpy_rad, agl_px)
    size_wh = (CAMERA.width_px, CAMERA.height_px)
    shared = cv2.warpPerspective(
        ground.map_mask.astype(np.uint8),
        H_map_frame,
        size_wh,
        flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP,
    )
    if shared.mean() < _SHARED:
        return None
    image, seen = look_at(ground.gray, ground.mask, ground.H_gray_map @ H_map_frame, size_wh)
    return Cut(image, nadir_uv, rpy_rad, agl_px) if seen.mean() >= _SEEN else None


def _map_from_frame(nadir_uv: Array, rpy_rad: tuple[float, float, float], agl_px: float) -> Array:
    """H_map_frame (3, 3): rays of the camera, put down on level ground at `ZOOM`."""
    m_per_px = ground_resolution_m_per_px(ORIGIN_LAT_DEG, ZOOM)
    # The projection stretches east and north a little differently.
    east, north = (m_per_px * per_m for per_m in mercator_px_per_m(ORIGIN_LAT_DEG, ZOOM))
    H_map_ned = np.array(
        [
            [0.0, agl_px * east, nadir_uv[0]],
            [-agl_px * north, 0.0, nadir_uv[1]],
            [0.0, 0.0, 1.0],
        ]
    )
    R_ned_camera = rotation_from_euler(*rpy_rad) @ CAMERA.R_body_camera
    return np.asarray(H_map_ned @ R_ned_camera @ np.linalg.inv(CAMERA.K))


def map_pixel(offset_px: tuple[int, int]) -> tuple[int, int]:
    """Global pixel of `ZOOM` that an image at an offset from the origin begins at."""
    x, y = mercator_px(ORIGIN_LAT_DEG, ORIGIN_LON_DEG, ZOOM)
    return int(x) + offset_px[0], int(y) + offset_px[1]


def place_of_pixel(corner_px: tuple[int, int], uv: Array) -> tuple[float, float]:
    """Latitude and longitude of a pixel, centre convention, of an image placed at `ZOOM`."""
    x, y = np.array(corner_px) + uv + 0.5
    return lat_lon_from_mercator_px(float(x), float(y), ZOOM)


def rough_prior(
    pose: TruePose,
    roll_pitch_rad: tuple[float, float] | None,
    sigma_m: float,
    rng: np.random.Generator,
) -> Prior:
    """What a navigator may know of a pose: everything, a little wrong; the tilt exactly or not."""
    per_m = ground_resolution_m_per_px(pose.lat_deg, 0)
    x, y = mercator_px(pose.lat_deg, pose.lon_deg, 0)
    off = rng.normal(0.0, sigma_m, 2) / per_m
    lat_deg, lon_deg = lat_lon_from_mercator_px(x + off[0], y + off[1], 0)
    return Prior(
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        sigma_m=sigma_m,
        yaw_rad=float(wrap_pi(pose.yaw_rad + rng.normal(0.0, PRIOR_YAW_RAD))),
        sigma_yaw_rad=PRIOR_YAW_RAD,
        agl_m=pose.agl_m * math.exp(rng.normal(0.0, PRIOR_AGL_RATIO)),
        sigma_agl_ratio=PRIOR_AGL_RATIO,
        roll_rad=None if roll_pitch_rad is None else roll_pitch_rad[0],
        pitch_rad=None if roll_pitch_rad is None else roll_pitch_rad[1],
    )


def without_place(prior: Prior) -> Prior:
    """The same without position and heading: the whole map is searched."""
    return Prior(
        agl_m=prior.agl_m,
        sigma_agl_ratio=prior.sigma_agl_ratio,
        roll_rad=prior.roll_rad,
        pitch_rad=prior.pitch_rad,
    )
