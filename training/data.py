"""Training images: where they are, which of them belong together, and how well.

Everything is decoded once. Training reads `train/` of the data folder and generated pairs only.
"""

import io
import json
import os
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from training import warps
from training.landmarks import landmarks, register
from training.warps import FloatArray, Image
from training.whole import write_whole

ROOT = Path(__file__).resolve().parents[1]
WEAK_PAIRS = "pairs_weak.json"
IMAGE_SUFFIXES = {".jpg", ".jpeg", ".png", ".tif"}
Terms = Literal["all", "open"]
# Sources whose images may be used for anything; generated pairs are, too.
OPEN_SOURCES = {
    "neon",
    "neon_sjer",
    "naip_nd",
    "oam_banepa",
    "odm_ochota_kap",
    "sheffield_cross",
    "odm_boruszyn_kap",
    "odm_data_caliterra",
    "odm_data_copr",
    "odm_data_garfield_msp",
    "odm_data_seneca",
}
NEAR_FRAMES = 4  # frames of a flight so far apart in it may overlap
# Of real pairs as their labels have them, and after `training/register.py`.
LABELLED_NOISE, REGISTERED_NOISE = 0.3, 0.15
# Draws per pair: large images hold many crops, small ones few.
PAIR_WEIGHTS = {
    "sztaki": 4.0,
    "cd_LEVIR": 4.0,
    "cd_WHU-CD": 3.0,
    "cd_levir256": 0.7,
    "quake_tr": 3.0,
    "stanford_drone": 2.0,
}
# Draws of all pairs of one place together: two campus places have 14 pairs of the same images.
MOST_OF_A_PLACE = {"stanford_drone": 4.0}
# Kept for validation with everything that shows them. The images of srif_whu overlap each other
# at random; SIFT finds numbers 1 to 14 in none of the others.
KEPT_PLACES = {
    *(f"srif_whu {number}" for number in range(1, 15)),
    *(f"neon_sjer SJER_{number:03d}" for number in range(45, 49)),
    "stanford_drone gates",
    "quake_tr gaziantep",
    "levir test_7",
    "levir test_12",
    "odm_tuniu",
}


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Looks at one place: one image, or several with homographies from the first."""

    group: str  # "pair", "single", "drone", "overlap", "series", "site"
    source: str
    images: list[Image]  # (H, W, 3) BGR
    H_i_0: list[FloatArray]  # takes points of image 0 to image i
    masks: list[Image]  # (H, W), 255 where there is ground
    weight: float = 1.0
    label_noise: float = 0.0  # q of the generalised cross-entropy
    name: str = ""  # of a pair, the same in every run
    place: str = ""  # scenes of one place share ground: they are kept together


def data_folder(given: str = "") -> Path | None:
    """Where the data are: the argument, else VWNAV_DATA, else ../shared/data; None if absent."""
    path = Path(given or os.environ.get("VWNAV_DATA", "") or ROOT.parent / "shared" / "data")
    return path if (path / "train").is_dir() else None


def read(path: Path) -> Image:
    """Read an image as (H, W, 3) BGR."""
    image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if image is None:
        raise FileNotFoundError(f"no readable picture at {path}")
    return image


def ground_mask(image: Image) -> Image:
    """255 where an image shows ground, 0 in the black corners that rotation left."""
    black = (image.max(axis=2) < 4).astype(np.uint8)
    black = cv2.morphologyEx(black, cv2.MORPH_OPEN, np.ones((9, 9), np.uint8))
    return np.where(cv2.dilate(black, np.ones((7, 7), np.uint8)) > 0, 0, 255).astype(np.uint8)


def scene(
    group: str,
    source: str,
    images: list[Image],
    *,
    H_i_0: list[FloatArray] | None = None,
    weight: float = 1.0,
    label_noise: float = 0.0,
    name: str = "",
    place: str = "",
) -> Scene:
    """Make a scene of registered images; homographies default to identity."""
    # Only registered images have black corners; a mask for each of the others would cost seconds.
    if group == "pair":
        masks = [ground_mask(p) for p in images]
    else:
        masks = [np.full(p.shape[:2], 255, np.uint8) for p in images]
    identities = [np.eye(3)] * len(images)
    return Scene(
        group, source, images, H_i_0 or identities, masks, weight, label_noise, name, place
    )


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


def place_of(entry: dict[str, Any]) -> str:
    """Which ground an entry of pairs.json shows; pairs of one place are not independent."""
    source, stem = entry["src"], Path(entry["a"]).stem
    match source:
        case "stanford_drone" | "quake_tr":  # campus place, town
            return f"{source} {stem.split('_')[0]}"
        case "cd_LEVIR" | "cd_levir256":  # the small images are cut from the large ones
            return "levir " + "_".join(stem.split("_")[:2])
        case "sztaki":  # Szada 1 to 7 are neighbours, and the archive's pair lies in the first
            return f"{source} Szada"
        case _:
            return f"{source} {stem.removesuffix('_a')}"


def listed(path: Path) -> list[dict[str, Any]]:
    """The entries of a listing; none where there is no such file.

    Raises:
        SystemExit: it is damaged; one line says so.
    """
    try:
        entries: list[dict[str, Any]] = json.loads(path.read_text()) if path.exists() else []
    except ValueError as error:
        raise SystemExit(f"{path} is not a whole listing of pairs ({error})") from error
    return entries


def real_pairs(folder: Path, split: str = "train", listing: str = "pairs.json") -> Iterator[Scene]:
    """Pairs of two dates or two sensors, from one split of a listing of the data folder."""
    entries = listed(folder / listing)
    pairs_of = Counter(place_of(entry) for entry in entries)
    for entry in entries:
        H_b_a = registration(entry)
        if entry["split"] != split or H_b_a is None:
            continue
        source, place = entry["src"], place_of(entry)
        most = MOST_OF_A_PLACE.get(source, np.inf) / pairs_of[place]
        yield scene(
            "pair",
            source,
            [read(folder / entry["a"]), read(folder / entry["b"])],
            H_i_0=[np.eye(3), H_b_a],
            weight=min(PAIR_WEIGHTS.get(source, 1.0), most),
            label_noise=LABELLED_NOISE,
            name="_".join([source, Path(entry["a"]).stem, Path(entry["b"]).stem]),
            place=place,
        )


def labelled_pairs(folder: Path, registrations: Path) -> list[Scene]:
    """The real pairs as training takes them, registered again where that was done.

    Pairs whose homography is known to be off by 2 to 3 px count only once they are.
    """
    pairs = [registered(pair, registrations) for pair in real_pairs(folder)]
    weak = (registered(pair, registrations) for pair in real_pairs(folder, listing=WEAK_PAIRS))
    return pairs + [pair for pair in weak if pair.label_noise == REGISTERED_NOISE]


def single_images(folder: Path, group: str) -> Iterator[Scene]:
    """Each image of train/GROUP alone, every source with about equal say per image area."""
    for path in sorted((folder / "train" / group).glob("*/*")):
        if path.suffix.lower() in IMAGE_SUFFIXES:
            image = read(path)
            weight = float(np.clip(image.shape[0] * image.shape[1] / 400**2, 0.3, 3.0))
            yield scene(
                group,
                path.parent.name,
                [image],
                weight=weight,
                name=f"{path.parent.name}_{path.stem}",
                place=path.parent.name if group == "drone" else "",
            )


def series(folder: Path) -> Iterator[Scene]:
    """Many dates of one place."""
    for place in sorted((folder / "train" / "series").glob("*/")):
        images = [
            read(path) for path in sorted(place.iterdir()) if path.suffix.lower() in IMAGE_SUFFIXES
        ]
        yield scene("series", place.name, images, label_noise=0.3)


def overlapping(frames: list[Scene]) -> Iterator[Scene]:
    """Register frames of a drone flight that are near each other: one place from two viewpoints.

    SIFT and MAGSAC++ find the homography; the ground is not flat, so it is right to a few pixels.
    Pairs with few inliers, or whose homography does not look like one plane seen twice from above,
    are left out.
    """
    marks = [landmarks(frame.images[0]) for frame in frames]
    for i, first in enumerate(frames):
        for j in range(i + 1, min(i + 1 + NEAR_FRAMES, len(frames))):
            second = frames[j]
            if first.source != second.source:
                break
            H_b_a = register(marks[i], marks[j])
            if H_b_a is not None:
                yield scene(
                    "overlap",
                    first.source,
                    [first.images[0], second.images[0]],
                    H_i_0=[np.eye(3), H_b_a],
                    label_noise=LABELLED_NOISE,
                    name=f"{first.name}_{second.name}",
                    place=first.place,
                )


def save_registration(folder: Path, pair: Scene, offsets: NDArray[np.float32]) -> None:
    """Leave what `training/register.py` found of a pair, whole or not at all."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, offsets=offsets.astype(np.float16))
    write_whole(folder / f"{pair.name}.npz", buffer.getvalue())


def registered(pair: Scene, folder: Path) -> Scene:
    """Move the ground of a pair's first image to where the second one shows it.

    Returns:
        The pair with its first image drawn again in the second one's frame; the pair as it is
        where `training/register.py` left nothing for it.
    """
    path = folder / f"{pair.name}.npz"
    if not path.exists():
        return pair
    b = pair.images[1]
    with np.load(path) as file:
        offsets = cv2.resize(file["offsets"].astype(np.float32), (b.shape[1], b.shape[0]))
    v, u = np.indices(b.shape[:2], np.float64)
    labelled = np.stack([u - offsets[..., 0], v - offsets[..., 1]], axis=-1).reshape(-1, 2)
    H_a_b = np.linalg.inv(pair.H_i_0[1])
    a, mask = pair.images[0], pair.masks[0]
    shrink = warps.local_scale(H_a_b, np.array([b.shape[1], b.shape[0]]) / 2)
    if shrink > 1.3:  # without aliasing
        (a, H_small_a), (mask, _) = warps.shrunk(a, shrink), warps.shrunk(mask, shrink)
        H_a_b = H_small_a @ H_a_b
    places = warps.warp_points(H_a_b, labelled).reshape(*b.shape[:2], 2).astype(np.float32)
    drawn = cv2.remap(a, places[..., 0], places[..., 1], cv2.INTER_CUBIC)
    ground = cv2.remap(mask, places[..., 0], places[..., 1], cv2.INTER_NEAREST)
    return replace(
        pair,
        images=[drawn, b],
        H_i_0=[np.eye(3), np.eye(3)],
        masks=[ground, pair.masks[1]],
        label_noise=REGISTERED_NOISE,
    )


def site_pairs(folder: Path) -> Iterator[Scene]:
    """Generated places in two looks, if `vwnav.sim` has left some."""
    for path_a in sorted(folder.glob("*_a.jpg")):
        path_b = path_a.with_name(path_a.name.replace("_a.jpg", "_b.jpg"))
        if path_b.exists():
            yield scene("site", "site", [read(path_a), read(path_b)], label_noise=0.1)


def has_terms(scene: Scene, terms: Terms) -> bool:
    """Whether its licence allows such a use."""
    return terms == "all" or scene.source in OPEN_SOURCES


def load_scenes(
    folder: Path | None, sites: Path, registrations: Path, terms: Terms = "all"
) -> tuple[list[Scene], list[Scene]]:
    """Decode everything; some places are kept for validation, whatever the terms.

    Args:
        folder: the data folder, None for generated pairs alone.
        sites: folder of generated pairs.
        registrations: what `training/register.py` left.
        terms: "open" leaves out images whose licence restricts their use.

    Returns:
        Scenes to train on, scenes to validate on.
    """
    scenes: list[Scene] = []
    if folder:
        frames = list(single_images(folder, "drone"))
        scenes = [
            *labelled_pairs(folder, registrations),
            *single_images(folder, "single"),
            *frames,
            *(registered(pair, registrations) for pair in overlapping(frames)),
            *series(folder),
        ]
    training = [s for s in scenes if s.place not in KEPT_PLACES]
    training = [s for s in training if has_terms(s, terms)]
    kept = [s for s in scenes if s.place in KEPT_PLACES and s.group in ("pair", "overlap")]
    return training + list(site_pairs(sites)), kept
