"""Measures `accuracy.json` anew: which settings find the places of a real flight.

    python -m vwnav.bench.speed.flown_accuracy DATA

The protocol of `vwnav bench features` on drone frames, but for two things: the map has as many
keypoints per area as packs have, and its resolution is each of the three that a board may choose.
"""

import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from vwnav.bench.features.flight_scenes import ISLAMABAD_PRIOR_M, flight_scenes, islamabad_shots
from vwnav.bench.features.methods import FeatureSet, feature_sets
from vwnav.bench.features.scenes import Scene
from vwnav.bench.features.scoring import (
    FIT_PX,
    NEAR,
    inside_window,
    map_features,
    masked_features,
)
from vwnav.bench.speed.accuracy import PATH
from vwnav.bench.speed.settings import KEYPOINTS, SIZES_WH
from vwnav.geometry.geodesy import TILE_PX
from vwnav.geometry.homography import transform_points
from vwnav.geometry.similarity import estimate_similarity
from vwnav.maps.build.geotiff import RasterFile
from vwnav.maps.build.keypoints import KEYPOINTS_PER_TILE
from vwnav.types import Features
from vwnav.vision.features.learned import LearnedFeatures, released_model

FRAMES = 60
# At these the frames show as much of the map as `SIZES_WH` says: 300, 134 and 76 thousand pixels.
M_PER_PX = (0.3, 0.45, 0.6)
_SEED = 0


def measure(flight: Path) -> Iterator[dict[str, object]]:
    """A row for each feature set, resolution and number of keypoints.

    Args:
        flight: folder of the islamabad flight: its video, track and orthophoto.
    """
    cv2.setNumThreads(1)
    sets = [each for each in feature_sets([])[0] if _is_ours(each)]
    shots, raster = islamabad_shots(flight, FRAMES), RasterFile(flight / "1.tif")
    for m_per_px, (w, h) in zip(M_PER_PX, SIZES_WH, strict=True):
        scenes = list(flight_scenes("speed", shots, raster, m_per_px, ISLAMABAD_PRIOR_M))
        budget = round(KEYPOINTS_PER_TILE / TILE_PX**2 * float(scenes[0].map_.mask.sum()))
        map_ = replace(scenes[0].map_, keypoints=budget)
        for each in sets:
            reference = map_features(each, map_)
            for keypoints in KEYPOINTS:
                found = [_place(each, scene, reference, keypoints) for scene in scenes]
                errors_m, inliers = zip(*found, strict=True)
                yield {
                    "features": each.name.removeprefix("vwnav_"),
                    "size": f"{w}x{h}",
                    "keypoints": keypoints,
                    "within_3_m": round(float(np.mean(np.array(errors_m) < NEAR)), 4),
                    "inliers": round(float(np.mean(inliers)), 1),
                }


def _is_ours(each: FeatureSet) -> bool:
    return each.name in ("sift", "orb") or each.name.startswith("vwnav_")


def _place(
    each: FeatureSet, scene: Scene, reference: Features, keypoints: int
) -> tuple[float, int]:
    """How far off the place is, metres, and how many pairs say so."""
    found = masked_features(each, scene.image, scene.mask, keypoints)
    there = inside_window(reference, scene.window)
    index = each.methods[0].match(found, there)
    uv0, uv1 = found.uv[index[:, 0]], there.uv[index[:, 1]]
    fit = estimate_similarity(uv0.astype(np.float64), uv1.astype(np.float64), FIT_PX, _SEED)
    if fit is None:
        return np.inf, 0
    placed = transform_points(fit.H, scene.point0_uv)[0]
    return float(np.linalg.norm(placed - scene.point1_uv)) * scene.map_.unit_per_px, fit.count


def main(data: Path) -> None:
    """Write the table."""
    paths = sorted(released_model().parent.glob("vwnav_*.onnx"))
    weights = {
        path.stem.removeprefix("vwnav_"): LearnedFeatures(path).feature_set_id for path in paths
    }
    rows = list(measure(data / "flights" / "islamabad"))
    content = {
        "source": f"{FRAMES} frames of a drone video (islamabad) on an orthophoto of another "
        "flight; docs/benchmarks.md, The board's speed; made by "
        "`python -m vwnav.bench.speed.flown_accuracy`",
        "weights": weights,
        "rows": rows,
    }
    PATH.write_text(json.dumps(content, indent=1) + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
