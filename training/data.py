"""Training pictures: where they are, which of them belong together, and how well.

Everything is decoded once. Training reads `train/` of the data folder and generated pairs only.
"""

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from training import warps
from training.warps import FloatArray, Image

ROOT = Path(__file__).resolve().parents[1]
PICTURE_SUFFIXES = {".jpg", ".jpeg", ".png", ".tif"}
# Draws per pair: large pictures hold many crops, small ones few.
PAIR_WEIGHTS = {"sztaki": 4.0, "cd_LEVIR": 4.0, "cd_WHU-CD": 3.0, "cd_levir256": 0.7}


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Looks at one place: one picture, or several with homographies from the first."""

    group: str  # "pair", "single", "drone", "series", "site"
    source: str
    pictures: list[Image]  # (H, W, 3) BGR
    H_i_0: list[FloatArray]  # takes points of picture 0 to picture i
    masks: list[Image]  # (H, W), 255 where there is ground
    weight: float = 1.0
    label_noise: float = 0.0  # q of the generalised cross-entropy


def data_folder(given: str = "") -> Path | None:
    """Where the data are: the argument, else VWNAV_DATA, else ../shared/data; None if absent."""
    path = Path(given or os.environ.get("VWNAV_DATA", "") or ROOT.parent / "shared" / "data")
    return path if (path / "train").is_dir() else None


def read(path: Path) -> Image:
    """Read a picture as (H, W, 3) BGR."""
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if picture is None:
        raise FileNotFoundError(f"no readable picture at {path}")
    return picture


def ground_mask(picture: Image) -> Image:
    """255 where a picture shows ground, 0 in the black corners that rotation left."""
    black = (picture.max(axis=2) < 4).astype(np.uint8)
    black = cv2.morphologyEx(black, cv2.MORPH_OPEN, np.ones((9, 9), np.uint8))
    return cv2.dilate(black, np.ones((7, 7), np.uint8)) * np.uint8(255) ^ np.uint8(255)


def scene(
    group: str,
    source: str,
    pictures: list[Image],
    *,
    H_i_0: list[FloatArray] | None = None,
    weight: float = 1.0,
    label_noise: float = 0.0,
) -> Scene:
    """Make a scene of registered pictures; homographies default to identity."""
    # Only registered pictures have black corners; a mask for each of the others would cost seconds.
    if group == "pair":
        masks = [ground_mask(p) for p in pictures]
    else:
        masks = [np.full(p.shape[:2], 255, np.uint8) for p in pictures]
    identities = [np.eye(3)] * len(pictures)
    return Scene(group, source, pictures, H_i_0 or identities, masks, weight, label_noise)


def registration(entry: dict[str, Any]) -> FloatArray | None:
    """Homography b from a of an entry of pairs.json; None where it cannot be trusted.

    Some pairs are registered by their georeference only: a phase correlation that is sure of itself
    corrects them, and where it is not, they are used only if it finds little to correct.
    """
    H_b_a = np.array(entry["H"], np.float64)
    if "pc_shift_b_minus_a" in entry:
        shift = np.array(entry["pc_shift_b_minus_a"])
        if entry["pc_response"] >= 0.3:
            return warps.translation(*shift) @ H_b_a
        return H_b_a if np.hypot(*shift) < 2.5 else None
    return H_b_a if np.hypot(*entry.get("res", (0.0, 0.0))) < 10.0 else None


def real_pairs(folder: Path, split: str = "train") -> Iterator[Scene]:
    """Pairs of two dates or two sensors, from one split of pairs.json."""
    for entry in json.loads((folder / "pairs.json").read_text()):
        H_b_a = registration(entry)
        if entry["split"] != split or H_b_a is None:
            continue
        yield scene(
            "pair",
            entry["src"],
            [read(folder / entry["a"]), read(folder / entry["b"])],
            H_i_0=[np.eye(3), H_b_a],
            weight=PAIR_WEIGHTS.get(entry["src"], 1.0),
            label_noise=0.3,
        )


def single_pictures(folder: Path, group: str) -> Iterator[Scene]:
    """Each picture of train/GROUP alone, every source with about equal say per picture area."""
    for path in sorted((folder / "train" / group).glob("*/*")):
        if path.suffix.lower() in PICTURE_SUFFIXES:
            picture = read(path)
            weight = float(np.clip(picture.shape[0] * picture.shape[1] / 400**2, 0.3, 3.0))
            yield scene(group, path.parent.name, [picture], weight=weight)


def series(folder: Path) -> Iterator[Scene]:
    """Many dates of one place."""
    for place in sorted((folder / "train" / "series").iterdir()):
        pictures = [
            read(path)
            for path in sorted(place.iterdir())
            if path.suffix.lower() in PICTURE_SUFFIXES
        ]
        yield scene("series", place.name, pictures, label_noise=0.3)


def site_pairs(folder: Path) -> Iterator[Scene]:
    """Generated places in two looks, if `vwnav.sim` has left some."""
    for path_a in sorted(folder.glob("*_a.jpg")):
        path_b = path_a.with_name(path_a.name.replace("_a.jpg", "_b.jpg"))
        if path_b.exists():
            yield scene("site", "site", [read(path_a), read(path_b)], label_noise=0.1)


def load_scenes(folder: Path | None, sites: Path) -> tuple[list[Scene], list[Scene]]:
    """Decode everything; every 12th real pair is kept for validation.

    Returns:
        Scenes to train on, scenes to validate on.
    """
    pairs = list(real_pairs(folder)) if folder else []
    training = [pair for i, pair in enumerate(pairs) if i % 12 != 5]
    if folder:
        training += [
            *single_pictures(folder, "single"),
            *single_pictures(folder, "drone"),
            *series(folder),
        ]
    training += site_pairs(sites)
    return training, pairs[5::12]
