"""The images of the data folder: registered pairs, and others that show some other place."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np

from vwnav.bench.features.scenes import Mask, ground_mask
from vwnav.cameras.image_folder import read_image
from vwnav.errors import ConfigError
from vwnav.types import Array, Gray

Split = Literal["train", "eval"]
# Pairs of these are taken; those of cd_WHU-CD are not all confirmed, of cd_levir256 too small.
SOURCES = (
    "srif_whu",
    "neon_sjer",
    "sztaki",
    "stanford_drone",
    "quake_tr",
    "cd_LEVIR",
    "tum_Frauenkirche",
    "tum_Wiesn",
)
LEAST_SIDE_PX = 380  # of an image that frames are cut from
_SURE_RESPONSE = 0.3  # of a phase correlation
_MOST_RESIDUAL_PX = 10.0
_KEPT_SRIF = 14  # images 1 to 14 of srif_whu overlap none of the others, which overlap at random


@dataclass(frozen=True, slots=True)
class Photo:
    """An image on disk; what is of one place may show the same ground."""

    path: Path
    place: str


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """Two registered images of one place.

    Attributes:
        source: where they are from.
        frame, map_: the one that frames are cut from, and the one that is the map.
        H_map_frame: (3, 3) between their pixels, as labelled.
    """

    source: str
    frame: Photo
    map_: Photo
    H_map_frame: Array


def registered_pairs(folder: Path, split: Split) -> list[Pair]:
    """The pairs of `pairs.json` whose truth can be trusted.

    Raises:
        ConfigError: the list is missing or makes no sense.
    """
    listed = folder / "pairs.json"
    try:
        entries = json.loads(listed.read_text())
        found = [_pair(folder, entry) for entry in entries if _wanted(entry, split)]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(f"{listed} is no list of registered pairs: {error!r}") from error
    return [pair for pair in found if pair is not None]


def other_photos(folder: Path, split: Split) -> list[Photo]:
    """Images without a pair; all of one source count as one place."""
    found = []
    for kind in ("single", "drone"):
        for path in sorted((folder / split / kind).glob("*/*.jpg")):
            # Images of one source may show each other's ground; so may neon's of its pairs.
            place = path.parent.name.removesuffix("_single")
            found.append(Photo(path, "neon_sjer" if place == "neon" else place))
    return found


def read_gray(photo: Photo) -> tuple[Gray, Mask]:
    """An image, and where it shows ground.

    Raises:
        SourceError: it cannot be read.
    """
    image = read_image(photo.path)
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8), ground_mask(image)


def apart(a: str, b: str) -> bool:
    """Whether two places certainly show different ground."""
    return not (a == b or a.startswith(f"{b} ") or b.startswith(f"{a} "))


def _wanted(entry: dict[str, Any], split: Split) -> bool:
    return bool(entry["split"] == split and entry["src"] in SOURCES)


def _pair(folder: Path, entry: dict[str, Any]) -> Pair | None:
    H = np.array(entry["H"], np.float64)
    if H.shape != (3, 3):
        raise ValueError(f"expected H (3, 3), got {H.shape}")
    if np.hypot(*entry.get("res", (0.0, 0.0))) > _MOST_RESIDUAL_PX:
        return None
    if "pc_shift_b_minus_a" in entry:
        if entry["pc_response"] < _SURE_RESPONSE:
            return None
        moved = np.eye(3)
        moved[:2, 2] = entry["pc_shift_b_minus_a"]
        H = moved @ H
    source, place = entry["src"], _place(entry["src"], Path(entry["a"]).stem)
    frame, map_ = (Photo(folder / entry[side], place) for side in "ab")
    return Pair(source, frame, map_, H)


def _place(source: str, stem: str) -> str:
    first = stem.split("_")[0]
    match source:
        case "srif_whu":
            return f"{source} kept" if int(first) <= _KEPT_SRIF else f"{source} rest"
        case "stanford_drone" | "quake_tr":  # campus place, town
            return f"{source} {first}"
        case "neon_sjer":
            return f"{source} {stem.removesuffix('_a')}"
        case _:
            return source
