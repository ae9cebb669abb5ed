"""Seasons, suns and tones: how one landscape is seen on two days that are years apart."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from vwnav.sim.scenery.landscape import LookName
from vwnav.types import Array

Season = Literal["summer", "late_summer", "autumn", "spring", "winter"]
Crop = Literal["bare", "stubble", "green", "ripe", "rape", "maize"]
Rgb = tuple[int, int, int]
Ramp = tuple[Rgb, Rgb, Rgb]  # wet, middling, dry ground

# Deliberately not one scaled copy of another: which of wet and dry is the brighter changes.
GRASS: dict[Season, Ramp] = {
    "summer": ((66, 90, 46), (92, 112, 62), (132, 132, 80)),
    "late_summer": ((86, 106, 58), (130, 126, 80), (166, 152, 106)),
    "autumn": ((76, 70, 50), (104, 100, 62), (92, 102, 54)),
    "spring": ((92, 84, 62), (116, 112, 70), (94, 112, 58)),
    "winter": ((96, 88, 68), (122, 110, 82), (108, 106, 74)),
}
CROPS: dict[Crop, Ramp] = {
    "bare": ((90, 78, 62), (128, 113, 93), (158, 142, 119)),
    "stubble": ((148, 130, 90), (182, 163, 116), (196, 179, 132)),
    "green": ((58, 90, 44), (82, 112, 58), (120, 128, 72)),
    "ripe": ((148, 130, 80), (188, 167, 108), (202, 184, 128)),
    "rape": ((128, 136, 62), (172, 172, 74), (156, 158, 78)),
    "maize": ((50, 76, 38), (66, 92, 46), (92, 106, 60)),
}
# Chances of bare, stubble, green, ripe, rape, maize.
_SOWN: dict[Season, tuple[float, ...]] = {
    "summer": (0.06, 0.02, 0.40, 0.22, 0.05, 0.25),
    "late_summer": (0.15, 0.40, 0.08, 0.17, 0.0, 0.20),
    "autumn": (0.45, 0.25, 0.25, 0.0, 0.0, 0.05),
    "spring": (0.40, 0.06, 0.38, 0.0, 0.16, 0.0),
    "winter": (0.50, 0.20, 0.30, 0.0, 0.0, 0.0),
}
_LEAVES: dict[Season, Rgb] = {
    "summer": (66, 86, 44),
    "late_summer": (78, 90, 50),
    "autumn": (134, 104, 58),
    "spring": (98, 104, 62),
    "winter": (104, 92, 78),
}
_LEAF_COVER: dict[Season, float] = {
    "summer": 1.0,
    "late_summer": 1.0,
    "autumn": 0.85,
    "spring": 0.6,
    "winter": 0.4,
}


@dataclass(frozen=True, slots=True)
class Look:
    """One day: season, sun and the tone of its images.

    Attributes:
        seed: of everything that differs between the days (crops, wear, fine texture).
        gain: per channel blue, green, red; `gamma`, `saturation` and `haze` (0 to 255)
            follow it.
        blur_m: sigma of the sensor's blur on the ground, 0 for none.
        jpeg_quality: of the delivered image, None where it was never compressed.
    """

    name: LookName
    seed: int
    season: Season
    sun_azimuth_rad: float
    sun_elevation_rad: float
    shadow_gain: float
    gain: tuple[float, float, float]
    gamma: float
    haze: float
    saturation: float
    blur_m: float
    jpeg_quality: int | None

    def sun(self) -> Array:
        """Unit vector (3,) north, east, up towards the sun."""
        flat = np.cos(self.sun_elevation_rad)
        return np.array(
            [
                np.cos(self.sun_azimuth_rad) * flat,
                np.sin(self.sun_azimuth_rad) * flat,
                np.sin(self.sun_elevation_rad),
            ]
        )

    def shadow_per_m(self) -> Array:
        """North, east (2,) metres by which the shadow of a thing 1 m high is displaced."""
        return np.asarray(-self.sun()[:2] / self.sun()[2], np.float64)

    def grass(self) -> Ramp:
        """Colours of grass from wet to dry."""
        return GRASS[self.season]

    def leaves(self) -> Rgb:
        """Colour of broad leaves, or of bare twigs."""
        return _LEAVES[self.season]

    def leaf_cover(self) -> float:
        """How much of the ground a broadleaf crown hides, 0 to 1."""
        return _LEAF_COVER[self.season]

    def crop(self, cell_seed: int) -> Crop:
        """What grows on a field on this day."""
        rng = np.random.default_rng([self.seed, cell_seed])
        return tuple(CROPS)[int(rng.choice(len(CROPS), p=_SOWN[self.season]))]


def flight_look(seed: int) -> Look:
    """Today: late in a summer's day, as a camera without processing sees it."""
    rng = np.random.default_rng([0xF117, seed])
    warm = rng.normal(0.0, 0.03)
    return Look(
        name="flight",
        seed=2 * seed + 1,
        season="summer" if rng.uniform() < 0.5 else "late_summer",
        sun_azimuth_rad=float(np.radians(rng.uniform(205.0, 255.0))),
        sun_elevation_rad=float(np.radians(rng.uniform(32.0, 48.0))),
        shadow_gain=float(rng.uniform(0.36, 0.5)),
        gain=(1.06 - warm, 1.03, 1.02 + warm),
        gamma=float(rng.uniform(0.95, 1.1)),
        haze=0.0,
        saturation=float(rng.uniform(0.72, 0.92)),
        blur_m=0.0,
        jpeg_quality=None,
    )


def map_look(seed: int) -> Look:
    """Another year: the satellite's morning pass in another season, blurred and compressed."""
    rng = np.random.default_rng([0x3A90, seed])
    seasons: tuple[Season, ...] = ("autumn", "spring", "winter", "summer")
    warm = rng.normal(0.0, 0.04)
    return Look(
        name="map",
        seed=2 * seed,
        season=seasons[int(rng.choice(4, p=(0.32, 0.36, 0.14, 0.18)))],
        sun_azimuth_rad=float(np.radians(rng.uniform(125.0, 165.0))),
        sun_elevation_rad=float(np.radians(rng.uniform(24.0, 42.0))),
        shadow_gain=float(rng.uniform(0.3, 0.48)),
        gain=(1.02 - warm, 0.98 + rng.normal(0.0, 0.015), 0.97 + warm),
        gamma=float(rng.uniform(0.85, 1.15)),
        haze=float(rng.uniform(2.0, 14.0)),
        saturation=float(rng.uniform(0.6, 0.95)),
        blur_m=float(rng.uniform(0.12, 0.26)),
        jpeg_quality=int(rng.integers(70, 90)),
    )
