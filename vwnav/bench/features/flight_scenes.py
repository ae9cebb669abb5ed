"""Scenes of real flights: drone frames, rectified with rough priors, on a georeferenced map."""

import csv
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.bench.features.scenes import (
    Mask,
    ReferenceMap,
    Scene,
    generator,
    image_side,
    look_at,
    map_side,
)
from vwnav.cameras.image_folder import read_image
from vwnav.cameras.image_metadata import read_image_metadata
from vwnav.cameras.video_file import VideoFile
from vwnav.errors import SourceError
from vwnav.geometry.camera import R_BODY_CAMERA_DOWN, rectification
from vwnav.geometry.geodesy import LocalFrame, Window
from vwnav.geometry.rotations import rotation_from_euler
from vwnav.maps.build.raster import RasterSource
from vwnav.types import Array

KEYPOINTS = 1000  # of a frame; the map gets as many per area
ISLAMABAD_M_PER_PX = (0.3, 0.45)
ISLAMABAD_PRIOR_M = 110.0
ISLAMABAD_LOGO_WH = (110, 70)  # top left corner of the video
BRIGHTON_M_PER_PX = 0.1
BRIGHTON_PRIOR_M = 40.0  # the map is 130 m wide
# Turned upright after their attitude was written: a person looked. Upright features need it right.
BRIGHTON_TURNED = ("DJI_0025", "DJI_0027", "DJI_0029")
_YAW_SIGMA_RAD = math.radians(3.0)  # what a compass leaves after smoothing
_SCALE_SIGMA = 0.04  # and a barometer
_MAX_VIEW_PX = 1280


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Shot:
    """A frame of a flight with what is known about it.

    Attributes:
        name: for people.
        image: (h, w, 3) BGR.
        mask: (h, w), false over a logo.
        lat_deg, lon_deg: of the ground below the camera, the truth.
        R_ned_body: (3, 3) attitude of a body that carries the camera looking down.
        agl_m: height above ground.
        focal_ratio: focal length over image width.
    """

    name: str
    image: NDArray[np.uint8]
    mask: Mask
    lat_deg: float
    lon_deg: float
    R_ned_body: Array
    agl_m: float
    focal_ratio: float


def islamabad_shots(folder: Path, count: int) -> list[Shot]:
    """At most `count` frames of the video, evenly over the track."""
    rows = list(csv.DictReader((folder / "sift_track_every10.csv").open()))
    chosen = np.unique(np.linspace(0, len(rows) - 1, min(count, len(rows) // 2)).round())
    by_frame = {int(rows[int(i)]["frame"]): rows[int(i)] for i in chosen}
    return [_video_shot(image, by_frame[i]) for i, image in _frames(folder, set(by_frame))]


def brighton_shots(folder: Path) -> list[Shot]:
    """The nine images, placed and turned as their metadata say."""
    shots = []
    for path in sorted((folder / "images").glob("*.JPG")):
        image = read_image(path)
        said = read_image_metadata(path, image.shape[1], image.shape[0])
        known = (said.lat_deg, said.lon_deg, said.yaw_rad, said.height_above_home_m)
        lat_deg, lon_deg, yaw_rad, agl_m = (0.0 if value is None else value for value in known)
        if None in known or said.focal_ratio is None:
            raise SourceError(f"{path} does not say where and how it was taken")
        if path.stem in BRIGHTON_TURNED:
            yaw_rad += math.pi
        shots.append(
            Shot(
                name=path.stem,
                image=image,
                mask=np.ones(image.shape[:2], np.bool_),
                lat_deg=lat_deg,
                lon_deg=lon_deg,
                R_ned_body=rotation_from_euler(
                    said.roll_rad or 0.0, said.pitch_rad or 0.0, yaw_rad
                ),
                agl_m=agl_m,
                focal_ratio=said.focal_ratio,
            )
        )
    return shots


def flight_scenes(
    group: str, shots: list[Shot], raster: RasterSource, m_per_px: float, prior_m: float
) -> Iterator[Scene]:
    """Rectify the shots with rough priors and put them on the map at one resolution.

    Args:
        group: name of the group, which also seeds the priors' errors.
        shots: the frames.
        raster: the map.
        m_per_px: ground resolution of views and map.
        prior_m: the position is known to this, north and east.
    """
    ground = _GroundMap.of(raster, m_per_px)
    views = [_rectified(group, index, shot, m_per_px) for index, shot in enumerate(shots)]
    view_px = float(np.median([view[1].sum() for view in views]))
    budget = round(KEYPOINTS * ground.mask.sum() / view_px)
    map_ = ReferenceMap(ground.gray, ground.mask, budget, m_per_px, "m")
    for index, (shot, (gray, mask, nadir_uv)) in enumerate(zip(shots, views, strict=True)):
        place_uv = ground.uv(shot.lat_deg, shot.lon_deg)
        rng = generator(group + " prior", index)
        prior_uv = place_uv + rng.uniform(-prior_m, prior_m, 2) / m_per_px
        reach = prior_m / m_per_px + np.array(gray.shape[::-1]) / 2.0
        yield Scene(
            group=group,
            name=shot.name,
            image=gray,
            mask=mask,
            keypoints=KEYPOINTS,
            map_=map_,
            window=(*(prior_uv - reach), *(prior_uv + reach)),
            point0_uv=nadir_uv,
            point1_uv=place_uv,
        )


def _video_shot(image: NDArray[np.uint8], row: dict[str, str]) -> Shot:
    mask = np.ones(image.shape[:2], np.bool_)
    mask[: ISLAMABAD_LOGO_WH[1], : ISLAMABAD_LOGO_WH[0]] = False
    return Shot(
        name=f"frame {row['frame']}",
        image=image,
        mask=mask,
        lat_deg=float(row["lat"]),
        lon_deg=float(row["lon"]),
        R_ned_body=rotation_from_euler(0.0, 0.0, math.radians(float(row["heading_deg"]))),
        # Any height will do with the focal length that shows the footprint from there.
        agl_m=float(row["footprint_w_m"]),
        focal_ratio=1.0,
    )


def _frames(folder: Path, wanted: set[int]) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    video = VideoFile(folder / "our_data.mp4")
    try:
        while (frame := video.next_frame()) is not None and frame.index <= max(wanted):
            if frame.index in wanted:
                yield frame.index, frame.image
    finally:
        video.close()


def _rectified(
    group: str, index: int, shot: Shot, m_per_px: float
) -> tuple[NDArray[np.uint8], Mask, Array]:
    """(gray, mask, nadir_uv) of a shot whose heading and height are known roughly."""
    rng = generator(group, index)
    wrong_yaw = rotation_from_euler(0.0, 0.0, rng.normal(0.0, _YAW_SIGMA_RAD))
    h, w = shot.image.shape[:2]
    focal_px = shot.focal_ratio * w
    K = np.array([[focal_px, 0.0, (w - 1) / 2], [0.0, focal_px, (h - 1) / 2], [0.0, 0.0, 1.0]])
    plan = rectification(
        K,
        (w, h),
        wrong_yaw @ shot.R_ned_body @ R_BODY_CAMERA_DOWN,
        shot.agl_m * math.exp(rng.normal(0.0, _SCALE_SIGMA)),
        m_per_px,
        _MAX_VIEW_PX,
    )
    if plan is None:
        raise SourceError(f"{group}/{shot.name}: the camera does not look down")
    H_frame_view = np.asarray(np.linalg.inv(plan.H_rect_frame), np.float64)
    size_wh = image_side(plan.size_wh[0]), image_side(plan.size_wh[1])
    gray, mask = look_at(shot.image, shot.mask, H_frame_view, size_wh)
    return gray, mask, plan.nadir_uv


@dataclass(frozen=True, slots=True, eq=False)
class _GroundMap:
    """A raster drawn again north-up at another resolution, in metres about its middle."""

    gray: NDArray[np.uint8]
    mask: Mask
    frame: LocalFrame
    m_per_px: float

    @classmethod
    def of(cls, raster: RasterSource, m_per_px: float) -> "_GroundMap":
        w, h = raster.size_wh
        corners = np.array([[0.0, 0.0], [w, 0.0], [w, h], [0.0, h]])
        lat, lon = raster.georeference.lat_lon_from_pixel(corners[:, 0], corners[:, 1])
        frame = LocalFrame(float(lat.mean()), float(lon.mean()), 0.0)
        extent_m = np.ptp(frame.to_ned(lat, lon, 0.0)[:, 1::-1], axis=0)
        size_wh = (map_side(extent_m[0] / m_per_px), map_side(extent_m[1] / m_per_px))
        middle = (np.array(size_wh) - 1.0) / 2.0
        # Over a kilometre a raster's grid is plane to millimetres: four corners say all.
        own = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]) * 2.0 * middle
        east_m, south_m = ((own - middle) * m_per_px).T
        ned_m = np.stack([-south_m, east_m, np.zeros(4)], axis=-1)
        lat, lon, _ = frame.to_geodetic(ned_m)
        u, v = raster.georeference.pixel_from_lat_lon(lat, lon)
        there = np.stack([u - 0.5, v - 0.5], axis=-1).astype(np.float32)
        H_raster_own = np.asarray(
            cv2.getPerspectiveTransform(own.astype(np.float32), there), np.float64
        )
        image = raster.window(Window(0, 0, w, h))
        gray, mask = look_at(image.gray, image.mask, H_raster_own, size_wh)
        return cls(_filled(gray, mask), mask, frame, m_per_px)

    def uv(self, lat_deg: float, lon_deg: float) -> Array:
        """(2,) pixel of a place."""
        north_m, east_m, _ = self.frame.to_ned(lat_deg, lon_deg, 0.0)
        middle = (np.array(self.gray.shape[::-1]) - 1.0) / 2.0
        return np.asarray(middle + np.array([east_m, -north_m]) / self.m_per_px)


def _filled(gray: NDArray[np.uint8], mask: Mask) -> NDArray[np.uint8]:
    return np.where(mask, gray, round(float(gray[mask].mean()))).astype(np.uint8)
