import math

import cv2
import numpy as np
import pytest
from vision_scenes import CAMERA, GROUND_PX, HOME, frame_at, ground_pack, texture

from vwnav.maps.pack import MapPack
from vwnav.types import MapFix, Prior, RejectReason
from vwnav.vision.localizer import Localizer

ANYWHERE = Prior(agl_m=60.0, sigma_agl_ratio=0.05, roll_rad=0.0, pitch_rad=0.0)


def weather(seed: int, sigma: float) -> np.ndarray:
    """Noise of several sizes: of a ground, what is not built on it."""
    rng, total = np.random.default_rng(seed), np.zeros((GROUND_PX, GROUND_PX), np.float32)
    for size_px in (3, 8, 24):
        coarse = rng.normal(0.0, sigma, (GROUND_PX // size_px + 2,) * 2).astype(np.float32)
        total += cv2.resize(coarse, total.shape, interpolation=cv2.INTER_CUBIC)
    return total / np.float32(math.sqrt(3.0))


def two_days(plan: np.ndarray, sigma: float) -> tuple[np.ndarray, np.ndarray]:
    """A plan on the day of the map and on another: its texture lasts in part."""
    old = weather(1, sigma)
    new = 0.7 * old + weather(2, 0.6 * sigma)
    of_map, seen = (np.clip(plan + each, 0, 255).astype(np.uint8) for each in (old, new))
    return of_map, seen


def searched(plan, sigma, place, folder, extractor):
    """What a search makes of an image (north_m, east_m, yaw_deg), and how far off it is."""
    of_map, seen = two_days(plan, sigma)
    north_m, east_m, yaw_deg = place
    frame = frame_at(
        seen, north_m, east_m, 60.0, rpy_deg=(0, 0, yaw_deg), rng=np.random.default_rng(0)
    )
    with MapPack.open(ground_pack(folder / "map.mbtiles", of_map, (extractor,))) as pack:
        outcome = Localizer(pack, extractor, CAMERA).localize(frame, ANYWHERE, 0)
    if not isinstance(outcome, MapFix):
        return outcome, math.inf
    off_m = HOME.to_ned(outcome.lat_deg, outcome.lon_deg, HOME.alt_amsl_m)[:2] - place[:2]
    return outcome, float(np.linalg.norm(off_m))


@pytest.mark.parametrize(
    ("sigma", "place"),
    [
        (8.0, (35.0, 30.0, -100.0)),
        (16.0, (-30.0, 15.0, -60.0)),
        (16.0, (-20.0, -25.0, -30.0)),
        (8.0, (75.0, 60.0, -100.0)),  # its like is 190 m away, more than two views
        (16.0, (-70.0, 75.0, -100.0)),
    ],
)
def test_what_fits_as_well_turned_is_no_fix_although_the_map_is_less_like_itself(
    sigma, place, tmp_path, orb
):
    """Both ends of a runway were like the image, and of two textures: 64 to 92 m off, believed."""
    plan = texture(5)
    plan[GROUND_PX // 2 :] = np.rot90(plan, 2)[GROUND_PX // 2 :]
    outcome, _ = searched(plan, sigma, place, tmp_path, orb)
    assert getattr(outcome, "reason", None) is RejectReason.AMBIGUOUS


@pytest.mark.parametrize("yaw_deg", [-100.0, 30.0])
def test_ground_that_is_not_the_same_turned_is_found_on_another_day(yaw_deg, tmp_path, orb):
    _, off_m = searched(texture(5), 16.0, (35.0, 30.0, yaw_deg), tmp_path, orb)
    assert off_m < 0.5
