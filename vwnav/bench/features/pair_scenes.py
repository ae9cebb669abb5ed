"""Scenes with an exact truth: two dates of one place, and single images under homographies."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.bench.features.scenes import Mask, ReferenceMap, Scene, generator, ground_mask, look_at
from vwnav.cameras.image_folder import read_image
from vwnav.errors import SourceError
from vwnav.geometry.homography import transform_points
from vwnav.sim.site import FIRST_TRAINING_SEED, Site
from vwnav.types import Array, Gray

VIEW_PX = 384
KEYPOINTS = 500  # of each view
LEAST_OVERLAP = 0.5
GENERATED_SITES = 4
_GENERATED_PX, _GENERATED_M_PER_PX = 900, 0.3
# What rectification leaves between two views of one place.
_ROTATION_SIGMA_RAD = np.radians(6.0)
_LOG_SCALE_SIGMA, _SCALE_MIN, _SCALE_MAX = 0.17, 0.85, 1.18
_TILT_SIGMA, _ASPECT_SIGMA, _SHIFT_SIGMA = 0.02, 0.01, 0.08
_ATTEMPTS = 50


@dataclass(frozen=True, slots=True, eq=False)
class Registered:
    """Two registered images of one place, or twice the same one.

    Attributes:
        name: for people.
        a, b: (h, w, 3) BGR.
        H_b_a: (3, 3) from pixels of a to pixels of b.
    """

    name: str
    a: NDArray[np.uint8]
    b: NDArray[np.uint8]
    H_b_a: Array


def evaluation_pairs(folder: Path) -> dict[str, list[Registered]]:
    """The pairs of pairs.json that only judge, by their source."""
    groups: dict[str, list[Registered]] = {}
    listed = folder / "pairs.json"
    for entry in json.loads(listed.read_text()) if listed.is_file() else []:
        if entry["split"] == "eval":
            a, b = (read_image(folder / entry[side]) for side in "ab")
            name = Path(entry["a"]).stem.removesuffix("_a")
            groups.setdefault(entry["src"], []).append(
                Registered(name, a, b, np.array(entry["H"], np.float64))
            )
    return groups


def single_images(folder: Path) -> list[Registered]:
    """Every image below a folder that is large enough, as a pair with itself."""
    found = []
    for path in sorted(folder.glob("**/*.jpg")):
        image = read_image(path)
        if min(image.shape[:2]) >= VIEW_PX:
            found.append(Registered(f"{path.parent.name}/{path.stem}", image, image, np.eye(3)))
    return found


def generated_pairs() -> list[Registered]:
    """Generated places on two days, from seeds that no training may use."""
    size, half_m = (_GENERATED_PX, _GENERATED_PX), _GENERATED_PX * _GENERATED_M_PER_PX / 2.0
    found = []
    for seed in range(FIRST_TRAINING_SEED - GENERATED_SITES, FIRST_TRAINING_SEED):
        site = Site(seed)
        a, b = (
            site.render(look, half_m, -half_m, size, _GENERATED_M_PER_PX)
            for look in ("flight", "map")
        )
        found.append(Registered(f"site {seed}", a, b, np.eye(3)))
    return found


def view_pairs(
    group: str, pairs: list[Registered], count: int, *, same_day: bool = False
) -> Iterator[Scene]:
    """Draw `count` scenes: views of 384 x 384 px, turned and scaled against each other.

    Args:
        group: name of the group, which also seeds the drawing.
        pairs: taken in turn.
        count: how many.
        same_day: the second view is given another exposure, blur and noise.

    Raises:
        SourceError: a pair shares too little ground.
    """
    masks = [(ground_mask(pair.a), ground_mask(pair.b)) for pair in pairs]
    for index in range(count):
        pair, mask = pairs[index % len(pairs)], masks[index % len(pairs)]
        for attempt in range(_ATTEMPTS):
            scene = _draw(group, pair, mask, generator(group, index, attempt), same_day)
            if scene is not None:
                yield scene
                break
        else:
            raise SourceError(f"{group}/{pair.name}: no two views share enough ground")


def _draw(
    group: str,
    pair: Registered,
    masks: tuple[Mask, Mask],
    rng: np.random.Generator,
    same_day: bool,
) -> Scene | None:
    """One scene; None where the two views share too little."""
    h, w = pair.a.shape[:2]
    corner = rng.uniform((0.0, 0.0), (max(w - VIEW_PX, 0) + 1e-6, max(h - VIEW_PX, 0) + 1e-6))
    H_a_view0 = _shift(corner)
    H_1_0 = _relative_view(rng)
    size_wh = (VIEW_PX, VIEW_PX)
    H_b_view1 = pair.H_b_a @ H_a_view0 @ np.linalg.inv(H_1_0)
    gray0, seen0 = look_at(pair.a, masks[0], H_a_view0, size_wh)
    gray1, seen1 = look_at(pair.b, masks[1], H_b_view1, size_wh)
    _, shared = look_at(gray1, seen1, H_1_0, size_wh)
    if (shared & seen0).mean() < LEAST_OVERLAP:
        return None
    middle = np.full(2, (VIEW_PX - 1) / 2.0)
    return Scene(
        group=group,
        name=pair.name,
        image=gray0,
        mask=seen0,
        keypoints=KEYPOINTS,
        map_=ReferenceMap(
            _another_hour(gray1, rng) if same_day else gray1, seen1, KEYPOINTS, 1.0, "px"
        ),
        window=(0.0, 0.0, float(VIEW_PX), float(VIEW_PX)),
        point0_uv=middle,
        point1_uv=transform_points(H_1_0, middle)[0],
        H_1_0=H_1_0,
    )


def _relative_view(rng: np.random.Generator) -> Array:
    """How the second view differs from the first, H_1_0 (3, 3), about the centre."""
    angle_rad = rng.normal(0.0, _ROTATION_SIGMA_RAD)
    scale = float(np.clip(np.exp(rng.normal(0.0, _LOG_SCALE_SIGMA)), _SCALE_MIN, _SCALE_MAX))
    c, s = scale * np.cos(angle_rad), scale * np.sin(angle_rad)
    stretch = np.exp(rng.normal(0.0, _ASPECT_SIGMA))
    H = np.array(
        [[c * stretch, -s / stretch, 0.0], [s * stretch, c / stretch, 0.0], [0.0, 0.0, 1.0]]
    )
    H[2, :2] = rng.normal(0.0, _TILT_SIGMA, 2) / (VIEW_PX / 2)
    middle = np.full(2, (VIEW_PX - 1) / 2.0)
    moved = middle + rng.normal(0.0, _SHIFT_SIGMA * VIEW_PX, 2)
    return np.asarray(_shift(moved) @ H @ _shift(-middle))


def _shift(by_uv: Array) -> Array:
    return np.array([[1.0, 0.0, by_uv[0]], [0.0, 1.0, by_uv[1]], [0.0, 0.0, 1.0]])


def _another_hour(gray: Gray, rng: np.random.Generator) -> Gray:
    """A mild change of exposure, contrast, sharpness and noise."""
    tone = 255.0 * (np.arange(256) / 255.0) ** np.exp(rng.normal(0.0, 0.2))
    tone = (tone - 128.0) * rng.uniform(0.75, 1.2) + 128.0 + rng.uniform(-20.0, 20.0)
    changed = cv2.GaussianBlur(tone.astype(np.float32)[gray], (0, 0), rng.uniform(0.3, 0.9))
    noise = rng.normal(0.0, rng.uniform(1.0, 5.0), gray.shape)
    return np.asarray(np.clip(np.round(changed + noise), 0, 255), np.uint8)
