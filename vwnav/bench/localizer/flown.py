"""Frames of a real flight on the orthophoto of another one, and strange frames on it."""

import math
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from vwnav.bench.features.flight_scenes import ISLAMABAD_LOGO_WH, Shot, islamabad_shots
from vwnav.bench.features.scenes import generator
from vwnav.bench.localizer.boards import ELSEWHERE, LOOKS_AN_IMAGE, stranger, wrong_looks
from vwnav.bench.localizer.images import Photo, other_photos
from vwnav.bench.localizer.looks import Board, LookCase, TruePose, rough_prior, without_place
from vwnav.geometry.camera import Camera
from vwnav.types import Gray

ISLAMABAD = "islamabad"
MAP_M_PER_PX = 0.5
PRIOR_M = 40.0
TRACK_M = 0.17  # per axis: the track is smooth to 0.2 m (median)


def flown_boards(folder: Path, looks: int, only: str | None) -> Iterator[Board]:
    """The flight's map with so many of its frames, and as many of other places."""
    flight = folder / "flights" / ISLAMABAD
    if only not in (None, ISLAMABAD, ELSEWHERE) or not flight.is_dir():
        return
    # Needs rasterio, of the maps extra.
    from vwnav.maps.build.geotiff import RasterFile

    shots = islamabad_shots(flight, looks)
    found: list[LookCase] = []
    if only in (None, ISLAMABAD):
        for number, shot in enumerate(shots):
            found += _flight_looks(shot, number)
    if only in (None, ELSEWHERE):
        found += _strange_looks(other_photos(folder, "eval"), shots, looks)
    yield Board([RasterFile(flight / "1.tif")], None, found)


def _flight_looks(shot: Shot, number: int) -> Iterator[LookCase]:
    """The point that is asked for is the image's centre: nothing is known of the tilt."""
    pose, rng = _pose(shot), generator(ISLAMABAD, number)
    gray = _without_logo(shot)
    h, w = gray.shape
    f_px = shot.focal_ratio * w
    K = np.array([[f_px, 0.0, (w - 1) / 2.0], [0.0, f_px, (h - 1) / 2.0], [0.0, 0.0, 1.0]])
    camera = Camera(width_px=w, height_px=h, K=K)
    prior = rough_prior(pose, None, PRIOR_M, rng)
    for search in (False, True) if number % LOOKS_AN_IMAGE == 0 else (False,):
        yield LookCase(
            group=ISLAMABAD,
            name=f"{shot.name}.{number}",
            kind="search" if search else "prior",
            image=gray,
            camera=camera,
            prior=without_place(prior) if search else prior,
            seed=number,
            truth=pose,
            unit_m=1.0,
            label_m=TRACK_M,
        )


def _strange_looks(photos: list[Photo], shots: list[Shot], looks: int) -> Iterator[LookCase]:
    for number in range(looks):
        rng = generator(f"{ELSEWHERE} {ISLAMABAD}", number)
        found = stranger(photos, rng)
        if found is None:
            return
        photo, cut = found
        over = shots[int(rng.integers(len(shots)))]
        agl_m = cut.agl_px * MAP_M_PER_PX
        pose = TruePose(over.lat_deg, over.lon_deg, cut.rpy_rad[2], agl_m)
        name = f"{photo.path.stem} on {ISLAMABAD}"
        yield from wrong_looks(name, cut, pose, MAP_M_PER_PX, rng, number)


def _pose(shot: Shot) -> TruePose:
    yaw_rad = math.atan2(float(shot.R_ned_body[1, 0]), float(shot.R_ned_body[0, 0]))
    return TruePose(shot.lat_deg, shot.lon_deg, yaw_rad, shot.agl_m)


def _without_logo(shot: Shot) -> Gray:
    """The frame, its logo covered by the mean gray."""
    gray = np.asarray(cv2.cvtColor(shot.image, cv2.COLOR_BGR2GRAY), np.uint8)
    w, h = ISLAMABAD_LOGO_WH
    gray[:h, :w] = round(float(gray.mean()))
    return gray
