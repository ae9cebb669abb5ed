"""Register the real pairs again, place by place: one homography a pair leaves pixels of error.

python training/register.py [--weights CHECKPOINT] [--terms open] [-o runs/registered]

What stands up is displaced between two viewpoints, and homographies from a few marked points are
off. Features of an earlier training match each pair densely at three scales; where neighbouring
matches agree, they say by how much the label is wrong there, and in between it changes smoothly.
Training and validation take the pairs as this leaves them. So each generation of weights cleans the
labels of the next.
"""

import argparse
import itertools
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # to run it as a script

from models.network import SIZE_MULTIPLE_PX
from training.complaint import one_line
from training.data import (
    ROOT,
    WEAK_PAIRS,
    Scene,
    Terms,
    data_folder,
    has_terms,
    overlapping,
    real_pairs,
    save_registration,
    single_images,
)
from training.photometric import to_grey
from training.train import read_network
from training.validate import Extract, learned, mutual_matches
from training.warps import FloatArray, Image
from vwnav.types import Features

WORKING_PX = 1024  # larger images are shrunk to this
SCALES = (0.7, 1.0, 1.4)
ALL = 100_000  # keypoints, of each image
MOST_PX = 20.0  # labels are not more wrong than this
NEIGHBOURS = 10
AGREEING = 4  # of the neighbours
AGREE_PX = 3.0
LEAST_MATCHES = 60
GRID_PX = 4
# Widths of the smoothing and their weights: the wide ones count only where nothing else is near.
SMOOTHING_PX = ((8.0, 1.0), (24.0, 0.03), (72.0, 0.001))


@dataclass(frozen=True, slots=True)
class Displacements:
    """By how much image b shows things beside where the label puts them."""

    uv: FloatArray  # (n, 2) in image b
    offset: FloatArray  # (n, 2), from the labelled place to the true one


def of_any_size(extract: Extract, image: Image) -> Features:
    """Extract with the lower and right edges repeated until 32 divides the sides."""
    h, w = image.shape
    pad_h, pad_w = -h % SIZE_MULTIPLE_PX, -w % SIZE_MULTIPLE_PX
    found = extract(np.pad(image, ((0, pad_h), (0, pad_w)), mode="edge"))
    inside = (found.uv < np.array([w, h]) - 1.0).all(axis=1)
    return Features(found.uv[inside], found.descriptors[inside], found.scores[inside])


def dense_matches(a_in_b: Image, b: Image, extract: Extract) -> Displacements:
    """Match two grey images in one frame at several scales, and keep what neighbours confirm."""
    places, offsets = [], []
    for scale in SCALES:
        mode = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_CUBIC
        found = (
            of_any_size(extract, cv2.resize(p, None, fx=scale, fy=scale, interpolation=mode))
            for p in (a_in_b, b)
        )
        # half-pixel rule back to the images as they are
        uv_a, uv_b = ((uv + 0.5) / scale - 0.5 for uv in mutual_matches(*found))
        near = np.linalg.norm(uv_b - uv_a, axis=1) < MOST_PX
        places.append(uv_b[near])
        offsets.append((uv_b - uv_a)[near])
    uv, offset = np.concatenate(places), np.concatenate(offsets)
    sure = confirmed(uv, offset)
    return Displacements(uv[sure], offset[sure])


def confirmed(uv: FloatArray, offset: FloatArray) -> NDArray[np.bool_]:
    """Which of (n, 2) offsets at (n, 2) places are like those of enough of their neighbours."""
    if len(uv) <= NEIGHBOURS:
        return np.zeros(len(uv), np.bool_)
    points = uv.astype(np.float32)
    nearest = cv2.BFMatcher(cv2.NORM_L2).knnMatch(points, points, NEIGHBOURS + 1)
    index = np.array([[m.trainIdx for m in row[1:]] for row in nearest])
    apart = np.linalg.norm(offset[index] - offset[:, None], axis=2)
    return np.asarray((apart < AGREE_PX).sum(axis=1) >= AGREEING)


def offset_field(found: Displacements, size_wh: tuple[int, int]) -> NDArray[np.float32]:
    """Spread the offsets over a grid of `GRID_PX`: weighted means of what is near, (h, w, 2)."""
    w, h = (-(-side // GRID_PX) for side in size_wh)
    cell = np.clip((found.uv / GRID_PX).astype(int), 0, [w - 1, h - 1])
    sums = np.zeros((h, w, 3))
    np.add.at(sums, (cell[:, 1], cell[:, 0]), np.c_[found.offset, np.ones(len(found.uv))])
    spread = np.zeros_like(sums)
    for width, share in SMOOTHING_PX:
        spread += share * cv2.GaussianBlur(
            sums, (0, 0), width / GRID_PX, borderType=cv2.BORDER_CONSTANT
        )
    return (spread[..., :2] / (spread[..., 2:] + 1e-9)).astype(np.float32)


def register_again(pair: Scene, extract: Extract) -> NDArray[np.float32] | None:
    """Displacement field of a pair in pixels of its second image; None where nothing is sure."""
    a, b = (to_grey(image) for image in pair.images)
    scale = min(1.0, WORKING_PX / max(b.shape))
    small_b = cv2.resize(b, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    size_wh = (small_b.shape[1], small_b.shape[0])
    H_small_a = np.diag([scale, scale, 1.0]) @ pair.H_i_0[1]
    found = dense_matches(cv2.warpPerspective(a, H_small_a, size_wh), small_b, extract)
    if len(found.uv) < LEAST_MATCHES:
        return None
    return offset_field(found, size_wh) / np.float32(scale)


def pairs_to_register(folder: Path, terms: Terms = "all") -> Iterator[Scene]:
    """The real pairs of such terms: of two dates, and of two viewpoints."""
    frames = [f for f in single_images(folder, "drone") if has_terms(f, terms)]
    labelled = itertools.chain(real_pairs(folder), real_pairs(folder, listing=WEAK_PAIRS))
    yield from (pair for pair in labelled if has_terms(pair, terms))
    yield from overlapping(frames)


@one_line()
def main(arguments: list[str] | None = None) -> None:
    """Register every pair and leave one file for each.

    Raises:
        SystemExit: no data, no pairs, no model, or nowhere to write; one line says so.
    """
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--weights",
        type=Path,
        default=ROOT / "models/vwnav_default.ckpt",
        help="checkpoint of an earlier training",
    )
    parser.add_argument("--data", default="", help="folder that holds train/ and pairs.json")
    parser.add_argument(
        "--terms", choices=["all", "open"], default="all", help="which pairs, by their licence"
    )
    parser.add_argument("-o", "--out", type=Path, default=ROOT / "runs/registered")
    given = parser.parse_args(arguments)
    folder = data_folder(given.data)
    if folder is None:
        raise SystemExit("no data folder: give --data, or set VWNAV_DATA")
    extract = learned(read_network(str(given.weights), torch.device("cpu")), ALL)
    given.out.mkdir(parents=True, exist_ok=True)
    pairs = pairs_to_register(folder, given.terms)
    first = next(pairs, None)
    if first is None:
        raise SystemExit(f"{folder} holds no pairs of such terms: nothing is registered")
    for pair in itertools.chain([first], pairs):
        offsets = register_again(pair, extract)
        if offsets is None:
            print(f"{pair.name}: too few matches that agree; the label stays")
            continue
        moved = np.linalg.norm(offsets, axis=2)
        print(f"{pair.name}: labels move by {np.median(moved):.1f} px, at most {moved.max():.1f}")
        save_registration(given.out, pair, offsets)


if __name__ == "__main__":
    main()
