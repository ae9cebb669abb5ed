"""Judge a released graph on the evaluation pairs, which no training has seen, beside SIFT and ORB.

python export/evaluate.py models/vwnav_default.onnx [--data FOLDER] [--views N]

Each view pair is two dates of one place, turned and scaled against each other by what
rectification leaves (sigma 6 degrees, 0.85 to 1.18), 384 x 384 pixels, 500 keypoints each, matched
by mutual nearest neighbours.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # to run it as a script

from export.parity import open_session
from training.data import data_folder, real_pairs
from training.photometric import PhotometricConfig
from training.sampling import Sample, SampleConfig, ViewPairs
from training.validate import KEYPOINTS, Extract, Features, root_sift, score_matches
from training.warps import Image, WarpConfig

AS_THEY_ARE = PhotometricConfig(**dict.fromkeys(PhotometricConfig.__dataclass_fields__, 0.0))
RECTIFIED = WarpConfig(
    rotation_sigma_deg=6.0,
    wide_rotation_share=0.0,
    scale_min=0.85,
    scale_max=1.18,
    tilt_sigma=0.02,
    aspect_sigma=0.01,
)


def evaluation_views(folder: Path, count: int) -> list[Sample]:
    """Draw the same views of the evaluation pairs every time."""
    scenes = [replace(s, weight=1.0) for s in real_pairs(folder, split="eval")]
    config = SampleConfig(size_px=384, zoom_min=1.0, zoom_max=1.0, least_overlap=0.5)
    config = replace(config, warp=RECTIFIED, photo=AS_THEY_ARE)
    pairs = ViewPairs(scenes, config, seed=7)
    return [pairs[i] for i in range(count)]


def released(model: Path) -> Extract:
    """Wrap an exported graph as an extractor function."""
    session = open_session(model)

    def extract(image: Image) -> Features:
        budget = np.array([KEYPOINTS], np.int64)
        feed = {"image": image[None, None], "max_keypoints": budget}
        uv, _, descriptors = session.run(None, feed)
        return uv, descriptors

    return extract


def turning_sift(image: Image) -> Features:
    """RootSIFT with its own orientations."""
    return root_sift(image, upright=False)


def orb(image: Image) -> Features:
    """ORB, its bits as -1 and 1, so that the greatest product is the least Hamming distance."""
    keypoints, codes = cv2.ORB_create(KEYPOINTS).detectAndCompute(image, None)
    if codes is None:
        return np.zeros((0, 2), np.float32), np.zeros((0, 256), np.float32)
    bits = np.unpackbits(codes, axis=1).astype(np.float32) * 2 - 1
    return np.array([k.pt for k in keypoints], np.float32), bits


def main(arguments: list[str] | None = None) -> int:
    """Print the table; 1 where there is no data to judge on."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("model", type=Path)
    parser.add_argument("--data", default="", help="folder that holds eval/ and pairs.json")
    parser.add_argument("--views", type=int, default=60)
    given = parser.parse_args(arguments)
    folder = data_folder(given.data)
    if folder is None:
        print("evaluate: no data folder; give --data or set VWNAV_DATA", file=sys.stderr)
        return 1
    views = evaluation_views(folder, given.views)
    rivals = {"upright SIFT": root_sift, "SIFT": turning_sift, "ORB": orb}
    for name, extract in {given.model.stem: released(given.model), **rivals}.items():
        print(f"{name:16s} {score_matches(extract, views)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
